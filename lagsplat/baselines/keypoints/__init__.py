"""A forecaster by key points: Gaussians follow a few points, and a graph network predicts these.

`fit` trains it (`fit_forecaster`), `model` holds its networks (`Forecaster`) and renders the predicted path
(`draw_path`).
"""
