"""From estimates to scores."""
