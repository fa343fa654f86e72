"""The room `cpu`."""
