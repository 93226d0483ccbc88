"""The faulty-plant simulator: hydraulics, drive, friction, oil, sensors, controllers, scenarios."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
