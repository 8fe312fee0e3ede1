"""Localisation of trains."""
