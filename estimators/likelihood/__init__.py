"""The likelihood of logs: one measurement model, for calibration and for diagnosis."""
