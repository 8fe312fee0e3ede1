"""A diagnosis as people read it."""
