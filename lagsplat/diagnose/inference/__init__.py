"""Fits of all hypotheses about a gap, from the problem to held-out forecasts.

`problem` sets up data, simulator and priors, `placement` the candidates. `model_selection` chooses and fits
single effects, `effect_search` sets of them; `excitation` says what the recording can show. `holdout`,
`profile_likelihood` and `recalibration` test the result. The verdict is `lagsplat.diagnose.verdict`'s.
"""
