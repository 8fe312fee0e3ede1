"""Which hypothesis the logs support."""
