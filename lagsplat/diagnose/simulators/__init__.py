"""Simulators that are given as a program, and what the arguments ``sim`` and ``real`` name.

`python_model`, `mujoco_model` and `fitted_run` evaluate a simulator at points of the recorded region;
`projection` writes what they return as a `MechanicalModel` (`project_fields`, `project_acceleration`).
`sources` finds and reads the files (`find_sources`, `read_sources`).
"""
