"""What a muscle needs of a run: pressure, displacement and direction."""

import equinox as eqx
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Float
from ..runs import Run

_DIRECTION = {"fill": -1.0, "exhaust": 1.0}


class MuscleInputs(eqx.Module):
    """What a muscle needs of a run.

    Attributes:
        pressure: Pa.
        contraction: relative to the length at rest; None where only a position is recorded.
        position: displacement, m; None where it is not recorded.
        direction: +1 where the muscle is moved against its own pull (exhausting), -1 where it
            moves by itself (filling); None without friction, or where it follows the displacement.
    """

    pressure: Float[Array, " sample"]
    contraction: Float[Array, " sample"] | None
    position: Float[Array, " sample"] | None
    direction: Float[Array, " sample"] | None


def muscle_inputs(run: Run, *, mean: bool, directed: bool) -> MuscleInputs:
    """A run prepared for a muscle.

    Arguments:
        run: of a muscle.
        mean: take the mean of the pressure at all samples.
        directed: take the direction of the motion, where the run records it.

    Raises:
        InputError: a run of another model, or without a pressure.
    """
    if run.model != "muscle":
        raise InputError(f"'{run.name}' is a run of the {run.model} model: give a run of a muscle")
    dtype = jnp.result_type(float)

    def column(name: str) -> Array | None:
        values = run.values.get(name)
        return None if values is None else jnp.asarray(values, dtype=dtype)

    pressure = column("pressure")
    if pressure is None:
        raise InputError(f"'{run.name}' has no pressure: add a column such as pressure_kPa")
    phase = run.values.get("phase") if directed else None
    direction = None if phase is None else [_DIRECTION[text] for text in phase]
    return MuscleInputs(
        pressure=jnp.full_like(pressure, jnp.mean(pressure)) if mean else pressure,
        contraction=column("contraction"),
        position=column("position"),
        direction=None if direction is None else jnp.asarray(direction, dtype=dtype),
    )
