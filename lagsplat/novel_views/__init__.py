"""The room `novel_views`."""
