"""Importers: published measurements of other people's robots, read as logs of robots that this package describes."""
