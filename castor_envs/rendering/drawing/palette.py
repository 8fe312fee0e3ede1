"""The colours: Okabe and Ito's, which the colour-blind distinguish, for what matters, on a quiet ground."""

Color = tuple[int, int, int]

TRUTH: Color = (0, 114, 178)  # Okabe and Ito's blue
TRUE_PATH: Color = (88, 160, 210)  # the same, lighter: the estimate's line is seen on it
ESTIMATE: Color = (213, 94, 0)  # vermilion
SLIDING: Color = (240, 228, 66)  # yellow
SLIPPERY: Color = (86, 180, 233)  # sky blue
ROUGH: Color = (230, 159, 0)  # orange

FAINT_PATH: Color = (186, 214, 235)  # lighter again: where the last axle of a train went
TARGET: Color = (105, 108, 114)
CABLE: Color = (84, 74, 68)
DECK: Color = (178, 207, 228)
TYRE: Color = (38, 41, 46)
IDLE_TYRE: Color = (118, 122, 128)
METAL: Color = (160, 166, 174)
BEAM: Color = (0, 158, 115)  # Okabe and Ito's green

ARENA: Color = (250, 249, 247)
OUTSIDE: Color = (239, 238, 233)
GRID: Color = (216, 214, 207)
AXES: Color = (180, 177, 169)
INK: Color = (52, 56, 62)
FADED: Color = (115, 119, 125)
WHITE: Color = (255, 255, 255)
