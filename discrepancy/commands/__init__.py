"""What `castor-diagnose` does, one module a command, which is imported when it is run (`discrepancy.cli`)."""
