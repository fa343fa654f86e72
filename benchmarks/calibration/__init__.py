"""Calibration of the verdict on recordings whose truth is known."""
