"""Faults without a constant size: variances, events and curves that they add beyond what robots in good order show."""
