"""Whether a diagnosis holds in simulation, on other logs and in use."""
