"""What simulators other than the project's own share: a robot's numbers, how it stands, encoders, logs."""
