"""Calibration: what a robot's own runs tell of its parameters."""
