"""Figures and tables, each saying what it is of."""
