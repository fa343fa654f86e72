"""The metrics: floor, forecasts, frequency, decay and their aggregation over seeds."""
