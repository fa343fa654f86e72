"""Published models to compare with: four of the pneumatic arms, a key-point forecaster, a neural ODE.

`fit` trains the four (`fit_baseline`), `released` reads their published weights (`load_released`),
`neural_ode`, `keypoints` and `gaussian_prediction` are the forecasters of free motion.
"""
