"""The type of arrays of numbers, as it stands in signatures; shapes and units are in docstrings."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
