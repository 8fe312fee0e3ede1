"""Hidden-effect trials: logs of simulated robots with a hidden effect, and what the finder makes of them."""
