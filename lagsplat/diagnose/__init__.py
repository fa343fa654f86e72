"""The gap between a simulation and a recording: where it lies, what causes it, how far it closes."""
