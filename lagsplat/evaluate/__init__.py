"""The metrics of a fitted run: reconstruction floor, forecasts, frequency, decay, learned physics against
the truth.

`evaluate.evaluate` scores one run (`evaluate`, `score`) and `aggregate` joins seeds. The rooms
`extrapolation` and `forces` hold what is measured beyond the clip and under a force.
"""
