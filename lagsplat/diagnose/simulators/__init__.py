"""Simulators that are given as a program, a model file or a fitted run.

Each kind is evaluated at points of the recorded region, and the result is fitted as a `MechanicalModel`.
"""
