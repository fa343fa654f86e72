"""The room `measurement`."""
