"""The strength of a hidden effect in a log."""
