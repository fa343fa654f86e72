"""Stage 2: a Lagrangian with dissipation and actuation, learned on the encoded trajectory.

`lagrangian` is the law in torch (`Lagrangian`), `numpy_lagrangian` the same in NumPy (`NumpyLagrangian`),
`fit` learns it (`fit_dynamics`) and `rollout` integrates it (`rollout`).
"""
