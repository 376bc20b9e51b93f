"""Wind as a function of position and time, for example a height profile or a travelling gust."""

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
    """The velocity of the air as a function of position and time.

    The parameters of a wind field are declared like all others
    (`giajax.schema.parameters.parameter`) and have paths of the form `air.wind_field.NAME`.
    `check_wind` tests a wind field.
    """

    registered_as: ClassVar[str] = "wind"

    @abc.abstractmethod
    def __call__(
        self, position: Float[Array, "*place 3"], time: Scalar
    ) -> Float[Array, "*place 3"]:
        """Return the velocity of the air at positions in the base frame and at one time, m/s.

        Arguments:
            position: positions in the base frame, m.
            time: time, s.
        """


class WindFunction(AbstractWind):
    """A wind field without parameters, given by a plain function of position and time."""

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(
        self, position: Float[Array, "*place 3"], time: Scalar
    ) -> Float[Array, "*place 3"]:
        velocity: Array = self.function(position, time)
        return velocity


def as_wind(wind: Any) -> AbstractWind:
    """Return the wind field of an instance of a wind class or of a plain function.

    Raises:
        InputError: the argument is neither of these.
    """
    if isinstance(wind, AbstractWind):
        return wind
    if isinstance(wind, FunctionType):
        return WindFunction(wind)
    raise InputError(
        f"the wind field is {wind!r}: give a plain def or lambda of position and time, or an "
        "instance of a class of giajax.mechanics.arm.AbstractWind"
    )


_TIMES = (0.0, 0.7, 60.0)  # s; times at which a wind field is tested
_ABOUT = ((0.3, 0.0, 0.0), (2.0, 0.5, 1.0), (5.0, -1.0, 3.0))  # m; default positions


def check_wind(
    wind: AbstractWind | Callable[..., Any],
    position: Float[Array, "point 3"] | None = None,
) -> None:
    """Test a wind field at the positions of an arm.

    A traced wind field is not tested.

    Arguments:
        wind: a function of position and time, or an instance of a class of `AbstractWind`.
        position: positions in the base frame, m; by default three points up to 6 m from the base.

    Raises:
        InputError: the wind field raises an exception, returns a wrong shape, depends on other
            positions in the same array, or has a value or derivative that is not finite. The
            message names the wind field.
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
        # A simulation also evaluates the wind field with traced values.
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
                    "the arm: correct the field, or the height of its ground"
                )
        # Evaluate the positions in both orders at once, and single positions. A field that uses the
        # mean or the maximum over all positions then returns a different wind.
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
                f"{name} does not return a separate wind for each position in an array of shape "
                f"(2, {len(position)}, 3): index positions as position[..., 0] and so on, and "
                "compute each wind from its own position alone"
            )
