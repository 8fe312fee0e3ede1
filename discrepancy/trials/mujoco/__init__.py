"""Logs of a foreign simulator."""
