"""The machinery of the self-calibrating filter: one sample, its Kalman update, external fixes."""
