"""Published models to compare with: four for the pneumatic arms, a key-point forecaster, a neural ODE.

`fit` trains the four (`fit_baseline`), `released` reads their published weights (`load_released`);
`neural_ode`, `keypoints` and `gaussian_prediction` forecast free motion.
"""
