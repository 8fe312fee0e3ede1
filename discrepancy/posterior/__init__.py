"""The finder: one posterior of everything that a description may be missing."""
