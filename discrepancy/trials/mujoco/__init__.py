"""Logs from another simulator: MuJoCo, with contacts in 3-D."""
