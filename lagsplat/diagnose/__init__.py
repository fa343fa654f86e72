"""Why a simulation and a recording disagree: where the gap lies, what causes it, and how far it closes.

The packages follow the data: data quality, residual, effects, estimation, identification, inference.
"""
