"""What is there of no one size: variances that a fault adds, beside what robots in good order show."""
