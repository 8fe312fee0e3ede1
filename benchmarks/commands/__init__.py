"""What `castor-bench` does, one function a command; `benchmarks.cli` says which. Each module is imported when run."""
