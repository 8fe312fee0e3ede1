"""The type of arrays of numbers, as it stands in signatures; shapes and units are in docstrings."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Real numbers of any kind, where they are taken as they come.
Numbers = NDArray[Any]
