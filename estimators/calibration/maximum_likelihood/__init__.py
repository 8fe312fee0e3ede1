"""Calibration by maximum likelihood: the parameters that make all counts and reference poses most likely."""
