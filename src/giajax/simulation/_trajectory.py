"""Trajectory: the result of a simulation."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import (
    Arm,
    acceleration,
    joint_forces,
    joint_torque,
    link_centres,
    tip_position,
    touched,
)
from ..runtime.arrays import Array, Bool, Float, Int
from ..runtime.programs import program
from ..runtime.text import InputError
from ._motion import Inputs, along_links
from ._signal import Signal, constant, followed, ramps, steps


class RESULTS(eqx.Enumeration):
    """How a simulation ended; the text describes how to proceed."""

    successful = ""
    max_steps_reached = (
        "the simulation reached its step limit before the last time: raise max_steps, loosen "
        "rtol and atol, or choose solver='springs5' for a stiff arm"
    )
    not_finite = (
        "the state of the arm became infinite or NaN: check the parameters and the initial state"
    )
    step_too_small = (
        "the simulation requires steps smaller than floating-point resolution: loosen rtol and "
        "atol, or check the parameters"
    )


class SimulationError(RuntimeError):
    """Failure of a simulation with `throw=True`; the message describes its result code."""


class Trajectory(eqx.Module):
    """Motion of an arm at its samples.

    Attributes:
        times: times of the samples, s, shape (sample,).
        angles: joint angles, rad, shape (sample, joint).
        rates: joint rates, rad/s, shape (sample, joint).
        memory: states of the joint laws (`Arm.joint_laws`), shape (sample, row, joint), or None.
        pressures: pressures in the first and the second muscle of each joint, Pa, shape (sample, 2,
            joint); None if no joint has muscles.
        skin: stretch of the skin of each link at its contacts, m, shape (sample, 3, link); None if
            contacts have no friction.
        arm: the arm.
        command: command of the arm.
        wind: wind during the motion, or None for still air.
        result: how the simulation ended (`RESULTS`); after a failure the samples that were not
            reached are infinite or NaN.
        steps: numbers of accepted and rejected steps of the integrator.
        torque: torque of the joints' drives, in addition to springs and dampers, or None.
    """

    times: Float[Array, " sample"]
    angles: Float[Array, "sample joint"]
    rates: Float[Array, "sample joint"]
    memory: Float[Array, "sample row joint"] | None
    pressures: Float[Array, "sample 2 joint"] | None
    skin: Float[Array, "sample 3 link"] | None
    arm: Arm
    command: Signal
    wind: Signal | None
    result: RESULTS
    steps: Int[Array, "2"]
    torque: Signal | None = None

    @property
    def successful(self) -> Bool[Array, ""]:
        """Whether the simulation reached the last time with finite values."""
        return self.result == RESULTS.successful

    @property
    def message(self) -> str:
        """Description of a failure and how to proceed; empty after a success."""
        return RESULTS[self.result]  # type: ignore[misc]

    @property
    def link_centres(self) -> Float[Array, "sample link 3"]:
        """Positions of the centres of the links in the base frame, m."""
        centres: Array = _over_samples(link_centres, self.arm, self.angles)
        return centres

    @property
    def tip(self) -> Float[Array, "sample 3"]:
        """Position of the end of the last link in the base frame, m."""
        tips: Array = _over_samples(tip_position, self.arm, self.angles)
        return tips

    @property
    def commands(self) -> Float[Array, "sample joint"]:
        """Commanded angles at the samples, rad."""
        return jax.vmap(self.command)(self.times)

    @property
    def followed(self) -> Float[Array, "sample joint"]:
        """Angles towards which the springs pull at the samples, rad: the outputs of the drives."""
        return jax.vmap(followed(self.command, self.arm.joints))(self.times)

    @property
    def accelerations(self) -> Float[Array, "sample joint"]:
        """Accelerations of the joints at the samples, rad/s^2.

        Raises:
            InputError: the memory of the joints, on which the accelerations depend, is unknown.
        """
        return self._of_motion("accelerations")

    @property
    def torques(self) -> Float[Array, "sample joint"]:
        """Torques of springs, dampers, hysteresis, laws and muscles of the joints, N m.

        Raises:
            InputError: as for the accelerations.
        """
        return self._of_motion("torques")

    @property
    def forces(self) -> Float[Array, "sample joint 3"]:
        """Force that each joint transmits to the link beyond it, in the base frame, N.

        Raises:
            InputError: as for the accelerations.
        """
        return self._of_motion("forces")

    def _of_motion(self, what: str) -> Array:
        if self.memory is None and self.arm.joint_laws.rows:
            raise InputError(
                f"the {what} of this motion are unknown, because they depend on the history of "
                "the joints, which this motion does not contain: call simulate"
            )
        found: Array = _moved(self, what)
        return found


def at_rest(arm: Arm, angles: Float[Array, " joint"]) -> Trajectory:
    """Return a trajectory of an arm held still at angles (rad): one sample at 0 s in still air.

    It is used for figures and for the sizes of results.
    """
    command, time = constant(angles), jnp.zeros((), angles.dtype)
    inputs = Inputs(arm, command, None, None, time)
    parts = inputs.parts(inputs.start(jnp.stack([angles, jnp.zeros_like(angles)]), time))
    pressures = inputs.inside(time, parts.memory)
    return Trajectory(
        times=time[None],
        angles=parts.angles[None],
        rates=parts.rates[None],
        memory=parts.memory[None] if len(parts.memory) else None,
        pressures=None if pressures is None else pressures[None],
        skin=parts.skin[None] if parts.skin.size else None,
        arm=arm,
        command=command,
        wind=None,
        result=RESULTS.successful,  # type: ignore[arg-type]
        steps=jnp.zeros(2, dtype=int),
    )


@program
def _over_samples(function: Callable[..., Any], arm: Arm, *rows: Any) -> Any:
    """Apply a function to each sample. Compilation avoids dispatching each operation separately."""
    return jax.vmap(function, in_axes=(None, *(0 for _ in rows)))(arm, *rows)


@program
def _moved(motion: Trajectory, what: str) -> Array:
    """Return accelerations, torques or forces of the joints at the samples."""

    def at(
        time: Array, angles: Array, rates: Array, command: Array, *states: Array | None
    ) -> Array:
        memory, pressures, skin = states
        if what == "torques":
            return joint_torque(motion.arm, angles, rates, command, memory, pressures)
        wind = wind_rate = torque = None
        if motion.wind is not None:
            wind = along_links(motion.arm, motion.wind(time))
            wind_rate = along_links(motion.arm, motion.wind.rate(time))
        if motion.torque is not None:
            torque = motion.torque(time)
        given = (command, wind, wind_rate, torque, memory, pressures, skin, time)
        found = acceleration(motion.arm, angles, rates, *given)
        if what == "accelerations":
            return found
        return joint_forces(motion.arm, angles, rates, found, wind, wind_rate, skin, time)

    states = (motion.memory, motion.pressures, motion.skin)
    return jax.vmap(at)(motion.times, motion.angles, motion.rates, motion.followed, *states)


@program
def _touched(arm: Arm, angles: Array, rates: Array, skin: Array | None) -> tuple[Array, Array]:
    """Return the flattening and the contact forces at each sample."""
    return jax.vmap(functools.partial(touched, arm))(angles, rates, skin)


class Contacts(NamedTuple):
    """Contacts of the links at the samples of a simulation.

    Attributes:
        obstacles: names of the obstacles, in the order of their axis.
        flattening: radius of a link minus the distance of its axis from an obstacle, m.
        force: force of an obstacle on a link in the base frame, N.
        impulse: impulse of an obstacle on a link over the whole motion, N s, by the trapezoidal
            rule; its accuracy is limited by the interval between samples.
    """

    obstacles: tuple[str, ...]
    flattening: Float[Array, "sample link obstacle"]
    force: Float[Array, "sample link obstacle 3"]
    impulse: Float[Array, "link obstacle 3"]


def contacts(trajectory: Trajectory) -> Contacts:
    """Return the flattening, force and impulse of each contact of a motion.

    Raises:
        InputError: the arm has no obstacles.

    Example:
        >>> import giajax, jax.numpy as jnp
        >>> from giajax.mechanics.arm import Contact
        >>> from giajax.mechanics.obstacles import Plane
        >>> ground = Plane(centre=[0.0, 0.0, -0.5])
        >>> arm = giajax.takeichi_20m(contact=Contact(obstacles=(ground,)))
        >>> command = giajax.joint_ramps(20, {1: 0.3}, start=0.5, duration=2.0)
        >>> motion = giajax.simulate(arm, command, jnp.linspace(0.0, 10.0, 101))
        >>> giajax.simulation.contacts(motion).flattening.shape
        (101, 20, 1)
    """
    contact = trajectory.arm.contact
    if contact is None:
        raise InputError("the arm has no obstacles: add obstacles as [[arm.obstacles]]")
    rows = (trajectory.angles, trajectory.rates, trajectory.skin)
    flattening, force = _touched(trajectory.arm, *rows)
    steps = jnp.diff(trajectory.times)
    impulse = jnp.tensordot(steps, (force[1:] + force[:-1]) / 2, axes=1)
    names = tuple(obstacle.name for obstacle in contact.obstacles)
    return Contacts(names, flattening, force, impulse)


def joint_steps(joints: int, angles: Mapping[int, float], *, time: float = 0.0) -> Signal:
    """Return a command that steps from the straight arm to other angles at one time.

    Arguments:
        joints: number of joints of the arm.
        angles: commanded angle by joint number (1 is the base joint), rad.
        time: time of the step, s.

    Example:
        >>> import giajax
        >>> command = giajax.joint_steps(20, {1: 0.5236}, time=0.5)
    """
    return steps([min(0.0, time) - 1.0, time], [np.zeros(joints), _target(joints, angles)])


def joint_ramps(
    joints: int, angles: Mapping[int, float], *, start: float = 0.0, duration: float = 1.0
) -> Signal:
    """Return a command that moves linearly from the straight arm to other angles.

    Arguments:
        joints: number of joints of the arm.
        angles: commanded angle at the end by joint number (1 is the base joint), rad.
        start, duration: start time and duration of the movement, s.
    """
    if not duration > 0:
        raise InputError(
            f"a ramp lasts {duration} s: give a positive duration, or use joint_steps for a step"
        )
    return ramps([start, start + duration], [np.zeros(joints), _target(joints, angles)])


def _target(joints: int, angles: Mapping[int, float]) -> np.ndarray:
    target = np.zeros(joints)
    for joint, angle in angles.items():
        if not 1 <= joint <= joints:
            raise InputError(
                f"joint {joint} is not a joint of the arm: give a number from 1 to {joints}"
            )
        target[joint - 1] = angle
    return target
