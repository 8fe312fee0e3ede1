"""Where model and measurement disagree: logs looked at without trusting the robot that made them."""
