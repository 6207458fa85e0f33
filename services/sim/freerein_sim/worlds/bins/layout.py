"""Where things are, as in robosuite: the bins, the groceries' sizes, and which compartment is whose; in metres."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Place = npt.NDArray[np.float64]
"""float64 (..., 3): x, y, z in metres."""

FLOOR_M = 0.82
"""Height of the bins' floors."""

WALL_TOP_M = 0.90
COMPARTMENT_HALF_M = (0.09, 0.115)
"""Half extents of a compartment of the right bin along x and y, between its walls."""

LEFT_BIN_M, LEFT_BIN_HALF_M = (0.1, -0.25), (0.19, 0.24)
"""Centre and half extents of the left bin along x and y."""


@dataclass(frozen=True)
class Grocery:
    """One grocery.

    Attributes:
        name: Its name, that of its file in robosuite, too.
        below_m: How far it reaches below its origin when it stands.
        above_m: How far it reaches above.
        grip_m: Height above its origin at which the fingers close.
        width_m: Its extent between the fingers.
        yaw_rad: Turn about z by which its narrow side comes between the fingers.
        compartment_m: x and y of the centre of its compartment.
    """

    name: str
    below_m: float
    above_m: float
    grip_m: float
    width_m: float
    yaw_rad: float
    compartment_m: tuple[float, float]


GROCERIES = (
    Grocery("bread", 0.0233, 0.0247, 0.002, 0.048, 0.0, (0.2, 0.155)),
    Grocery("can", 0.0403, 0.0397, 0.008, 0.050, 0.0, (0.2, 0.405)),
    Grocery("cereal", 0.075, 0.075, 0.040, 0.030, np.pi / 2, (0.0, 0.405)),
    Grocery("milk", 0.061, 0.083, 0.048, 0.040, 0.0, (0.0, 0.155)),
)
