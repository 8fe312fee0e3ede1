"""Validation of a diagnosis: in simulation, on other logs and by its cost in use."""
