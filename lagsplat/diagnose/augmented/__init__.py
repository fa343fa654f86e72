"""A simulator with the effects that a diagnosis found: written, read, run, and put into a MuJoCo file.

`model` holds `AugmentedSimulator`, `build_augmented`, `save_augmented` and `load_augmented`; `simulate` has
`simulate_augmented` and `compute_missing_acceleration`; `mujoco_export` has `patch_augmented`.
"""
