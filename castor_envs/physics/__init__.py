"""Physics: rigid bodies in pymunk, one wheel force law, stepped two ways that agree."""
