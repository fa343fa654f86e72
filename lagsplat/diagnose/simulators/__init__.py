"""Simulators that are given as a program, and what the arguments ``sim`` and ``real`` name.

Each kind is evaluated at points of the recorded region, and the result is fitted as a `MechanicalModel`.
"""
