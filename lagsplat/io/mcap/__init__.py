"""MCAP logs: images, joint states and numbers of robots, read even if cut short, and sessions written."""
