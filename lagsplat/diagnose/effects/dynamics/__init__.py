"""The room `dynamics`."""
