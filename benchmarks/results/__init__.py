"""What a run stores."""
