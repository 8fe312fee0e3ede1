"""Hidden-effect trials: logs of simulated robots with a hidden effect, and how well the diagnosis finds it."""
