"""Wind as a function of place and time: a profile over height, a gust that travels."""

import abc
from collections.abc import Callable
from types import FunctionType
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError, tried
from ...schema.parameters import is_concrete


class AbstractWind(eqx.Module):
    """The velocity of the air as a function of place and time.

    Its parameters are declared as all others (`giajax.schema.parameters.parameter`) and have paths
    as `air.wind_field.NAME`. `check_wind` tests one.
    """

    registered_as: ClassVar[str] = "wind"

    @abc.abstractmethod
    def __call__(
        self, position: Float[Array, "*place 3"], time: Scalar
    ) -> Float[Array, "*place 3"]:
        """Velocity of the air at places (m) in the base frame and a time (s), m/s."""


class WindFunction(AbstractWind):
    """A plain function of place and time as a wind, without parameters."""

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(
        self, position: Float[Array, "*place 3"], time: Scalar
    ) -> Float[Array, "*place 3"]:
        velocity: Array = self.function(position, time)
        return velocity


def as_wind(wind: Any) -> AbstractWind:
    """A wind of a class or of a plain function; `InputError` for anything else."""
    if isinstance(wind, AbstractWind):
        return wind
    if isinstance(wind, FunctionType):
        return WindFunction(wind)
    raise InputError(
        f"the wind field is {wind!r}: give a plain def or lambda of position and time, or an "
        "instance of a class of giajax.mechanics.arm.AbstractWind"
    )


_TIMES = (0.0, 0.7, 60.0)  # at which a wind is tried, s
_ABOUT = ((0.3, 0.0, 0.0), (2.0, 0.5, 1.0), (5.0, -1.0, 3.0))  # and where by default, m


def check_wind(
    wind: AbstractWind | Callable[..., Any],
    position: Float[Array, "point 3"] | None = None,
) -> None:
    """Try a wind as a function of place and time, where an arm will be.

    While a program is traced nothing is checked.

    Arguments:
        wind: a function of position and time, or an instance of a class of `AbstractWind`.
        position: where, in the base frame, m; by default some places up to 6 m from the base.

    Raises:
        InputError: naming the wind and what is wrong: an exception, a shape, a place whose wind
            depends on other places, or a value or a derivative that is not finite.
    """
    given = as_wind(wind)
    if not is_concrete((given, position)):
        return
    named = given.function if isinstance(given, WindFunction) else type(given)
    about = jnp.asarray(_ABOUT if position is None else position, dtype=float)
    with tried(named.__name__), jax.ensure_compile_time_eval():
        _try(named.__name__, given, about)


def _try(name: str, wind: AbstractWind, position: Array) -> None:
    ones = jax.tree.map(
        lambda leaf: jnp.ones_like(leaf) if eqx.is_inexact_array(leaf) else None,
        (wind, position, jnp.zeros((), position.dtype)),
    )
    for moment in _TIMES:
        given = (wind, position, jnp.asarray(moment, position.dtype))
        # As motions do, where numbers are not known yet.
        eqx.filter_eval_shape(lambda wind, *at: wind(*at), *given)
        velocity, slope = eqx.filter_jvp(lambda wind, *at: wind(*at), given, ones)
        if getattr(velocity, "shape", None) != position.shape:
            raise InputError(
                f"{name} returns the shape {getattr(velocity, 'shape', None)} for positions of "
                f"shape {position.shape}: return one velocity for each position"
            )
        for what, values in {"value": velocity, "derivative": slope}.items():
            if values is not None and not bool(jnp.all(jnp.isfinite(values))):
                raise InputError(
                    f"{name} has a {what} that is not finite at {moment:g} s at the position of "
                    f"the arm: correct the field, or the height of its ground"
                )
        # Both orders at once; and alone, where the mean or the largest of all is that of one.
        for places, alike in (
            (jnp.stack([position, position[::-1]]), jnp.stack([velocity, velocity[::-1]])),
            (position[:1], velocity[:1]),
            (position[-1:], velocity[-1:]),
            (position[0], velocity[0]),
        ):
            own = wind(places, given[2])
            if getattr(own, "shape", None) == places.shape and bool(
                jnp.allclose(own, alike, rtol=1e-4)
            ):
                continue
            raise InputError(
                f"{name} does not give each place of shape (2, {len(position)}, 3) its own wind: "
                "use position[..., 0] and so on, and depend on no other place"
            )
