"""Cameras: image points from points in space, by projection and lens distortion."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import Arm, pose
from ..runtime.arrays import (
    Array,
    Bool,
    Float,
    Scalar,
    rotate,
    rotation_vector_to_quaternion,
    smaller,
)
from ..runtime.text import InputError
from ..schema import PINHOLE
from ..schema.parameters import parameter

# Beyond this tangent of the angle to the optical axis (84 degrees) the polynomial is constant,
# because it is fitted inside the image and grows with the seventh power.
_STEEPEST = 10.0

# Newton steps of the inverse. Each step squares the error, and lenses distort by a few per cent.
_STEPS = 12


def distorted(
    flat: Float[Array, "2 point"], coefficients: Float[Array, "5"] | None
) -> Float[Array, "2 point"]:
    """Apply lens distortion to points in the plane at distance 1; None means no distortion.

    With r^2 = x^2 + y^2

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

    (Brown-Conrady, as in "Camera Calibration and 3D Reconstruction" of the OpenCV documentation).
    The coefficients are k1, k2, p1, p2, k3, in the order of OpenCV.
    """
    if coefficients is None:
        return flat
    k1, k2, p1, p2, k3 = coefficients
    x, y = flat
    squared = x * x + y * y
    held = smaller(squared, _STEEPEST**2)
    radial = 1 + held * (k1 + held * (k2 + held * k3))
    return jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x * x),
            y * radial + p1 * (squared + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def undistorted(
    shown: Float[Array, "point 2"], coefficients: Float[Array, "5"] | None
) -> Float[Array, "point 2"]:
    """Invert `distorted` by Newton's method: return the points that a lens shows at these points.

    The inverse exists in the part of the image in which the distortion is one-to-one.
    """
    if coefficients is None:
        return shown

    def one(flat: Array) -> Array:
        return distorted(flat[:, None], coefficients)[:, 0]

    def inverse(wanted: Array) -> Array:
        def step(_: int, at: Array) -> Array:
            return at - jnp.linalg.solve(jax.jacfwd(one)(at), one(at) - wanted)

        return jax.lax.fori_loop(0, _STEPS, step, wanted)

    return jax.vmap(inverse)(shown)


# A camera with a lens: from points of the world to pixels of its image, and back to rays.
#
# Its axes are those of OpenCV: x to the right in the image, y down, and z into the image. A camera
# with zero rotation looks along the x axis of the frame it is mounted on, and the z axis of that
# frame is up in the image.

# Columns: the camera's x, y and z axes (right, down, forwards) in the frame of an unrotated camera.
_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

NEAR = 0.1
"""Minimum distance in front of a lens at which a point is visible, m."""


class Projection(NamedTuple):
    """Positions of points in an image.

    Attributes:
        pixels: u to the right and v down, px; (0, 0) is the centre of the first pixel.
        depth: distance in front of the lens along the optical axis, m; negative behind it.
    """

    pixels: Float[Array, "*point 2"]
    depth: Float[Array, "*point"]


class View(NamedTuple):
    """Position and orientation of a camera in the base frame.

    Attributes:
        centre: centre of the lens, m.
        axes: unit vectors to the right, down and into the image, as columns. A point p of the
            base frame is at axes^T (p - centre) in the camera frame. R and t of OpenCV are axes^T
            and -axes^T centre.
    """

    centre: Float[Array, "*view 3"]
    axes: Float[Array, "*view 3 3"]


class Pinhole(eqx.Module):
    """A camera with a lens, fixed in the room or mounted on a link.

    Arguments:
        position: centre of the lens, m, shape (3,), in the base frame. For a camera on a link, the
            components are along, left and up from the centre of the link, or from the end of the
            last link.
        rotation: rotation vector, rad, shape (3,); with zero rotation the camera looks along x.
        focal_length: focal length, px.
        aspect: aspect ratio of a pixel; None means square pixels.
        centre: point of the image on the optical axis, px, shape (2,).
        distortion: k1, k2, p1, p2, k3; None means no distortion.
        delay: age of an image at its time stamp, s, in addition to `camera.delay`, which all
            cameras share; None means no additional delay.
        mount: "room", "tip" or a link such as "link06".
        size: width and height of the image, px; points outside are not seen.

    Example:
        >>> import jax.numpy as jnp
        >>> from giajax.models import Pinhole
        >>> camera = Pinhole(position=[0.0, -10.0, 0.0], rotation=[0.0, 0.0, jnp.pi / 2],
        ...     focal_length=1000.0, centre=[960.0, 540.0])
        >>> seen = camera.project(jnp.array([[1.0, 0.0, 0.5]]))
        >>> [round(float(each), 6) for each in seen.pixels[0]], round(float(seen.depth[0]), 6)
        ([1060.0, 490.0], 10.0)
    """

    position: Float[Array, "3"] = parameter(PINHOLE.position)
    rotation: Float[Array, "3"] = parameter(PINHOLE.rotation)
    focal_length: Scalar = parameter(PINHOLE.focal_length)
    aspect: Scalar | None = parameter(PINHOLE.aspect)
    centre: Float[Array, "2"] = parameter(PINHOLE.centre)
    distortion: Float[Array, "5"] | None = parameter(PINHOLE.distortion)
    delay: Scalar | None = parameter(PINHOLE.delay)
    mount: str = eqx.field(default="room", static=True)
    size: tuple[int, int] = eqx.field(default=(1920, 1080), static=True)

    def view(self, arm: Arm | None = None, angles: Float[Array, " joint"] | None = None) -> View:
        """Return the pose of the camera; one on a link requires an arm and its angles, rad.

        Raises:
            InputError: the camera is on an arm, but no arm is given, or one with too few links.
        """
        axes = self._axes()
        if self.mount == "room":
            return View(self.position, axes)
        if arm is None or angles is None:
            raise InputError(
                f"a camera on {self.mount!r} requires an arm and its joint angles: give both"
            )
        place = arm.count if self.mount == "tip" else int(self.mount.removeprefix("link"))
        if place > arm.count:
            raise InputError(
                f"a camera is on link {place}, but the arm has only {arm.count} links: correct "
                f"the mount of the camera"
            )
        here = pose(arm, angles, sideways=True)
        assert here.left is not None
        frame = jnp.stack([rows[:, place - 1] for rows in (here.direction, here.left, here.up)], 1)
        origin = here.centre[:, place - 1]
        if self.mount == "tip":
            origin = here.joint[:, -1] + arm.links.length[-1] * here.direction[:, -1]
        return View(origin + frame @ self.position, frame @ axes)

    def mounted_at(self, view: View) -> Float[Array, "3"]:
        """Return the position of the camera mount according to a view, m.

        For a camera in the room this is the origin of the base frame. For a camera on the tip it is
        the end of the last link.
        """
        return view.centre - view.axes @ self._axes().T @ self.position

    def _axes(self) -> Float[Array, "3 3"]:
        """Return the camera axes in the frame of the mount, as columns."""
        turn = rotation_vector_to_quaternion(self.rotation)
        return rotate(
            jnp.broadcast_to(turn[:, None], (4, 3)), jnp.asarray(_AXES, self.rotation.dtype)
        )

    def project(
        self,
        points: Float[Array, "*point 3"],
        arm: Arm | None = None,
        angles: Float[Array, " joint"] | None = None,
    ) -> Projection:
        """Project points of the base frame (m) onto the image: pixels, and depths (m).

        u = f x'' + c_u and v = f aspect y'' + c_v, where x'' and y'' are x / z and y / z in the
        camera frame after lens distortion: the model of OpenCV ("Camera Calibration and 3D
        Reconstruction"). For points nearer than `NEAR` or behind the camera, 1 / z is continued
        linearly, so pixels and derivatives stay finite; such points are not seen (`sees`). Arm and
        angles are arguments of `view`, which may raise an error.
        """
        return self.project_from(self.view(arm, angles), points)

    def project_from(self, view: View, points: Float[Array, "*point 3"]) -> Projection:
        """Project points onto the image of a camera in the pose of a view; see `project`."""
        rows = points.reshape(-1, 3)
        x, y, depth = ((rows - view.centre[None]) @ view.axes).T
        far = jnp.where(depth > NEAR, depth, NEAR)
        inverse = jnp.where(depth > NEAR, 1 / far, (2 - depth / NEAR) / NEAR)
        flat = distorted(jnp.stack([x * inverse, y * inverse]), self.distortion)
        scale = self._focal()
        pixels = (flat * scale[:, None] + self.centre[:, None]).T
        return Projection(pixels.reshape(*points.shape[:-1], 2), depth.reshape(points.shape[:-1]))

    def sees(self, seen: Projection) -> Bool[Array, "*point"]:
        """Return which projected points are in front of the lens and inside the image."""
        edge = jnp.asarray(self.size, seen.pixels.dtype) - 0.5
        edge = edge.reshape((1,) * (seen.pixels.ndim - 1) + (2,))
        within = jnp.all((seen.pixels >= -0.5) & (seen.pixels <= edge), axis=-1)
        return within & (seen.depth > NEAR)

    def rays(
        self,
        pixels: Float[Array, "*point 2"],
        arm: Arm | None = None,
        angles: Float[Array, " joint"] | None = None,
    ) -> Float[Array, "*point 3"]:
        """Return the unit vectors in the base frame along which the camera sees pixels.

        This is the inverse of `project`, up to the distance, for pixels in or near the image. The
        distortion is inverted by Newton's method. Arm and angles are arguments of `view`, which may
        raise an error.
        """
        axes = self.view(arm, angles).axes
        return (self.directions(pixels).reshape(-1, 3) @ axes.T).reshape(*pixels.shape[:-1], 3)

    def directions(self, pixels: Float[Array, "*point 2"]) -> Float[Array, "*point 3"]:
        """Return unit vectors (right, down, forwards) along which pixels are seen; see `rays`."""
        flat = undistorted(
            (pixels.reshape(-1, 2) - self.centre[None]) / self._focal()[None], self.distortion
        )
        ahead = jnp.concatenate([flat, jnp.ones_like(flat[:, :1])], axis=1)
        ahead = ahead / jnp.linalg.norm(ahead, axis=1, keepdims=True)
        return ahead.reshape(*pixels.shape[:-1], 3)

    def _focal(self) -> Float[Array, "2"]:
        """Return the horizontal and vertical focal lengths, px."""
        across = self.focal_length
        return jnp.stack([across, across if self.aspect is None else across * self.aspect])
