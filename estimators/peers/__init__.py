"""Estimators that people run today on robots like these; each names the source that it follows."""
