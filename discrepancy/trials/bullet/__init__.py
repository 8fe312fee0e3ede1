"""Logs from another simulator: PyBullet, with rigid contacts in 3-D."""
