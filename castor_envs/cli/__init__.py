"""What both commands share in reading their command lines."""
