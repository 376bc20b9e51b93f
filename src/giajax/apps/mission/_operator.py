"""Who drives the arm: commands from what a picture shows, with limits."""

import dataclasses
from typing import NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...mechanics.arm import Arm, pose, tip_position
from ...models import Pinhole, View
from ...runtime.arrays import (
    Array,
    Bool,
    Float,
    Scalar,
    cross,
    rotate,
    rotation_vector_to_quaternion,
    safe_norm,
)
from ...runtime.text import InputError
from ...schema import MissionSection
from ._controller import METRES, AbstractController, Opening, Picture, Scene, number, within_limits


def posed(camera: Pinhole, opening: Opening, pixels: Float[Array, "4 2"]) -> View:
    """The view of a camera that sees all corners of an opening: four points of a plane.

    The homography from the plane to the picture has two axes of the plane and its origin, as the
    camera has them, as its columns (Zhang, IEEE PAMI 22 (2000) 1330).
    """
    rays = camera.directions(pixels)
    flat = opening.local(opening.corners)[:, 1:]
    x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    u, v = flat.T
    rows = jnp.concatenate(
        [
            jnp.stack([u, v, one, zero, zero, zero, -x * u, -x * v], axis=1),
            jnp.stack([zero, zero, zero, u, v, one, -y * u, -y * v], axis=1),
        ]
    )
    found = jnp.linalg.solve(rows, jnp.concatenate([x, y]))
    plane = jnp.concatenate([found, jnp.ones(1, found.dtype)]).reshape(3, 3)
    scale = 2 / (safe_norm(plane[:, 0]) + safe_norm(plane[:, 1]))
    plane = scale * plane * jnp.sign(plane[2, 2])
    first = plane[:, 0] / safe_norm(plane[:, 0])
    second = plane[:, 1] - jnp.sum(first * plane[:, 1]) * first
    second = second / safe_norm(second)
    # Columns: outwards, to the left and up, in the camera's frame.
    turn = jnp.stack([cross(first, second), first, second], axis=1)
    axes = opening.frame @ turn.T
    return View(opening.centre - axes @ plane[:, 2], axes)


# Position, velocity and turn of the camera.
_PLACE, _SPEED, _TURN = slice(0, 3), slice(3, 6), slice(6, 9)

# Standard deviation of the velocity of a camera that rests, for all that is known, m/s.
_STILL = 0.2

# Corners that have a pose, in place of those that nobody sees.
_SQUARE = np.array([[100.0, 100.0], [200.0, 100.0], [200.0, 200.0], [100.0, 200.0]])


