"""What both commands share in reading their command lines. It imports nothing heavy, so that help comes at once."""
