"""Measures of the alternatives of a verdict, and a calibrated choice between them."""
