"""Odometry of single robots."""
