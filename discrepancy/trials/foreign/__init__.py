"""Code that simulators other than pymunk share: a robot's numbers, its static loads, encoders, logs."""
