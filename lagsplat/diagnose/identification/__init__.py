"""A simulator's mechanical model from its own recordings, where no equations are given."""
