"""What sensors report of the true state."""
