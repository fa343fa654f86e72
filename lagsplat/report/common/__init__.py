"""The room `common`."""
