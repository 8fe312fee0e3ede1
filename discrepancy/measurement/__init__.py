"""What truly happened in logs, and what each candidate does to them around that."""
