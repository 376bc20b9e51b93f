"""Distortion of a lens: OpenCV's model of five coefficients (Brown-Conrady), and its inverse."""

import jax
import jax.numpy as jnp

from .._typing import Array, Float

# Beyond this tangent of the angle to the optical axis (84 degrees) the polynomial is held: it is
# fitted to what a picture shows, and grows with the seventh power.
_STEEPEST = 10.0

# Newton steps of the inverse; each squares the error, and lenses distort by some per cent.
_STEPS = 12


def distorted(
    flat: Float[Array, "2 point"], coefficients: Float[Array, "5"] | None
) -> Float[Array, "2 point"]:
    """Points of the plane at distance 1, as a lens shows them there.

    With r^2 = x^2 + y^2

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

    ("Camera Calibration and 3D Reconstruction" of OpenCV's documentation).

    Arguments:
        flat: x and y over the depth, shape (2, point).
        coefficients: k1, k2, p1, p2, k3 in OpenCV's order; None: no distortion.
    """
    if coefficients is None:
        return flat
    k1, k2, p1, p2, k3 = coefficients
    x, y = flat
    squared = x * x + y * y
    held = jnp.minimum(squared, _STEEPEST**2)
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
    """The points that a lens shows where these are: the inverse of `distorted`, by Newton's method.

    It exists within the part of the picture in which the distortion does not fold it over.
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
