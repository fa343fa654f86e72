"""A forecaster by key points: frames follow a few points, and a graph network moves these on.

`fit` trains it (`fit_forecaster`), `model` holds its networks (`Forecaster`) and `forecast` draws the
continued path (`draw_path`).
"""
