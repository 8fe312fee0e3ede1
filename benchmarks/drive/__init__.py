"""A robot driven by hand: the keyboard (`keys`), the robot in physics (`robot`), estimators beside it, the window."""
