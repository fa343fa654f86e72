"""The room `trajectory`."""
