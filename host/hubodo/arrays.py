"""Type of the arrays of float64 that all modules use."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
