"""Figures, tables and pages that people read; nothing here computes a result.

Its rooms are `common`, `tables`, `figures` and `diagnosis`; `inspection` describes a file in words.
"""
