"""Drives of robots and trains in physics: which way, what disturbs sensors, and what the oracle is told."""

from pathlib import Path

from benchmarks.tasks.driving import task, trains
from benchmarks.tasks.task import Task


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return all drives; they need no measured data."""
    return (*task.tasks(measured), *trains.tasks(measured))


__all__ = ["tasks"]
