"""What may be missing in a description."""
