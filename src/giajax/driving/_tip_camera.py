"""What the camera at the tip shows, some time ago."""

from collections import deque
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._program import program
from .._typing import Array, Float
from ..arm import Arm
from ..models import ArmModel, Pinhole, View

LATENCY = 0.2
"""Of a picture on its way to the operator, s, unless stated."""


def usual() -> Pinhole:
    """A camera that looks ahead from the end of the arm, 90 deg wide: where the arm has none."""
    return Pinhole(
        position=jnp.zeros(3),
        rotation=jnp.zeros(3),
        focal_length=jnp.asarray(320.0),
        centre=jnp.asarray([319.5, 239.5]),
        mount="tip",
        size=(640, 480),
    )


class TipCamera:
    """The view of a camera on the arm, as an operator has it: late, and rolling with the arm.

    Arguments:
        model: of the arm; its camera at the tip is taken, if it has one.
        latency: of the picture, s.

    Raises:
        InputError: a latency that is negative or longer than a minute.
    """

    def __init__(self, model: ArmModel, latency: float = LATENCY) -> None:
        if not 0 <= latency <= 60:
            raise InputError(f"the latency is {latency:g} s: give one from 0 to 60")
        pinholes = model.sensors.camera.pinholes.values()
        self.camera = next((each for each in pinholes if each.mount == "tip"), usual())
        self.latency = latency
        self._arm = model.arm
        self._views: deque[tuple[float, View]] = deque()

    def see(self, time: float, angles: Float[np.ndarray, " joint"]) -> View:
        """What is shown at a time, s, in which the arm is at these angles, rad."""
        self._views.append((time, _view(self.camera, self._arm, jnp.asarray(angles))))
        while len(self._views) > 1 and self._views[1][0] <= time - self.latency + 1e-9:
            self._views.popleft()
        return self._views[0][1]

    def facts(self) -> dict[str, Any]:
        """What a page needs to draw its picture: focal length and centre (px), and size."""
        across = float(self.camera.focal_length)
        aspect = 1.0 if self.camera.aspect is None else float(self.camera.aspect)
        return {
            "focal": [across, across * aspect],
            "centre": np.asarray(self.camera.centre).tolist(),
            "size": list(self.camera.size),
        }


@program
def _view(camera: Pinhole, arm: Arm, angles: Array) -> View:
    return camera.view(arm, angles)