class Sight(NamedTuple):
    """Where an operator believes the camera to be.

    Attributes:
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
        """After a look at a picture: pixels of the opening's corners, and which of them are seen.

        Commands would have the camera elsewhere; the picture before is an interval (s) old.
        """
        # Where the whole opening is in view, and not where it was believed to be, anew from there.
        off = camera.project_from(sight.view, opening.corners).pixels - pixels
        lost = jnp.all(seen) & (jnp.max(jnp.abs(off)) > self.astonishing)
        corners = jnp.where(seen[:, None], pixels, jnp.asarray(_SQUARE, pixels.dtype))
        fresh = self.start(posed(camera, opening, corners))
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
        sizes = ((8, self.pixel**2), (3, self.astray**2 * share), (3, self.askew**2 * share))
        spread = jnp.concatenate([jnp.full(count, size) for count, size in sizes])
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


class OperatorMemory(NamedTuple):
    """What an operator remembers.

    Attributes:
        blind: for how long the opening was not seen, s.
    """

    sight: Sight
    blind: Scalar


class Operator(AbstractController):
    """An operator who has the drawing, the commands so far, and a late picture from the tip.

    Until the opening comes into view, and where it has been out of it for too long, joints go to
    the `approach`. Else the tip is driven to a place before the opening, the nearer to its axis the
    closer, and through it: joints turn so that the tip would move faster than it is seen to move by
    a multiple of what is missing, and the camera looks to where it goes. The commanded shape is
    taken for the arm's: where it really is, and what blows, the operator does not know. Once
    inside, the operator sees the room, and holds still.

    Attributes:
        approach: commanded angles from which the opening is in view, rad, shape (joint,).
        approach_rate: of the joint that turns the most, rad/s.
        latency: of picture and hand, s.
        speed: of the tip at most, m/s.
        largest_rate, largest_angle: of the command of a joint, rad/s and rad.
        stand_off: distance before the opening at which the tip goes to its axis, m.
        patience: without a picture of the opening, s.
        near: distance from the opening's axis within which the tip goes in, m.
        deep: how far inside it wants to be, m.
        closing: speed over distance, 1/s.
        push: how much faster a command moves than what is missing in speed.
        looking: how fast the camera is turned to where it shall look, 1/s.
        posture: how fast what the task leaves open goes back to the approach, 1/s.
    """

    approach: Float[Array, " joint"]
    approach_rate: Scalar = number(np.deg2rad(1.0))
    latency: Scalar = number(0.4)
    speed: Scalar = number(0.2)
    largest_rate: Scalar = number(np.deg2rad(2.0))
    largest_angle: Scalar = number(np.deg2rad(60.0))
    stand_off: Scalar = number(2.0)
    patience: Scalar = number(20.0)
    near: Scalar = number(0.5)
    deep: Scalar = number(1.0)
    closing: Scalar = number(0.1)
    push: Scalar = number(2.0)
    looking: Scalar = number(0.5)
    posture: Scalar = number(0.02)
    tracking: Tracking = eqx.field(default_factory=Tracking)

    @classmethod
    def from_section(cls, section: MissionSection, joints: int) -> Self:
        """Who a `[mission]` says."""
        stated = section.operator
        approach = np.zeros(joints)
        for joint, angle in zip(stated.approach.joints, stated.approach.angles_deg, strict=True):
            if joint > joints:
                raise InputError(
                    f"mission.operator.approach bends joint {joint}, but the arm has only {joints} "
                    "joints: correct the number"
                )
            approach[joint - 1] = np.deg2rad(angle)
        return cls(
            approach=jnp.asarray(approach),
            approach_rate=jnp.asarray(np.deg2rad(stated.approach_rate_deg_per_s)),
            latency=jnp.asarray(stated.latency_s),
            speed=jnp.asarray(stated.speed_m_per_s),
            largest_rate=jnp.asarray(np.deg2rad(stated.largest_rate_deg_per_s)),
            largest_angle=jnp.asarray(np.deg2rad(stated.largest_angle_deg)),
            stand_off=jnp.asarray(stated.stand_off_m),
            patience=jnp.asarray(stated.patience_s),
            deep=jnp.asarray(2 * section.beyond_m),
            tracking=Tracking(pixel=jnp.asarray(2 * stated.pixel_px)),
        )

    def start(self, scene: Scene, late: int) -> OperatorMemory:
        """Where the straight arm has the camera, and nothing seen yet."""
        del late
        view = scene.camera.view(scene.arm, jnp.zeros_like(self.approach))
        return OperatorMemory(self.tracking.start(view), self.patience + scene.interval)

    def decide(
        self, scene: Scene, memory: OperatorMemory, picture: Picture, command: Array
    ) -> tuple[OperatorMemory, Float[Array, " joint"]]:
        """Commands by what is seen, with the drawn lengths and axes of the arm."""
        interval = scene.interval
        commanded = scene.camera.view(scene.arm, picture.commanded)
        sight = self.tracking.corrected(
            self.tracking.later(memory.sight, interval),
            scene.camera, scene.opening, picture.pixels, picture.seen, commanded, interval,
        )  # fmt: skip
        blind = picture.blind(memory.blind, interval)
        back = self.approach - command
        away = jnp.maximum(jnp.max(jnp.abs(back)) / self.approach_rate, interval)
        served = self._served(scene.arm, command, self._task(scene, sight))
        rates = jnp.where(blind > self.patience, back / away, served)
        limits = self.largest_rate, self.largest_angle
        after = within_limits(command, rates, interval, *limits)
        return OperatorMemory(sight, blind), jnp.where(picture.room, command, after)

    def keeping_station(self) -> Self:
        """The same, at the stand-off."""
        return dataclasses.replace(self, deep=-self.stand_off)

    def believed(self, scene: Scene, memory: OperatorMemory) -> Float[Array, "3"]:
        """The camera of the filter."""
        del scene
        return memory.sight.view.centre

    def _served(self, arm: Arm, command: Array, task: Float[Array, "6"]) -> Array:
        """Rates that bring the tip to where the picture says that it should be."""
        axes = pose(arm, command).axis
        rows = jnp.concatenate([jax.jacfwd(lambda q: tip_position(arm, q))(command), METRES * axes])
        # What the task leaves open goes back to the shape of the approach.
        easy = self.posture * (self.approach - command)

        def turned(free: Array) -> Array:
            reached = rows * free[None]
            damped = reached @ reached.T + jnp.eye(6, dtype=rows.dtype)
            return free * (easy + reached.T @ jnp.linalg.solve(damped, task - reached @ easy))

        first = turned(jnp.ones_like(command))
        # A joint at its limit does not take its part: the others do it all.
        beyond = (jnp.abs(command + first / 2) >= self.largest_angle) & (command * first > 0)
        return turned(jnp.where(beyond, 0, 1).astype(command.dtype))

    def _task(self, scene: Scene, sight: Sight) -> Float[Array, "6"]:
        """Velocity of the tip and turn of the camera that commands shall make, in metres."""
        opening, velocity = scene.opening, sight.velocity
        tip = scene.camera.mounted_at(sight.view) + self.latency * velocity
        local = opening.local(tip)
        outside = opening.outside(local, near=self.near, stand_off=self.stand_off, deep=self.deep)
        # Where it is inside it stays inside.
        outside = jnp.where(local[0] < -opening.thickness, -self.deep, outside)
        wanted = self.closing * jnp.concatenate([(outside - local[0])[None], -local[1:]])
        wanted = wanted / jnp.maximum(1, safe_norm(wanted) / self.speed)
        missing = self.push * (opening.frame @ wanted - velocity)
        ahead = opening.ahead - tip
        turn = self.looking * cross(sight.view.axes[:, 2], ahead / safe_norm(ahead))
        return jnp.concatenate([missing, METRES * turn])
