"""Which effects explain the gap, and how sure that is: from fits of all hypotheses to probabilities.

`problem` sets up data, simulator and priors, `placement` the candidates. `score_test` and `model_selection`
choose and fit them, `posterior` compares them by their evidence. `plausibility`, `robustness`, `holdout`,
`profile_likelihood` and `recalibration` test the result.
"""
