"""Which effects explain the gap, and how sure that is: from fits of all hypotheses to probabilities.

`problem` sets up the data, the simulator and its priors (`build_problem`, `EstimationProblem`), and
`placement` the candidates (`place_effects`). `score_test` and `model_selection` choose and fit them
(`rank_hypotheses`), `evidence` and `posterior` compare them (`log_evidence`, `judge_hypotheses`), and
`plausibility`, `robustness`, `holdout`, `identifiability` and `recalibration` test the result.
"""
