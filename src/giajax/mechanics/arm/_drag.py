"""Drag laws: the aerodynamic force on a link per unit of length.

A user-defined law derives from `AbstractDragLaw`.
"""

import abc
import operator
from dataclasses import fields
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import (
    Array,
    Float,
    Scalar,
    computed_once,
    derivative_barrier,
    dot,
    safe_norm,
    scaled,
    smaller,
)
from ...runtime.text import InputError, tried
from ...schema.parameters import is_concrete

# log10 C_D is the sum of a linear function of log10 Re and three smooth steps, which represent the
# end of creeping flow, the growth of the wake, and the drag crisis. The coefficients come from a
# least-squares fit to 247 digitised points (Re from 0.1 to 8.5e6), which scatter about the curve
# by 0.037. `data/recorded/cylinder_cd` contains the points and the fit.
_LINE = (3.75991, -0.90015)
_HEIGHT = np.asarray([-0.27163, 2.87305, 0.48415])
_PLACE = np.asarray([5.56961, 3.91454, 6.32711])
_WIDTH = np.asarray([0.04694, 2.98417, 0.46406])
# The curve is constant outside these Reynolds numbers. The points end at 0.1 and 8.5e6.
_LOWEST, _HIGHEST = 0.01, 1e7
_REFERENCE = 1e5  # Reynolds number to which `air.drag_coefficient` refers


