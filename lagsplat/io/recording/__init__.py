"""The room `recording`."""
