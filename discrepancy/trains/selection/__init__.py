"""The older finder for trains, by thresholds: to be deleted once the posterior has taken its place."""
