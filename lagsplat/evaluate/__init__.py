"""Metrics of a fitted run: reconstruction, forecasts, frequency, decay, learned against true physics."""
