"""The force that a simulator lacks on a recording, and where it lies.

`latent_force` estimates it (`estimate_latent_force`, `LatentForceEstimate`), on the state-space model of
`state_space`, `linearization` and `kalman_kernels`. `localization` says where it lies (`locate`,
`ResidualLocation`), by time (`change_points`), frequency (`spectrum`), state (`state_maps`) and kind of
term (`features`, `components`). `error_budget` says how much each stage from image to forecast adds to the
gap (`measure_error_stages`).
"""
