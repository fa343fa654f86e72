"""The room `mechanics`."""
