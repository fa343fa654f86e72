"""LaGSplat: from one fixed-camera video to a simulation that can be pushed."""

__version__ = "0.1.0"
