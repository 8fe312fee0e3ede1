"""Robots and trains: descriptions, files, presets."""
