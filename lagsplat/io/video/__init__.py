"""The room `video`."""
