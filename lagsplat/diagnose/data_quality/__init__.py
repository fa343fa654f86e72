"""The room `data_quality`."""
