"""What is between the pressures of muscles and the arm, beside the muscles themselves."""

import equinox as eqx

from .._typing import Scalar
from ..parameters import parameter
from ..quantities import DRIVE


class MuscleDrive(eqx.Module):
    """Lag of the pressures, and what else acts on joints with muscles.

    Arguments:
        lag: time in which a pressure follows its command to 63 %, s; None where it does at once.
        passive_stiffness: of what else pulls a joint with muscles to its straight pose, N m/rad;
            None for nothing.
        stop_stiffness: with which a joint stops beyond 60 deg, N m/rad.
    """

    lag: Scalar | None = parameter(DRIVE.lag)
    passive_stiffness: Scalar | None = parameter(DRIVE.passive_stiffness)
    stop_stiffness: Scalar = parameter(DRIVE.stop_stiffness)
