"""What is drawn in which colour: of a palette that the colour-blind tell apart."""

import numpy as np

from .._typing import Int
from ..models import Scene

Colour = tuple[int, int, int]

INK: Colour = (40, 40, 40)
RECORDED: Colour = (213, 94, 0)
AIR: Colour = (0, 158, 115)
CONTACT: Colour = (204, 51, 17)
BUILDING: Colour = (176, 168, 158)
BODIES: dict[str, Colour] = {
    "blue": (86, 140, 190),
    "orange": (222, 150, 60),
    "green": (110, 165, 95),
    "purple": (165, 110, 175),
}
"""Of the balloons of one show after the other."""

# From an empty muscle to the highest pressure: blue, white, red would vanish on the page.
_EMPTY, _FULL = np.array([70.0, 90.0, 160.0]), np.array([215.0, 48.0, 39.0])


def darker(colour: Colour) -> Colour:
    """A colour for dots within bodies of this colour."""
    red, green, blue = (int(0.45 * part) for part in colour)
    return red, green, blue


def thread_colours(scene: Scene, sample: int, highest: float) -> Int[np.ndarray, "piece 3"]:
    """The colour of each piece of each thread of a scene: by its pressure, where it has one.

    Arguments:
        scene: the scene.
        sample: which sample.
        highest: pressure that is the brightest, Pa.
    """
    colours = []
    for line in scene.lines:
        if np.any(line.radii > 0):
            continue
        colour = np.array(INK, dtype=float)
        if line.pressure is not None and highest > 0:
            share = np.clip(line.pressure[sample] / highest, 0, 1)
            colour = (1 - share) * _EMPTY + share * _FULL
        colours += [colour] * (line.points.shape[1] - 1)
    return np.array(colours).reshape(-1, 3).astype(np.uint8)
