"""Logs: recorded, written, read, imported."""