def cylinder_drag_coefficient(reynolds: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return C_D of a smooth cylinder in cross flow at Re = |V| d / nu.

    The reference area is length times diameter.
    """
    coefficient: Array = _curve(reynolds)
    return coefficient


@jax.custom_jvp
def _curve(reynolds: Array) -> Array:
    return _curve_and_slope(reynolds)[0]


@_curve.defjvp
def _curve_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    """Compute the value and the derivative once for all tangents."""
    value, slope = computed_once(jnp.stack(_curve_and_slope(*primals)))
    return value, slope * tangents[0]


def _curve_and_slope(reynolds: Array) -> tuple[Array, Array]:
    # The curve is smooth at Re = 0, so that it can be differentiated for an arm at rest.
    beyond = reynolds * reynolds + _LOWEST**2
    square = smaller(beyond, _HIGHEST**2)
    x = jnp.log(square) / (2 * np.log(10))
    value, slope = _LINE[0] + _LINE[1] * x, jnp.full_like(x, _LINE[1])
    for height, place, width in zip(_HEIGHT, _PLACE, _WIDTH, strict=True):
        step = jnp.tanh((x - float(place)) / float(width))
        value = value + float(height) * step
        slope = slope + float(height / width) * (1 - step * step)
    value = jnp.exp(np.log(10) * value)
    return value, jnp.where(beyond > _HIGHEST**2, 0, value * slope * reynolds / square)


class Stream(NamedTuple):
    """Flow past the links of an arm at one or several points of each link.

    Vectors have the shape (3, link), or (3, place, link) for several points. Scalars have the same
    shapes without the 3. Values that are the same at all points may have a place axis of length 1.
    `runtime.arrays` provides functions for drag laws: `dot`, `scaled`, and `safe_norm`, which is
    differentiable at rest.

    Attributes:
        velocity: velocity of the point relative to the air, m/s.
        across: component of the velocity normal to the link, m/s.
        along: component of the velocity along the link, towards the tip, m/s.
        axis: unit vector along the link, towards the tip.
        diameter: diameter of the link, m.
        fullness: displaced volume divided by the volume of the full cylinder.
        density: density of the air, kg/m^3.
        viscosity: kinematic viscosity of the air, m^2/s.
    """

    velocity: Float[Array, "3 *place link"]
    across: Float[Array, "3 *place link"]
    along: Float[Array, "*place link"]
    axis: Float[Array, "3 *one link"]
    diameter: Float[Array, "*one link"]
    fullness: Float[Array, "*one link"]
    density: Scalar
    viscosity: Scalar

    def reynolds(self, speed: Float[Array, "*place link"]) -> Float[Array, "*place link"]:
        """Return the Reynolds number |V| d / nu of a speed, m/s."""
        return speed * self.diameter / self.viscosity

    def at_places(
        self, moved: Float[Array, "3 place link"], wind: Float[Array, "3 place link"] | None = None
    ) -> "Stream":
        """Return the flow at several points of each link, from the flow at one point.

        Arguments:
            moved: additional velocity of the points across the link, m/s.
            wind: additional velocity of the air at the points, m/s; 0 by default.
        """
        wide = {
            name: getattr(self, name)[..., None, :]
            for name in ("along", "axis", "diameter", "fullness")
        }
        velocity, across = self.velocity[:, None] + moved, self.across[:, None] + moved
        if wind is not None:
            slip = dot(wide["axis"], wind)
            wide["along"] = wide["along"] - slip
            velocity, across = velocity - wind, across - (wind - scaled(slip, wide["axis"]))
        return self._replace(velocity=velocity, across=across, **wide)


class AbstractDragLaw(eqx.Module):
    """A drag law: the `force` of the air at each point, and the number of `points` of a link.

    The parameters of a law are declared like all others (`giajax.schema.parameters.parameter`) and
    have paths of the form `air.law.NAME`. `check_drag_law` tests a law.
    """

    registered_as: ClassVar[str] = "drag"
    names_of_giajax: ClassVar[tuple[str, ...]] = ("centre", "strip")

    @property
    @abc.abstractmethod
    def points(self) -> int:
        """Number of Gauss points along a link, a constant.

        With 0, drag acts only at the centre of the link, without a couple.
        """

    @abc.abstractmethod
    def force(self, stream: Stream) -> Float[Array, "3 *place link"]:
        """Return the force of the air per unit of length of the links, N/m."""


def _factor(curve: str, stream: Stream, speed: Array) -> Array | float:
    """Return C_D at a speed divided by C_D at the reference Reynolds number."""
    if curve == "constant":
        return 1.0
    x = np.log10(_REFERENCE)
    reference = _LINE[0] + _LINE[1] * x + np.sum(_HEIGHT * np.tanh((x - _PLACE) / _WIDTH))
    return cylinder_drag_coefficient(stream.reynolds(speed)) * float(10**-reference)


class CentreDrag(AbstractDragLaw):
    """The drag law F = -1/2 rho C_D L d |V| V at the centre of the link (paper, eq. 1).

    Attributes:
        coefficient: drag coefficient C_D; with the curve "cylinder", its value at Re = 1e5.
        curve: "constant", or "cylinder" for C_D as a function of the Reynolds number.
        points: number of Gauss points; 0 for the centre only.
    """

    coefficient: Scalar
    curve: str = eqx.field(static=True, default="constant")
    points: int = eqx.field(static=True, default=0)

    def force(self, stream: Stream) -> Float[Array, "3 *place link"]:
        """Return the force per length against the velocity, N/m."""
        speed = safe_norm(stream.velocity)
        size = 0.5 * stream.density * stream.diameter * self.coefficient
        return -scaled(size * _factor(self.curve, stream, speed) * speed, stream.velocity)


class StripDrag(AbstractDragLaw):
    """Drag from the flow across a link and along it, integrated along the link.

    Attributes:
        coefficient: drag coefficient C_D; with the curve "cylinder", its value at Re = 1e5.
        axial: coefficient of the drag along the link, relative to length times diameter; None for
            no axial drag.
        curve: "constant", or "cylinder" for C_D as a function of the Reynolds number.
        points: number of Gauss points along a link.
    """

    coefficient: Scalar
    axial: Scalar | None = None
    curve: str = eqx.field(static=True, default="constant")
    points: int = eqx.field(static=True, default=3)

    def force(self, stream: Stream) -> Float[Array, "3 *place link"]:
        """Return the force per length, N/m.

        The cross-flow drag depends only on the velocity across the link, and the axial drag only on
        the velocity along it.
        """
        speed = safe_norm(stream.across)
        half = 0.5 * stream.density * stream.diameter
        size = half * self.coefficient * _factor(self.curve, stream, speed)
        force = -scaled(derivative_barrier(size * speed), stream.across)
        if self.axial is None:
            return force
        skin = half * self.axial * jnp.abs(stream.along) * stream.along
        return force - scaled(skin, stream.axis)


_SPEEDS = (1e-3, 0.1, 1.0, 10.0)  # m/s; speeds at which a law is tested


def check_drag_law(law: AbstractDragLaw, links: int = 7) -> None:
    """Test a drag law on links that move at several speeds and in several directions, or not.

    A traced law is not tested.

    Arguments:
        law: the drag law.
        links: number of links.

    Raises:
        InputError: a method raises an exception, returns a wrong shape, has a value or derivative
            that is not finite, has a derivative that does not match finite differences, or returns
            a force that accelerates a link instead of resisting its motion. The message names the
            method.
    """
    if is_concrete(law):
        with tried(f"{type(law).__name__}.force"), jax.ensure_compile_time_eval():
            _try(law, links)


def _try(law: AbstractDragLaw, links: int) -> None:
    name, points = type(law).__name__, law.points
    what = f"{name}.force"
    if any(each.name == "points" and not each.metadata.get("static") for each in fields(law)):
        raise InputError(
            f"{name}.points is a field: make it a constant of the class, or a static field"
        )
    if operator.index(points) < 0:
        raise InputError(f"{name}.points is {points!r}: give a number of points, or 0")
    rounding = 1e-6 if jnp.zeros(()).dtype == jnp.float64 else 1e-3

    def stream(velocity: Array, places: int) -> Stream:
        along, one = velocity[0], jnp.ones_like(velocity[0])
        axis = jnp.zeros_like(velocity).at[0].set(1.0)
        about = (along, axis, 0.3 * one, 0.9 * one, 1.2 * one[0], 1.5e-5 * one[0])
        there = Stream(velocity, velocity - scaled(along, axis), *about)
        return there.at_places(jnp.zeros((3, places, links), one.dtype)) if places else there

    def force(velocity: Array) -> Array:
        return law.force(stream(velocity, points))

    parameters, rest = eqx.partition(law, eqx.is_inexact_array)
    ones = jax.tree.map(jnp.ones_like, parameters)
    for seed, speed in enumerate((*_SPEEDS, 0.0)):
        unit = np.random.default_rng(seed).normal(size=(3, links))
        velocity = speed * jnp.asarray(unit / np.linalg.norm(unit, axis=0), float)
        here = stream(velocity, points)
        acting, moving = law.force(here), here.velocity
        if getattr(acting, "shape", None) != moving.shape:
            raise InputError(
                f"{what} returns the shape {getattr(acting, 'shape', None)} for velocities of "
                f"shape {moving.shape}: return one force for each velocity"
            )
        at = f"at {speed:g} m/s" if speed else "at rest"
        power = jnp.sum(acting * moving, axis=0)
        if bool(jnp.any(power > rounding * safe_norm(acting) * safe_norm(moving))):
            raise InputError(
                f"{what} accelerates a link that moves through the air {at}, which would create "
                "energy: let the force act against the velocity"
            )
        turned = jnp.roll(velocity, 1, axis=0) if speed else jnp.ones_like(velocity)
        slope = jax.jvp(force, (velocity,), (turned,))[1]
        by_parameters = jax.jvp(
            lambda values, at=here: eqx.combine(values, rest).force(at), (parameters,), (ones,)
        )[1]
        known = {
            "value": acting,
            "slope": slope,
            "derivative with respect to parameters": by_parameters,
        }
        for each, values in known.items():
            if not bool(jnp.all(jnp.isfinite(values))):
                raise InputError(
                    f"{what} has a {each} that is not finite {at}: correct it (safe_norm of "
                    "giajax.runtime.arrays is a norm that can be differentiated at rest)"
                )
        step = rounding
        found = (force(velocity + step * turned) - force(velocity - step * turned)) / (2 * step)
        size = jnp.max(jnp.abs(slope)) + jnp.max(jnp.abs(acting))
        if speed >= 1 and float(jnp.max(jnp.abs(found - slope))) > 1e-2 * float(size):
            raise InputError(
                f"{what} has a derivative {at} that does not match finite differences: correct "
                "its custom derivative rule, or remove it"
            )
