"""The room `augmented`."""
