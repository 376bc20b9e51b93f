"""Force of any muscle from its pressure, and the pressure for a force, with checked arguments."""

import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._typing import Array, Float
from ..parameters import is_concrete
from ._answer import PressureAnswer
from ._muscle import AbstractMuscle


def muscle_force(
    muscle: AbstractMuscle,
    pressure: npt.ArrayLike | Array,
    contraction: npt.ArrayLike | Array,
    length: npt.ArrayLike | Array = 1.96,
) -> Float[Array, "*shape"]:
    """Force of a muscle without friction, N.

    Arguments:
        muscle: the law.
        pressure: above the surroundings, Pa, of any shape.
        contraction: relative to the length at rest, of the same shape or one number.
        length: of the muscle at rest, m.

    Returns:
        Force, N, of the shape of the arguments; 0 where the muscle is slack.

    Raises:
        InputError: a number that is not finite, a negative pressure, or a contraction of 1 or
            more.

    Example:
        >>> import giajax
        >>> float(giajax.muscle_force(giajax.BraidedMuscle(dead_band=0.0), 100e3, 0.0)) > 17
        True
    """
    pressure, contraction, length = _arrays(pressure, contraction, length)
    _check(contraction, length, pressure=pressure)
    return muscle.force(pressure, contraction, length)


def muscle_pressure(
    muscle: AbstractMuscle,
    force: npt.ArrayLike | Array,
    contraction: npt.ArrayLike | Array,
    length: npt.ArrayLike | Array = 1.96,
) -> PressureAnswer:
    """Pressure at which a muscle pulls with a force at a contraction, in closed form.

    Arguments:
        muscle: the law.
        force: to be reached, N, of any shape.
        contraction: relative to the length at rest, of the same shape or one number.
        length: of the muscle at rest, m.

    Returns:
        The pressure, or where the force is out of reach the nearest one, and why.

    Raises:
        InputError: a number that is not finite, or a contraction of 1 or more.

    Example:
        >>> import giajax
        >>> answer = giajax.muscle_pressure(giajax.BraidedMuscle(), 2.0, 0.35)
        >>> bool(answer.reached), answer.message()
        (False, 'the muscle does not shorten so far at any pressure: ask for less contraction')
    """
    force, contraction, length = _arrays(force, contraction, length)
    _check(contraction, length, force=force)
    return muscle.answer(force, contraction, length)


def _arrays(
    first: npt.ArrayLike | Array, contraction: npt.ArrayLike | Array, length: npt.ArrayLike | Array
) -> tuple[Array, Array, Array]:
    dtype = jnp.result_type(float)
    first, contraction, length = (
        jnp.asarray(item, dtype=dtype) for item in (first, contraction, length)
    )
    if length.ndim or (first.ndim and contraction.ndim and first.shape != contraction.shape):
        raise InputError(
            f"values have the shapes {first.shape}, {contraction.shape} and {length.shape}: give "
            "arrays of one shape, or numbers, and one length"
        )
    shape = first.shape or contraction.shape
    return jnp.broadcast_to(first, shape), jnp.broadcast_to(contraction, shape), length


def _check(contraction: Array, length: Array, **others: Array) -> None:
    if not is_concrete((contraction, length, *others.values())):
        return
    for what, values in {"contraction": contraction, "length": length, **others}.items():
        if not bool(jnp.all(jnp.isfinite(values))):
            raise InputError(f"a {what} is not finite: give finite numbers")
    if bool(jnp.any(contraction >= 1)):
        raise InputError(
            f"a contraction is {float(jnp.max(contraction)):g}, and at 1 nothing is left of the "
            "muscle: give the fraction of its length at rest, not percent"
        )
    if "pressure" in others and bool(jnp.any(others["pressure"] < 0)):
        raise InputError(
            f"a pressure is {float(jnp.min(others['pressure'])):g} Pa: give the pressure above the "
            "surroundings, 0 or more"
        )
