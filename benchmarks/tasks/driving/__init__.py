"""Driving in physics: which way, what disturbs the encoders, and the ceiling of what odometry can make of it."""
