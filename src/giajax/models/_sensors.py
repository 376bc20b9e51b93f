"""What records an arm: a camera with its frame, scale and clock, markers, and angle sensors.

Every parameter is optional; what is left out costs nothing. A camera shows a point p of the base
frame at scale * R^T (p - origin), R being the turn of the camera frame against the base frame.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._maths import rotate, rotation_vector_to_quaternion, scaled
from .._typing import Array, Float, Scalar
from ..arm import Arm, pose
from ..parameters import declared, inline, parameter
from ..quantities import CAMERA, ENCODER, LANDMARK, MARKER
from ._pinhole import Pinhole


class Camera(eqx.Module):
    """Frame, scale and clock of recorded positions; and the cameras whose pixels are recorded."""

    rotation: Float[Array, "3"] | None = parameter(CAMERA.rotation)
    origin: Float[Array, "3"] | None = parameter(CAMERA.origin)
    scale: Scalar | None = parameter(CAMERA.scale)
    delay: Scalar | None = parameter(CAMERA.delay)
    # By name, which is part of the paths: `camera.side.position`.
    pinholes: dict[str, Pinhole] = inline(default_factory=dict)

    def sees(self, positions: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Positions (m) of the base frame as they are recorded; the clock apart."""
        if self.origin is not None:
            positions = positions - self.origin.reshape((1,) * (positions.ndim - 1) + (3,))
        if self.rotation is not None:
            back = rotation_vector_to_quaternion(-self.rotation)
            rows = positions.reshape(-1, 3).T
            turned = rotate(jnp.broadcast_to(back[:, None], (4, rows.shape[1])), rows)
            positions = turned.T.reshape(positions.shape)
        return positions if self.scale is None else self.scale * positions


class Landmark(eqx.Module):
    """A point of the room that cameras see."""

    position: Float[Array, "3"] = parameter(LANDMARK.position)


class Marker(eqx.Module):
    """Where the tracked points lie, in the frame of their link."""

    along: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.along)
    left: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.left)
    up: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.up)
    tip: Float[Array, "3"] | None = parameter(MARKER.tip)

    def on_links(self, arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "link 3"]:
        """Positions of the links' markers in the base frame, m."""
        here = pose(arm, angles, sideways=self.left is not None or self.up is not None)
        points = here.centre

        def each(offset: Array) -> Array:
            return jnp.broadcast_to(offset, (arm.count,))

        if self.along is not None:
            points = points + scaled(each(self.along), here.direction)
        if self.left is not None:
            assert here.left is not None
            points = points + scaled(each(self.left), here.left)
        if self.up is not None:
            points = points + scaled(each(self.up), here.up)
        return points.T

    def at_tip(self, arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "3"]:
        """Position of the tip's marker in the base frame, m."""
        here = pose(arm, angles, sideways=self.tip is not None)
        end = scaled(arm.links.length, here.direction).sum(axis=-1)
        if self.tip is None:
            return end
        assert here.left is not None
        frame = jnp.stack([here.direction[:, -1], here.left[:, -1], here.up[:, -1]], axis=1)
        return end + frame @ self.tip


class Encoder(eqx.Module):
    """Zero, scale and clock of the joints' angle sensors; angles of links are their sums."""

    offset: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.offset)
    scale: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.scale)
    delay: Scalar | None = parameter(ENCODER.delay)

    def shows(self, angles: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        """Recorded joint angles, rad; the clock apart."""
        shown = self.shows_rates(angles)
        return shown if self.offset is None else shown + _row(self.offset, shown)

    def shows_rates(self, rates: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        """Recorded joint rates, rad/s; the clock apart."""
        return rates if self.scale is None else rates * _row(self.scale, rates)

    def true_angles(self, shown: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Joint angles (rad) that are shown so: the inverse of `shows`; the clock apart."""
        return self.true_rates(shown if self.offset is None else shown - self.offset)

    def true_rates(self, shown: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Joint rates (rad/s) that are shown so: the inverse of `shows_rates`."""
        return shown if self.scale is None else shown / self.scale


def _row(value: Array, table: Array) -> Array:
    return jnp.broadcast_to(value, table.shape[1:])[None]


class Sensors(eqx.Module):
    """All that stands between the motion of an arm and its recording."""

    camera: Camera = eqx.field(default_factory=Camera)
    marker: Marker = eqx.field(default_factory=Marker)
    encoder: Encoder = eqx.field(default_factory=Encoder)
    landmark: dict[str, Landmark] = eqx.field(default_factory=dict)

    def check(self, joints: int) -> None:
        """Refuse values for another number of links or joints.

        Raises:
            InputError: naming the parameter and both numbers.
        """
        for name, known in declared(self).items():
            shape = known.value(self).shape
            if known.declaration.per and shape not in ((), (joints,)):
                raise InputError(
                    f"{name} has {np.prod(shape)} values for an arm of {joints} links: give one "
                    "number, or one for each"
                )

    def link_positions(
        self, arm: Arm, angles: Float[Array, "sample joint"]
    ) -> Float[Array, "sample link 3"]:
        """Recorded positions of the links' markers, m."""
        return self.camera.sees(jax.vmap(lambda row: self.marker.on_links(arm, row))(angles))

    def tip_positions(
        self, arm: Arm, angles: Float[Array, "sample joint"]
    ) -> Float[Array, "sample 3"]:
        """Recorded positions of the tip's marker, m."""
        return self.camera.sees(jax.vmap(lambda row: self.marker.at_tip(arm, row))(angles))
