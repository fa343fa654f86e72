"""Metrics of a fitted run: reconstruction floor, forecasts, frequency, decay, learned against true physics.

`evaluate.evaluate` scores one run (`evaluate`, `score`) and `aggregate` joins seeds. The rooms
`extrapolation` and `forces` measure what happens beyond the clip and under a force.
"""
