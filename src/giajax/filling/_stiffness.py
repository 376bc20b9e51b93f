"""How stiff an inflated link is."""

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]

# Half of the angle of the tube that is in wrinkles.
_ANGLES = np.linspace(0, np.pi, 4001)[:-1]


def stiff_share(load: Numbers) -> Numbers:
    """Bending stiffness of an inflated membrane tube over that without wrinkles.

    Comer and Levy (AIAA Journal 1, 1963): the side that would be compressed wrinkles over the
    angle 2 t, the rest is stressed in proportion to its distance from the wrinkles, and

        M / (p pi r^3) = (2 (pi - t) + sin 2t) / (4 ((pi - t) cos t + sin t)),
        M / (curvature E t pi r^3) = 1 - t / pi + sin 2t / (2 pi).

    Wrinkles begin at half of p pi r^3, and at p pi r^3 the tube folds.

    Arguments:
        load: moment over p pi r^3.

    Returns:
        1 without wrinkles, 0 for a tube that folds.
    """
    t = _ANGLES
    moment = (2 * (np.pi - t) + np.sin(2 * t)) / (4 * ((np.pi - t) * np.cos(t) + np.sin(t)))
    share = 1 - t / np.pi + np.sin(2 * t) / (2 * np.pi)
    found: Numbers = np.interp(load, moment, share, right=0.0)
    return found
