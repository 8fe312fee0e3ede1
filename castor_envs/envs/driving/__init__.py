"""What the environments share whose agent drives: reward, what agents see, and scripted drivers to compare with."""
