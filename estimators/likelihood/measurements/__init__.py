"""What a log measures beside its encoders, as equations about a state."""
