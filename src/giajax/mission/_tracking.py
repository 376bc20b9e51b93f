"""What an operator makes of pictures: where the camera is, how fast, and how sure that is."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._maths import cross, rotate, rotation_vector_to_quaternion
from .._typing import Array, Bool, Float, Scalar
from ..models import Pinhole, View
from ._opening import Opening
from ._posed import posed

# Position, velocity and turn of the camera.
_PLACE, _SPEED, _TURN = slice(0, 3), slice(3, 6), slice(6, 9)

# Standard deviation of the velocity of a camera that rests, for all that is known, m/s.
_STILL = 0.2

# Corners that have a pose, in place of those that nobody sees.
_SQUARE = np.array([[100.0, 100.0], [200.0, 100.0], [200.0, 200.0], [100.0, 200.0]])


def number(default: float) -> Any:
    """A field that a program takes as an argument, so that another value is no other program."""
    return eqx.field(converter=lambda x: jnp.asarray(x, jnp.result_type(float)), default=default)


class Sight(NamedTuple):
    """Where an operator believes the camera to be.

    Attributes:
        view: of the camera.
        velocity: m/s.
        covariance: of position, velocity and turn.
    """

    view: View
    velocity: Float[Array, "3"]
    covariance: Float[Array, "9 9"]


class Tracking(eqx.Module):
    """An extended Kalman filter for the pose of a camera that sees the corners of an opening.

    Between pictures the camera drifts on with a velocity that dies away. Where the arm was told to
    go is a vague observation, too: it is all that there is before the opening comes into view.

    Arguments:
        pixel: standard deviation of a corner in the picture, px.
        acceleration: of the camera, m/s^2 in a square root of a second.
        persistence: of its velocity, s.
        turning: of the camera, rad in a square root of a second.
        astray: how far the camera is from where its commands would have it, m.
        askew: how far it is turned from there, rad.
        memory: time over which that is one observation, s.
        astonishing: distance of a corner from where it was expected, px, at which what was
            believed is given up for what is seen.
    """

    pixel: Scalar = number(2.0)
    acceleration: Scalar = number(0.03)
    persistence: Scalar = number(8.0)
    turning: Scalar = number(0.01)
    astray: Scalar = number(3.0)
    askew: Scalar = number(0.5)
    memory: Scalar = number(300.0)
    astonishing: Scalar = number(12.0)

    def start(self, view: View) -> Sight:
        """At rest where commands would have the camera."""
        zero = jnp.zeros_like(view.centre)
        still = jnp.full_like(self.astray, _STILL)
        spread = jnp.stack([self.astray, still, self.askew])
        return Sight(view, zero, jnp.diag(jnp.repeat(spread**2, 3, total_repeat_length=9)))

    def later(self, sight: Sight, interval: Scalar) -> Sight:
        """After a time without a picture, s."""
        keep = jnp.exp(-interval / self.persistence)
        one = jnp.eye(9, dtype=interval.dtype)
        move = one.at[_PLACE, _SPEED].set(interval * jnp.eye(3, dtype=interval.dtype))
        move = move.at[_SPEED, _SPEED].set(keep * jnp.eye(3, dtype=interval.dtype))
        rates = jnp.stack([jnp.zeros_like(interval), self.acceleration, self.turning])
        added = jnp.repeat(rates**2 * interval, 3, total_repeat_length=9)
        centre = sight.view.centre + interval * sight.velocity
        covariance = move @ sight.covariance @ move.T + jnp.diag(added)
        return Sight(View(centre, sight.view.axes), keep * sight.velocity, covariance)

    def corrected(
        self,
        sight: Sight,
        camera: Pinhole,
        opening: Opening,
        pixels: Float[Array, "4 2"],
        seen: Bool[Array, "4"],
        commanded: View,
        interval: Scalar,
    ) -> Sight:
        """After a look at a picture.

        Arguments:
            sight: before.
            camera: whose picture it is.
            opening: whose corners are in it.
            pixels: where they are.
            seen: which of them are.
            commanded: where commands would have the camera.
            interval: since the picture before, s.
        """
        # Where the whole opening is in view, and not where it was believed to be, anew from there.
        off = camera.project_from(sight.view, opening.corners).pixels - pixels
        lost = jnp.all(seen) & (jnp.max(jnp.abs(off)) > self.astonishing)
        fresh = self.start(
            posed(
                camera,
                opening,
                jnp.where(seen[:, None], pixels, jnp.asarray(_SQUARE, pixels.dtype)),
            )
        )
        sight = jax.tree.map(lambda new, old: jnp.where(lost, new, old), fresh, sight)
        here = sight.view
        visible = jnp.repeat(seen, 2, total_repeat_length=8)

        def expected(change: Array) -> Array:
            """Pixels, and the pose, after a small change of the state."""
            moved = _moved(here, change)
            there = camera.project_from(moved, opening.corners).pixels.reshape(-1)
            askew = sum(
                (cross(moved.axes[:, k], commanded.axes[:, k]) for k in range(3)),
                jnp.zeros_like(here.centre),
            )
            return jnp.concatenate([there, moved.centre, askew / 2])

        zero = jnp.zeros(9, here.centre.dtype)
        slopes, found = jax.jacfwd(expected)(zero), expected(zero)
        share = self.memory / interval
        wanted = jnp.concatenate([pixels.reshape(-1), commanded.centre, jnp.zeros_like(zero[:3])])
        used = jnp.concatenate([visible, jnp.ones(6, bool)])
        slopes = jnp.where(used[:, None], slopes, 0)
        missed = jnp.where(used, wanted - found, 0)
        spread = jnp.concatenate(
            [
                jnp.full(8, self.pixel**2),
                jnp.full(3, self.astray**2 * share),
                jnp.full(3, self.askew**2 * share),
            ]
        )
        covariance = sight.covariance
        cross_covariance = covariance @ slopes.T
        total = slopes @ cross_covariance + jnp.diag(spread)
        gain = jnp.linalg.solve(total, cross_covariance.T).T
        change = gain @ missed
        covariance = covariance - gain @ cross_covariance.T
        covariance = (covariance + covariance.T) / 2
        return Sight(_moved(here, change), sight.velocity + change[_SPEED], covariance)


def _moved(view: View, change: Float[Array, "9"]) -> View:
    turn = rotation_vector_to_quaternion(change[_TURN])
    axes = rotate(jnp.broadcast_to(turn[:, None], (4, 3)), view.axes)
    return View(view.centre + change[_PLACE], axes)
