"""The room `actuation`."""
