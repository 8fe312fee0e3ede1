"""Poses in the plane and the rolling constraints."""
