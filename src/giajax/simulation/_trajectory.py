"""The result of a simulation."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from .._program import program
from .._typing import Array, Bool, Float, Int
from ..arm import Arm, link_centres, tip_position
from ._motion import Inputs
from ._signal import Signal, constant


class RESULTS(eqx.Enumeration):
    """How a simulation ended; the text names the next action."""

    successful = ""
    max_steps_reached = (
        "the simulation reached its step limit before the last time: raise max_steps, loosen "
        "rtol and atol, or choose solver='springs5' for a stiff arm"
    )
    not_finite = "the simulation became infinite or NaN: check the parameters and the initial state"
    step_too_small = (
        "the simulation needs steps smaller than floating point resolves: loosen rtol and atol, "
        "or check the parameters"
    )


class SimulationError(RuntimeError):
    """A simulation that failed while `throw=True`; the message is that of its result code."""


class Trajectory(eqx.Module):
    """Motion of an arm at its samples.

    Attributes:
        times: s, shape (sample,).
        angles: joint angles, rad, shape (sample, joint).
        rates: joint rates, rad/s, shape (sample, joint).
        memory: states of the joints' hysteresis (`giajax.arm.JointHysteresis`), shape (sample, row,
            joint), or None.
        pressures: in the first and the second muscle of each joint, Pa, shape (sample, 2, joint);
            None where no joint has muscles.
        skin: stretch of the skin of each link along what it touches, m, shape (sample, 3, link);
            None where contacts have no friction.
        arm: the arm that moved.
        command: its command.
        wind: the wind it moved in, or None for still air.
        result: how the simulation ended (`RESULTS`); after a failure the samples that were not
            reached are infinite or NaN.
        steps: accepted and rejected steps of the integrator.
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

    @property
    def successful(self) -> Bool[Array, ""]:
        """Whether the simulation reached the last time with finite values."""
        return self.result == RESULTS.successful

    @property
    def message(self) -> str:
        """What went wrong and what to do next; empty after a success."""
        return RESULTS[self.result]  # type: ignore[misc]

    @property
    def link_centres(self) -> Float[Array, "sample link 3"]:
        """Positions of the links' centres in the base frame, m."""
        return _over_samples(link_centres, self.arm, self.angles)

    @property
    def tip(self) -> Float[Array, "sample 3"]:
        """Position of the end of the last link in the base frame, m."""
        return _over_samples(tip_position, self.arm, self.angles)

    @property
    def commands(self) -> Float[Array, "sample joint"]:
        """Commanded angles at the samples, rad."""
        return jax.vmap(self.command)(self.times)


def at_rest(arm: Arm, angles: Float[Array, " joint"]) -> Trajectory:
    """One sample of an arm that is held still, as a motion: for pictures, and sizes of results.

    Arguments:
        arm: the arm.
        angles: of its joints, commanded and actual, rad.

    Returns:
        A trajectory of one sample at 0 s, in still air.
    """
    command, time = constant(angles), jnp.zeros((), angles.dtype)
    inputs = Inputs(arm, command, None, None, time)
    parts = inputs.parts(inputs.start(jnp.stack([angles, jnp.zeros_like(angles)]), time))
    pressures = inputs.inside(time, parts.muscles)
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
def _over_samples(
    position: Callable[[Arm, Array], Array], arm: Arm, angles: Float[Array, "sample joint"]
) -> Array:
    """A position at every sample; compiled, or each operation would be dispatched by itself."""
    return jax.vmap(position, in_axes=(None, 0))(arm, angles)
