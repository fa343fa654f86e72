"""The figures, by name."""
