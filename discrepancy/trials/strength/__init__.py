"""How strongly a hidden effect shows."""
