"""Where a driven arm is."""

from typing import NamedTuple

import numpy as np

from .._typing import Float


class Pose(NamedTuple):
    """Where a driven arm is: the latest, and no other.

    Attributes:
        time: that was driven, s.
        angles: of the joints, rad.
        command: commanded angles, rad.
        wind: velocity of the air, m/s, shape (3,).
        stopped: why nothing moves, or None.
        lost: time that the simulation fell behind the clock for good, s.
    """

    time: float
    angles: Float[np.ndarray, " joint"]
    command: Float[np.ndarray, " joint"]
    wind: Float[np.ndarray, "3"]
    stopped: str | None
    lost: float
