"""The world: robots on castors, their physics, and Gymnasium environments for odometry."""
