"""The states of robots in logs, and the linear effect of each candidate about these."""
