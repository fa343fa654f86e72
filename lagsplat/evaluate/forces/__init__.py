"""Accuracy of the answer to a force, against simulated truth and against what must hold without it."""
