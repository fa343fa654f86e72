"""A free neural differential equation on the same chart: a law of motion without any structure."""
