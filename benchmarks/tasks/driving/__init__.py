"""Drives of robots in physics: which way, what disturbs encoders, and the ceiling of what odometry can make of it."""

from benchmarks.tasks.driving.task import tasks

__all__ = ["tasks"]
