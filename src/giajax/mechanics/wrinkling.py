"""Bending of an inflated tube that may be tight, wrinkled or folded."""

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

_STEPS = 4  # Newton steps, after which the angle is exact to rounding from these initial guesses
_SMALL = 0.5  # rad; below this angle, functions of the angle are computed as series
# Coefficients of (sin d - d cos d) / d^3 and (d - sin d cos d) / d^3 as polynomials in d^2, highest
# power first.
_ODD = 2 * np.arange(9, 0, -1) + 1
_SIGNS = (-1.0) ** (_ODD // 2 + 1) / np.array([float(factorial(n)) for n in _ODD.tolist()])
_STRETCHED, _BENT = _SIGNS * (_ODD - 1), _SIGNS * 2.0 ** (_ODD - 1)


class Tube(NamedTuple):
    """A thin tube of film that bears no compression.

    Attributes:
        radius: radius of the tube, m.
        film_stiffness: modulus times thickness of the film, N/m.
    """

    radius: Array
    film_stiffness: Array


class NeckFilm(eqx.Module):
    """The film of a neck between two links, filled with the gas of the links.

    If the radius is None, there is no neck, and the joint is a hinge.

    Raises:
        InputError: a dimension is not positive.
    """

    radius: Scalar | None = parameter(NECK.radius)
    length: Scalar = parameter(NECK.length)
    film_stiffness: Scalar = parameter(NECK.film_stiffness)

    def __check_init__(self) -> None:
        check_neck(self)

    def filled(self, pressure: Array) -> "Neck":
        """Return the neck filled with gas.

        Arguments:
            pressure: gauge pressure, Pa; one number, or one for each joint.
        """
        return Neck(self.radius, self.length, self.film_stiffness, pressure)


class Neck(eqx.Module):
    """The neck of film between two links, which bends with the joint.

    If the radius is None, there is no neck, and the joint is a hinge.
    """

    radius: Scalar | None = parameter(NECK.radius)
    length: Scalar = parameter(NECK.length)
    film_stiffness: Scalar = parameter(NECK.film_stiffness)
    pressure: Scalar = parameter(NECK.pressure)

    @property
    def tube(self) -> Tube:
        """The tube of which the neck is a piece."""
        assert self.radius is not None
        return Tube(self.radius, self.film_stiffness)

    @property
    def stiffness(self) -> Scalar:
        """Stiffness of the straight and tight neck, N m/rad; an upper bound of its stiffness."""
        tube = self.tube
        return jnp.pi * tube.film_stiffness * tube.radius**3 / self.length


def check_neck(neck: NeckFilm | Neck) -> None:
    """Check that the dimensions of a neck are positive.

    Raises:
        InputError: a dimension is not positive; the message names it.
    """
    if neck.radius is None:
        return
    for name in ("radius", "length", "film_stiffness"):
        size = getattr(neck, name)
        if is_concrete(size) and not bool(jnp.all(size > 0)):
            raise InputError(f"neck.{name} is {float(jnp.min(size)):g}: make it positive")


def moment(tube: Tube, curvature: Numbers, force: Numbers) -> Numbers:
    """Return the moment of a cross-section about its centre, N m.

    The strain of the film is proportional to its distance from the line at which the film becomes
    slack (Comer and Levy, AIAA Journal 1, 1963). The film bears the force and the moment

        N = 2 E t r^2 k (sin d - d cos d),   M = E t r^3 k (d - sin d cos d).

    Here d is the half-angle of the tight part, measured from the stretched side. It is pi until the
    compressed side becomes slack at M = N r / 2. For a large curvature, M approaches N r.

    Arguments:
        curvature: curvature k of the tube, 1/m.
        force: force N that stretches the film along the tube, N; a negative force acts as 0.
    """
    angle, _ = _tight(tube, curvature, force)
    return tube.film_stiffness * tube.radius**3 * curvature * _bent(angle)


def energy(tube: Tube, curvature: Numbers, force: Numbers) -> Numbers:
    """Return the energy per length of a tube bent under a constant force, J/m; 0 if straight.

    The derivative with respect to the curvature is `moment`. The derivative with respect to the
    force is the shortening at the centre. The arguments are those of `moment`.
    """
    force = larger(force, 0)
    _, strain = _tight(tube, curvature, force)
    straight = force / (2 * jnp.pi * tube.radius * tube.film_stiffness)
    # The strain energy of a film without compression is homogeneous of degree 2 in curvature and
    # strain: (M k + N strain) / 2. The potential of the constant force contributes -N strain.
    return (moment(tube, curvature, force) * curvature - force * (strain - straight)) / 2


def curvature(tube: Tube, moment: Numbers, force: Numbers) -> Numbers:
    """Return the curvature under a moment, 1/m: the inverse of `moment`; infinite from N r on."""
    most = force * tube.radius
    # Without a stretching force, the tube collapses under any moment.
    without = jnp.where(jnp.abs(moment) > 0, jnp.inf, 0.0)
    load = jnp.where(most > 0, jnp.abs(moment) / jnp.where(most > 0, most, 1), without)
    share = stiff_share(load)
    stiffness = jnp.pi * tube.film_stiffness * tube.radius**3 * share
    folded = share <= 0
    bent = moment / jnp.where(folded, 1, stiffness)
    return jnp.where(folded, jnp.sign(moment) * jnp.inf, bent)


def stiff_share(load: Numbers) -> Numbers:
    """Return the ratio of the moment to that of an unwrinkled tube at the same curvature.

    The ratio is 1 up to a load of 1/2, where wrinkles appear, and 0 from a load of 1, where the
    tube collapses.

    Arguments:
        load: M / (N r).
    """
    # The angle is computed only between these two loads.
    wrinkled = (load > 0.5) & (load < 1)
    missing = 2 * (1 - jnp.where(wrinkled, load, 0.75))
    angle = _root(_load, 1 - missing / 2, _guess(jnp.sqrt(missing), 2.0, 5**0.5))
    return jnp.where(wrinkled, _bent(angle) / jnp.pi, jnp.where(load < 1, 1.0, 0.0))


def neck_moment(neck: Neck, angle: Numbers, compression: Numbers) -> Numbers:
    """Return the moment with which a neck resists bending, towards 0, N m.

    The film contributes `moment` at the curvature k = angle / length and the force
    N = p pi r^2 - F. For 2 r k > 1 there is no space for gas at depths y > 1 / k below the
    stretched side, and the neck folds by itself. The moment then decreases by p int y dA over this
    part. The start of this part is computed without the strain of the film, which is small compared
    to 1.

    Arguments:
        angle: bending angle of the neck, rad.
        compression: force F of the muscles along the tube, N.
    """
    bent, (_, arm) = angle / neck.length, _shut(neck, angle)
    film = moment(neck.tube, bent, stretching(neck, compression))
    return film - jnp.sign(angle) * neck.pressure * arm


def neck_energy(neck: Neck, angle: Numbers, compression: Numbers) -> Numbers:
    """Return the energy of a bent neck under a constant compression, J.

    This is the integral of `neck_moment`: the energy of the film minus the work of gas and muscles.
    It is 0 in the straight neck.
    """
    bent, (area, arm) = jnp.abs(angle) / neck.length, _shut(neck, angle)
    film = energy(neck.tube, bent, stretching(neck, compression))
    return neck.length * (film - neck.pressure * (bent * arm - area))


def stretching(neck: Neck, compression: Numbers) -> Numbers:
    """Return the force p pi r^2 - F that stretches the film of a neck, N.

    If it is not positive, the neck bears no moment.
    """
    return neck.pressure * jnp.pi * neck.tube.radius**2 - compression


def _tight(tube: Tube, curvature: Numbers, force: Numbers) -> tuple[Numbers, Numbers]:
    """Return the half-angle of the tight part of a section, rad, and the strain at its centre."""
    size, force = jnp.abs(curvature), larger(force, 0)
    stretch = force / (2 * tube.film_stiffness * tube.radius)
    whole = (size * tube.radius * jnp.pi <= stretch) & (stretch > 0)
    share = jnp.where(whole, jnp.pi, stretch / jnp.where(size > 0, size * tube.radius, 1))
    root = jnp.cbrt(jnp.where(share > 0, share, 1) / jnp.pi)
    guess = _guess(root, 6**0.5, (3 * jnp.pi) ** (1 / 3))
    angle = jnp.where(share > 0, _root(_stretched, share, guess), 0)
    return angle, jnp.where(whole, stretch / jnp.pi, -size * tube.radius * jnp.cos(angle))


def _stretched(angle: Array) -> Array:
    """Return N / (2 E t r^2 k) for a half-angle."""
    return angle**3 * _stretched_over_cube(angle)


def _bent(angle: Array) -> Array:
    """Return M / (E t r^3 k) for a half-angle."""
    return angle**3 * _bent_over_cube(angle)


def _load(angle: Array) -> Array:
    """Return M / (N r) for a half-angle."""
    return _bent_over_cube(angle) / (2 * _stretched_over_cube(angle))


def _stretched_over_cube(angle: Array) -> Array:
    return _over_cube(angle, jnp.sin(angle) - angle * jnp.cos(angle), _STRETCHED)


def _bent_over_cube(angle: Array) -> Array:
    return _over_cube(angle, angle - jnp.sin(angle) * jnp.cos(angle), _BENT)


def _over_cube(angle: Array, value: Array, series: np.ndarray) -> Array:
    """Divide a function of an angle, whose series starts with the cube of the angle, by this cube.

    Arguments:
        angle: angle, rad.
        value: value of the function.
        series: coefficients of the quotient in powers of the squared angle, highest power first.
    """
    # For small angles, the differences in `value` lose all significant digits.
    small = angle < _SMALL
    powers = jnp.asarray(series, angle.dtype)
    by_series = jnp.polyval(powers, jnp.where(small, angle, 0) ** 2)
    return jnp.where(small, by_series, value / jnp.where(small, 1, angle) ** 3)


def _guess(part: Array, whole: float, folded: float) -> Array:
    """Return an initial guess of a half-angle that is correct at both ends of its range.

    Arguments:
        part: variable to which the half-angle is proportional when it is small; 1 when the whole
            section is tight.
        whole: near `part` = 1, the half-angle is pi minus `whole` times sqrt(1 - part).
        folded: near `part` = 0, the half-angle is `folded` times `part`.
    """
    missing = jnp.sqrt(larger(1 - part, 0))
    return part * (jnp.pi - whole * missing + (whole + folded - jnp.pi) * missing**2)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _root(function: Callable[[Array], Array], value: Array, guess: Array) -> Array:
    """Return the half-angle at which a function has a value, by Newton's method.

    The derivative is that of the implicit function.
    """
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
    # The slope is 0 only where all or none of the section is tight. Replace it there, so that the
    # Newton step stays finite.
    return reached, jnp.where(slope == 0, 1, slope)


def _shut(neck: Neck, angle: Numbers) -> tuple[Numbers, Numbers]:
    """Return the area of the folded part of a bent neck, m^2, and its first moment, m^3.

    In the folded part there is no space for gas. The first moment is taken about the stretched
    side.
    """
    radius = neck.tube.radius
    turned = 2 * radius * jnp.abs(angle)
    folded = turned > neck.length
    depth = jnp.where(folded, neck.length / jnp.where(folded, turned, 1), 0.5)
    # Half of the arc of the folded part, measured from the compressed side.
    half = jnp.where(folded, jnp.arccos(2 * depth - 1), 0)
    area = radius**2 * (half - jnp.sin(half) * jnp.cos(half))
    return area, radius * area + 2 / 3 * (radius * jnp.sin(half)) ** 3
