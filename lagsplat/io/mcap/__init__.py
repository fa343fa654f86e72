"""The room `mcap`."""
