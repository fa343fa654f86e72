"""A forecaster of key points: pictures that follow a few points, and a graph network that moves these on."""
