"""Calibration: estimates a robot's parameters from its logs."""
