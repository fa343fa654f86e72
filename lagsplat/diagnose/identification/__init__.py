"""A simulator's mechanical model from its own recordings, where no equations are given.

`weak_form` gives a first model by linear regression, `structure_search` adds terms as long as they pay
(`identify_model`), `novelty` finds outlier windows and motion that the recordings do not cover
(`NoveltyDetector`), `estimated_simulator` puts them together (`estimate_simulator`, `EstimatedSimulator`).
"""
