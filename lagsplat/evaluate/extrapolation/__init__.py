"""How well a model forecasts far past its training clip, in images and in states.

`forecast` rolls a model out and scores its images (`score_extrapolation`, `extrapolate_run`), `images` does
so for models that only predict frames, and `oscillation` compares amplitude, phase and decay
(`compare_oscillations`).
"""
