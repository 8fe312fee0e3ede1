"""The hypotheses: what a robot's description may be missing."""
