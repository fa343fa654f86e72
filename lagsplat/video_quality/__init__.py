"""The room `video_quality`."""
