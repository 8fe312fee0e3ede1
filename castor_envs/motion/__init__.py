"""What is driven: trajectories, paths, controllers, perfect rolling, steps between samples."""
