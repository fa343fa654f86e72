"""The room `simulators`."""
