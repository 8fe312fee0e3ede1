"""Names the effect that a train's description is missing: in its posture sensors, its axles, or under them."""
