"""The room `residual`."""
