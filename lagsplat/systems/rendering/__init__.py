"""The room `rendering`."""
