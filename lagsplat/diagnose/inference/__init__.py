"""Which effects explain the gap, and how sure that is: from fits of all hypotheses to probabilities.

`problem` sets up data, simulator and priors, `placement` the candidates. `model_selection` chooses and fits
them, `posterior` compares them and judges. `robustness`, `holdout`, `profile_likelihood` and `recalibration`
test the result.
"""
