"""An inflated tube that bends: tight, wrinkled, and folded where its gas has given way."""

from collections.abc import Callable
from functools import partial
from math import factorial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..runtime.arrays import Array, Float, Scalar, larger, limited
from ..runtime.text import InputError
from ..schema import NECK
from ..schema.parameters import is_concrete, parameter

Numbers = Float[Array, "..."]

_STEPS = 4  # of Newton's method, after which an angle is exact to rounding from these guesses
_SMALL = 0.5  # rad, below which functions of an angle are series
# Of sin d - d cos d and d - sin d cos d over d^3, by powers of d^2 with the highest first.
_ODD = 2 * np.arange(9, 0, -1) + 1
_SIGNS = (-1.0) ** (_ODD // 2 + 1) / np.array([float(factorial(n)) for n in _ODD.tolist()])
_STRETCHED, _BENT = _SIGNS * (_ODD - 1), _SIGNS * 2.0 ** (_ODD - 1)


class Tube(NamedTuple):
    """A thin tube of film that bears no compression: its radius, m, and modulus times thickness
    of its film, N/m.
    """

    radius: Array
    film_stiffness: Array


class NeckFilm(eqx.Module):
    """The film of a neck between two links, with the gas that these have.

    Without a radius (None) there is none: the joint is a hinge.

    Raises:
        InputError: a size that is 0.
    """

    radius: Scalar | None = parameter(NECK.radius)
    length: Scalar = parameter(NECK.length)
    film_stiffness: Scalar = parameter(NECK.film_stiffness)

    def __check_init__(self) -> None:
        check_neck(self)

    def filled(self, pressure: Array) -> "Neck":
        """The neck with gas of a gauge pressure, Pa: one number, or one for each joint."""
        return Neck(self.radius, self.length, self.film_stiffness, pressure)


class Neck(eqx.Module):
    """The neck of film between two links, which is bent where their joint is.

    Without a radius (None) there is none: the joint is a hinge.
    """

    radius: Scalar | None = parameter(NECK.radius)
    length: Scalar = parameter(NECK.length)
    film_stiffness: Scalar = parameter(NECK.film_stiffness)
    pressure: Scalar = parameter(NECK.pressure)

    @property
    def tube(self) -> Tube:
        """The tube that it is a piece of."""
        assert self.radius is not None
        return Tube(self.radius, self.film_stiffness)

    @property
    def stiffness(self) -> Scalar:
        """Stiffness of the straight neck, which is tight, N m/rad: it is never stiffer."""
        tube = self.tube
        return jnp.pi * tube.film_stiffness * tube.radius**3 / self.length


def check_neck(neck: NeckFilm | Neck) -> None:
    """Refuse a neck of which a size is not positive.

    Raises:
        InputError: naming the size.
    """
    if neck.radius is None:
        return
    for name in ("radius", "length", "film_stiffness"):
        size = getattr(neck, name)
        if is_concrete(size) and not bool(jnp.all(size > 0)):
            raise InputError(f"neck.{name} is {float(jnp.min(size)):g}: make it positive")


def moment(tube: Tube, curvature: Numbers, force: Numbers) -> Numbers:
    """Moment of a section about its centre, N m (Comer and Levy, AIAA Journal 1, 1963).

    Film is strained in proportion to its distance from where it is slack, and bears

        N = 2 E t r^2 k (sin d - d cos d),   M = E t r^3 k (d - sin d cos d)

    with d, the half-angle of its tight part from the stretched side on, pi until its compressed
    side is slack: at M = N r / 2. For a large curvature M goes to N r.

    Arguments:
        curvature: k, 1/m.
        force: N, that stretches the film along the tube, N; none where it is negative.
    """
    angle, _ = _tight(tube, curvature, force)
    return tube.film_stiffness * tube.radius**3 * curvature * _bent(angle)


def energy(tube: Tube, curvature: Numbers, force: Numbers) -> Numbers:
    """Energy of a length of tube that is bent under a constant force, J/m; 0 where it is straight.

    Its slope over the curvature is `moment`, and over the force the shortening at the centre.
    Arguments as of `moment`.
    """
    force = larger(force, 0)
    _, strain = _tight(tube, curvature, force)
    straight = force / (2 * jnp.pi * tube.radius * tube.film_stiffness)
    # Of a film without compression, energy is quadratic: half of what forces do.
    return (moment(tube, curvature, force) * curvature - force * (strain - straight)) / 2


def curvature(tube: Tube, moment: Numbers, force: Numbers) -> Numbers:
    """Curvature under a moment, 1/m: the inverse of `moment`; infinite from N r on."""
    most = force * tube.radius
    # Without a force it collapses under any moment.
    without = jnp.where(jnp.abs(moment) > 0, jnp.inf, 0.0)
    load = jnp.where(most > 0, jnp.abs(moment) / jnp.where(most > 0, most, 1), without)
    share = stiff_share(load)
    stiffness = jnp.pi * tube.film_stiffness * tube.radius**3 * share
    folded = share <= 0
    bent = moment / jnp.where(folded, 1, stiffness)
    return jnp.where(folded, jnp.sign(moment) * jnp.inf, bent)


def stiff_share(load: Numbers) -> Numbers:
    """Moment over that which the same curvature takes without wrinkles, by M / (N r).

    1 up to a half, where wrinkles begin, and 0 from 1 on, where the tube collapses.
    """
    # Both at the ends, and at a load that is beyond them, no angle is looked for.
    wrinkled = (load > 0.5) & (load < 1)
    missing = 2 * (1 - jnp.where(wrinkled, load, 0.75))
    angle = _root(_load, 1 - missing / 2, _guess(jnp.sqrt(missing), 2.0, 5**0.5))
    return jnp.where(wrinkled, _bent(angle) / jnp.pi, jnp.where(load < 1, 1.0, 0.0))


def neck_moment(neck: Neck, angle: Numbers, compression: Numbers) -> Numbers:
    """Moment with which a neck resists a bend, N m, towards 0.

    That of `moment` at the curvature k = angle / length and the force N = p pi r^2 - F. From
    2 r k = 1 on its gas has no room at depths y > 1 / k below the stretched side, and the neck
    folds by itself: M falls by p int y dA over this part. The strain of the film is left out
    beside 1 where that part begins.

    Arguments:
        angle: by which the neck is bent, rad.
        compression: F of the muscles along the tube, N.
    """
    bent, (_, arm) = angle / neck.length, _shut(neck, angle)
    film = moment(neck.tube, bent, stretching(neck, compression))
    return film - jnp.sign(angle) * neck.pressure * arm


def neck_energy(neck: Neck, angle: Numbers, compression: Numbers) -> Numbers:
    """Energy of a bent neck under a constant compression, J: the integral of `neck_moment`.

    That of its film, less what gas and muscles do; 0 in the straight neck.
    """
    bent, (area, arm) = jnp.abs(angle) / neck.length, _shut(neck, angle)
    film = energy(neck.tube, bent, stretching(neck, compression))
    return neck.length * (film - neck.pressure * (bent * arm - area))


def stretching(neck: Neck, compression: Numbers) -> Numbers:
    """Force p pi r^2 - F that stretches the film of a neck, N: without any it carries nothing."""
    return neck.pressure * jnp.pi * neck.tube.radius**2 - compression


def _tight(tube: Tube, curvature: Numbers, force: Numbers) -> tuple[Numbers, Numbers]:
    """Half-angle of the tight part of a section, rad, and strain at its centre."""
    size, force = jnp.abs(curvature), larger(force, 0)
    stretch = force / (2 * tube.film_stiffness * tube.radius)
    whole = (size * tube.radius * jnp.pi <= stretch) & (stretch > 0)
    share = jnp.where(whole, jnp.pi, stretch / jnp.where(size > 0, size * tube.radius, 1))
    root = jnp.cbrt(jnp.where(share > 0, share, 1) / jnp.pi)
    guess = _guess(root, 6**0.5, (3 * jnp.pi) ** (1 / 3))
    angle = jnp.where(share > 0, _root(_stretched, share, guess), 0)
    return angle, jnp.where(whole, stretch / jnp.pi, -size * tube.radius * jnp.cos(angle))


def _stretched(angle: Array) -> Array:
    """N / (2 E t r^2 k) of a half-angle."""
    return angle**3 * _stretched_over_cube(angle)


def _bent(angle: Array) -> Array:
    """M / (E t r^3 k) of a half-angle."""
    return angle**3 * _bent_over_cube(angle)


def _load(angle: Array) -> Array:
    """M / (N r) of a half-angle."""
    return _bent_over_cube(angle) / (2 * _stretched_over_cube(angle))


def _stretched_over_cube(angle: Array) -> Array:
    return _over_cube(angle, jnp.sin(angle) - angle * jnp.cos(angle), _STRETCHED)


def _bent_over_cube(angle: Array) -> Array:
    return _over_cube(angle, angle - jnp.sin(angle) * jnp.cos(angle), _BENT)


def _over_cube(angle: Array, value: Array, series: np.ndarray) -> Array:
    """A value that begins with the cube of an angle over that cube."""
    # Where it is small, the difference has no digits left.
    small = angle < _SMALL
    powers = jnp.asarray(series, angle.dtype)
    by_series = jnp.polyval(powers, jnp.where(small, angle, 0) ** 2)
    return jnp.where(small, by_series, value / jnp.where(small, 1, angle) ** 3)


def _guess(part: Array, whole: float, folded: float) -> Array:
    """A half-angle by the power of a load that it is proportional to where little is tight.

    That is folded times `part`; where all is, `whole` times sqrt(1 - part) is missing of pi.
    """
    missing = jnp.sqrt(larger(1 - part, 0))
    return part * (jnp.pi - whole * missing + (whole + folded - jnp.pi) * missing**2)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _root(function: Callable[[Array], Array], value: Array, guess: Array) -> Array:
    """The half-angle at which a function has a value, near a guess; its slope is implicit."""
    angle = guess
    for _ in range(_STEPS):
        reached, slope = _with_slope(function, angle)
        angle = limited(angle - (reached - value) / slope, 0, jnp.pi)
    return angle


@_root.defjvp
def _root_jvp(function: Any, primals: Any, tangents: Any) -> tuple[Array, Array]:
    angle = _root(function, *primals)
    return angle, tangents[0] / _with_slope(function, angle)[1]


def _with_slope(function: Callable[[Array], Array], angle: Array) -> tuple[Array, Array]:
    reached, slope = jax.jvp(function, (angle,), (jnp.ones_like(angle),))
    # It is 0 where all or nothing is tight, which is no angle that is looked for from afar.
    return reached, jnp.where(slope == 0, 1, slope)


def _shut(neck: Neck, angle: Numbers) -> tuple[Numbers, Numbers]:
    """Area of the part of a bent neck where gas has no room, m^2, and its first moment below the
    stretched side, m^3.
    """
    radius = neck.tube.radius
    turned = 2 * radius * jnp.abs(angle)
    folded = turned > neck.length
    depth = jnp.where(folded, neck.length / jnp.where(folded, turned, 1), 0.5)
    # Half of the arc that is shut, from the compressed side on.
    half = jnp.where(folded, jnp.arccos(2 * depth - 1), 0)
    area = radius**2 * (half - jnp.sin(half) * jnp.cos(half))
    return area, radius * area + 2 / 3 * (radius * jnp.sin(half)) ** 3
