"""The room `forces`."""
