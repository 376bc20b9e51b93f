"""Simulated operator of a mission, who commands the joints from the camera picture."""

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
    """Return the pose of a camera that sees all corners of an opening, four points of a plane.

    The columns of the homography from the plane to the picture are two axes of the plane and its
    origin, in the frame of the camera (Zhang, IEEE PAMI 22 (2000) 1330).
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


# Position, velocity and rotation of the camera in the state.
_PLACE, _SPEED, _TURN = slice(0, 3), slice(3, 6), slice(6, 9)

# Initial standard deviation of the velocity of a camera that is assumed to be at rest, m/s.
_STILL = 0.2

# Placeholders for corners that are not visible, from which a pose can be computed.
_SQUARE = np.array([[100.0, 100.0], [200.0, 100.0], [200.0, 200.0], [100.0, 200.0]])


class Sight(NamedTuple):
    """Estimate of the camera by an operator.

    Attributes:
        view: position and axes of the camera.
        velocity: velocity of the camera, m/s.
        covariance: covariance of position, velocity and rotation.
    """

    view: View
    velocity: Float[Array, "3"]
    covariance: Float[Array, "9 9"]


class Tracking(eqx.Module):
    """Extended Kalman filter for the pose of a camera that sees the corners of an opening.

    Between pictures, the camera moves with a decaying velocity. The commanded pose is an additional
    observation with a large standard deviation, and the only one until the opening comes into view.

    Arguments:
        pixel: standard deviation of a corner in the picture, px.
        acceleration: random-walk intensity of the velocity of the camera, (m/s)/sqrt(s).
        persistence: decay time of its velocity, s.
        turning: random-walk intensity of the rotation of the camera, rad/sqrt(s).
        astray: standard deviation of the camera position about the commanded one, m.
        askew: standard deviation of the camera rotation about the commanded one, rad.
        memory: time over which the commanded poses count as one observation, s.
        astonishing: distance of a corner from its predicted position, px, beyond which the filter
            restarts from the visible corners.
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
        """Return the initial estimate: at rest in the given view."""
        zero = jnp.zeros_like(view.centre)
        still = jnp.full_like(self.astray, _STILL)
        spread = jnp.stack([self.astray, still, self.askew])
        return Sight(view, zero, jnp.diag(jnp.repeat(spread**2, 3, total_repeat_length=9)))

    def later(self, sight: Sight, interval: Scalar) -> Sight:
        """Return the prediction after an interval without a picture, s."""
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
        """Return the estimate after a correction with a picture.

        Arguments:
            sight: predicted estimate.
            camera: camera at the tip.
            opening: opening in the picture.
            pixels: pixel positions of the corners of the opening, px.
            seen: whether each corner is visible.
            commanded: view of the camera for the commanded angles.
            interval: time since the previous picture, s.
        """
        # If all corners are visible but far from their predictions, restart from their pose.
        off = camera.project_from(sight.view, opening.corners).pixels - pixels
        lost = jnp.all(seen) & (jnp.max(jnp.abs(off)) > self.astonishing)
        corners = jnp.where(seen[:, None], pixels, jnp.asarray(_SQUARE, pixels.dtype))
        fresh = self.start(posed(camera, opening, corners))
        sight = jax.tree.map(lambda new, old: jnp.where(lost, new, old), fresh, sight)
        here = sight.view
        visible = jnp.repeat(seen, 2, total_repeat_length=8)

        def expected(change: Array) -> Array:
            """Return the pixels and the pose after a small change of the state."""
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
    """Internal state of an operator.

    Attributes:
        sight: estimate of the camera.
        blind: time since the opening was last visible, s.
    """

    sight: Sight
    blind: Scalar


