"""The room `extrapolation`."""
