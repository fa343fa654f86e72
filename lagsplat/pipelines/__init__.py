"""The room `pipelines`."""
