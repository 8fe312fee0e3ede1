"""From a sample of encoders and gyro to motion: what estimators of robots share, compiled for stacks of robots."""