class Operator(AbstractController):
    """Operator who knows the nominal geometry, past commands and a delayed picture from the tip.

    Until the opening comes into view, and if it has been out of view for too long, the joints move
    to the `approach`. Otherwise the tip moves to the axis in front of the opening and then enters,
    the deeper the nearer it is to the axis. The commanded velocity of the tip is a multiple of the
    difference between desired and estimated velocity, and the camera is turned towards its aim
    point. The operator computes with the commanded shape of the arm, and knows neither its true
    shape nor the wind. When the picture shows the room behind the opening, the commands stop.

    Attributes:
        approach: commanded angles from which the opening is in view, rad, shape (joint,).
        approach_rate: rate of the joint that turns the most on the way to the approach, rad/s.
        latency: delay of the picture and of the reaction, s.
        speed: largest speed of the tip, m/s.
        largest_rate, largest_angle: largest rate and angle of the command of a joint, rad/s, rad.
        stand_off: distance in front of the opening at which the tip moves to its axis, m.
        patience: longest time without the opening in view, s.
        near: distance from the axis of the opening within which the tip enters, m.
        deep: target depth of the tip inside the opening, m.
        closing: desired speed divided by the distance from the target, 1/s.
        push: commanded velocity divided by the missing velocity.
        looking: rate at which the camera is turned towards its aim point, 1/s.
        posture: rate at which the redundant degrees of freedom return to the approach, 1/s.
        tracking: filter that estimates the pose of the camera.
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
        """Return the operator of a `[mission]` table."""
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
        """Return the memory for the camera of the straight arm, before any picture."""
        del late
        view = scene.camera.view(scene.arm, jnp.zeros_like(self.approach))
        return OperatorMemory(self.tracking.start(view), self.patience + scene.interval)

    def decide(
        self, scene: Scene, memory: OperatorMemory, picture: Picture, command: Array
    ) -> tuple[OperatorMemory, Float[Array, " joint"]]:
        """Return commands from the picture, with the nominal geometry of the arm."""
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
        """Return the same controller with the stand-off as its target."""
        return dataclasses.replace(self, deep=-self.stand_off)

    def believed(self, scene: Scene, memory: OperatorMemory) -> Float[Array, "3"]:
        """Return the position of the camera estimated by the filter, m."""
        del scene
        return memory.sight.view.centre

    def _served(self, arm: Arm, command: Array, task: Float[Array, "6"]) -> Array:
        """Return the joint rates that perform a task, by damped least squares."""
        axes = pose(arm, command).axis
        rows = jnp.concatenate([jax.jacfwd(lambda q: tip_position(arm, q))(command), METRES * axes])
        # The redundant degrees of freedom return to the approach.
        easy = self.posture * (self.approach - command)

        def turned(free: Array) -> Array:
            reached = rows * free[None]
            damped = reached @ reached.T + jnp.eye(6, dtype=rows.dtype)
            return free * (easy + reached.T @ jnp.linalg.solve(damped, task - reached @ easy))

        first = turned(jnp.ones_like(command))
        # The other joints take over the share of a joint at its limit.
        beyond = (jnp.abs(command + first / 2) >= self.largest_angle) & (command * first > 0)
        return turned(jnp.where(beyond, 0, 1).astype(command.dtype))

    def _task(self, scene: Scene, sight: Sight) -> Float[Array, "6"]:
        """Return the commanded velocity of the tip and scaled turn rate of the camera, m/s."""
        opening, velocity = scene.opening, sight.velocity
        tip = scene.camera.mounted_at(sight.view) + self.latency * velocity
        local = opening.local(tip)
        outside = opening.outside(local, near=self.near, stand_off=self.stand_off, deep=self.deep)
        # A tip that is inside the opening stays inside it.
        outside = jnp.where(local[0] < -opening.thickness, -self.deep, outside)
        wanted = self.closing * jnp.concatenate([(outside - local[0])[None], -local[1:]])
        wanted = wanted / jnp.maximum(1, safe_norm(wanted) / self.speed)
        missing = self.push * (opening.frame @ wanted - velocity)
        ahead = opening.ahead - tip
        turn = self.looking * cross(sight.view.axes[:, 2], ahead / safe_norm(ahead))
        return jnp.concatenate([missing, METRES * turn])
