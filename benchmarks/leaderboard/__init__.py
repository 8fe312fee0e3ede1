"""From scores to ranks and boards."""
