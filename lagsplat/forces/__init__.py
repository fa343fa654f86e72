"""Forces given in the image or in space: what they act on, their generalised force, and the law's answer.

`grasp` finds the matter under a brush or a ray (`grasp_brush`, `GraspPoint`), `equilibrium` the state under
a constant load (`hold_at_load`, `OperatingPoint`), and `loaded_lagrangian` the motion under a force
(`rollout_under_force`).
"""
