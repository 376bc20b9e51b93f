"""Who drives the arm: commands from what a picture shows, with limits."""

from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._maths import cross, safe_norm
from .._typing import Array, Float, Scalar
from ..arm import Arm, pose, tip_position
from ..kinds import MissionSection
from ..models import Pinhole
from ._opening import Opening
from ._tracking import Sight, Tracking, number

# How far behind the opening it looks: a place that does not pass by while the tip goes in, m.
_AHEAD = 3.0

# A turn by a radian counts as much as so many metres of the tip.
_METRES = 2.0


class Operator(eqx.Module):
    """An operator who has the drawing, the commands so far, and a late picture from the tip.

    Until the opening comes into view, and where it has been out of it for too long, joints go to
    the `approach`. Else the tip is driven to a place before the opening, the nearer to its axis the
    closer, and through it: joints turn so that the tip would move faster than it is seen to move by
    a multiple of what is missing, and the camera looks to where it goes. The commanded shape is
    taken for the arm's: where it really is, and what blows, nobody tells the operator. Once inside,
    the operator sees the room, and holds still.

    Attributes:
        approach: commanded angles from which the opening is in view, rad, shape (joint,).
        approach_rate: of the joint that turns the most, rad/s.
        latency: of picture and hand, s.
        speed: of the tip at most, m/s.
        largest_rate: of the command of a joint, rad/s.
        largest_angle: of the command of a joint, rad.
        stand_off: distance before the opening at which the tip goes to its axis, m.
        patience: without a picture of the opening, s.
        near: distance from the opening's axis within which the tip goes in, m.
        deep: how far inside it wants to be, m.
        closing: speed over distance, 1/s.
        push: how much faster a command moves than what is missing in speed.
        looking: how fast the camera is turned to where it shall look, 1/s.
        posture: how fast what the task leaves open goes back to the approach, 1/s.
        tracking: what is made of pictures.
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
        """Who a `[mission]` says.

        Raises:
            InputError: its approach is of a joint that the arm does not have.
        """
        stated = section.operator
        approach = np.zeros(joints)
        for joint, angle in zip(stated.approach.joints, stated.approach.angles_deg, strict=True):
            if joint > joints:
                raise InputError(
                    f"mission.operator.approach bends joint {joint}, and the arm has {joints}: "
                    "correct it"
                )
            approach[joint - 1] = np.deg2rad(angle)
        numbers = {
            "approach_rate": np.deg2rad(stated.approach_rate_deg_per_s),
            "latency": stated.latency_s,
            "speed": stated.speed_m_per_s,
            "largest_rate": np.deg2rad(stated.largest_rate_deg_per_s),
            "largest_angle": np.deg2rad(stated.largest_angle_deg),
            "stand_off": stated.stand_off_m,
            "patience": stated.patience_s,
            "deep": 2 * section.beyond_m,
        }
        return cls(
            approach=jnp.asarray(approach),
            **{name: jnp.asarray(number) for name, number in numbers.items()},
            tracking=Tracking(pixel=jnp.asarray(2 * stated.pixel_px)),
        )

    def commands(
        self,
        arm: Arm,
        camera: Pinhole,
        opening: Opening,
        command: Float[Array, " joint"],
        sight: Sight,
        blind: Scalar,
        interval: Scalar,
    ) -> Float[Array, " joint"]:
        """The commands an interval later, rad.

        Arguments:
            arm: as it is drawn: its lengths and axes.
            camera: at its tip.
            opening: to go through.
            command: the commands so far, rad.
            sight: where the camera is believed to be.
            blind: for how long the opening was not seen, s.
            interval: s.
        """
        back = self.approach - command
        away = jnp.maximum(jnp.max(jnp.abs(back)) / self.approach_rate, interval)
        served = self._served(arm, command, self._task(camera, opening, sight))
        rates = jnp.where(blind > self.patience, back / away, served)
        # As slow as the slowest needs it, so that the tip goes where it shall.
        rates = rates / jnp.maximum(1, jnp.max(jnp.abs(rates)) / self.largest_rate)
        return jnp.clip(command + interval * rates, -self.largest_angle, self.largest_angle)

    def _served(self, arm: Arm, command: Array, task: Float[Array, "6"]) -> Array:
        """Rates that bring the tip to where the picture says that it should be."""
        axes = pose(arm, command).axis
        rows = jnp.concatenate(
            [jax.jacfwd(lambda q: tip_position(arm, q))(command), _METRES * axes]
        )
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

    def _task(self, camera: Pinhole, opening: Opening, sight: Sight) -> Float[Array, "6"]:
        """Velocity of the tip and turn of the camera that commands shall make, in metres."""
        velocity = sight.velocity
        tip = camera.mounted_at(sight.view) + self.latency * velocity
        local = opening.local(tip)
        beside = safe_norm(local[1:])
        outside = jnp.clip(2 * (beside - self.near), -self.deep, self.stand_off)
        # Where it is inside it stays inside.
        outside = jnp.where(local[0] < -opening.thickness, -self.deep, outside)
        wanted = self.closing * jnp.concatenate([(outside - local[0])[None], -local[1:]])
        wanted = wanted / jnp.maximum(1, safe_norm(wanted) / self.speed)
        missing = self.push * (opening.frame @ wanted - velocity)
        ahead = opening.centre - _AHEAD * opening.frame[:, 0] - tip
        turn = self.looking * cross(sight.view.axes[:, 2], ahead / safe_norm(ahead))
        return jnp.concatenate([missing, _METRES * turn])
