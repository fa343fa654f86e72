"""The room `identification`."""
