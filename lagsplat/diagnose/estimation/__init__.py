"""Parameters of a model from recorded trajectories, by multiple shooting.

`dataset` joins trajectories and cuts them into windows (`Dataset`, `WindowSet`), `rollout` simulates a
hypothesis over these (`RolloutModel`, `CoefficientRollout`), `nuisance` holds the small uncertainties that
every hypothesis may use (`NuisanceParameters`), `multiple_shooting` fits (`fit_multiple_shooting`).
"""
