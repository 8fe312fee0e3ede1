"""Hidden-effect trials of trains."""
