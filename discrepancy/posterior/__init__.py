"""The finder: one posterior over every effect that a description may be missing."""
