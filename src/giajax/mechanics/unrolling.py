"""Geometry, inertia, energies and forces of an arm that unrolls from a core."""

from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..runtime.arrays import Array, Float, Scalar, larger, limited
from ..runtime.text import InputError
from ..schema import FILM, HAND, ROLL, UnrollingSection
from ..schema.parameters import declared, inline, parameter, replace
from .arm import STANDARD_GRAVITY
from .inflation import Filling, stretch_pressure

ORDERS = ("roll first", "by gas")
HANDS = ("speed", "force")


class Roll(eqx.Module):
    """The roll: a flat arm wound on a core, with the base of the arm on the outside."""

    radius: Scalar = parameter(ROLL.radius)
    core_radius: Scalar = parameter(ROLL.core_radius)
    core_mass: Scalar = parameter(ROLL.core_mass)
    start: Scalar = parameter(ROLL.start)
    start_speed: Scalar = parameter(ROLL.start_speed)


class Film(eqx.Module):
    """The film in the roll: bending, adhesion of its layers, and other resistance."""

    thickness: Scalar = parameter(FILM.thickness)
    creep: Scalar = parameter(FILM.creep)
    peel: Scalar = parameter(FILM.peel)
    loss: Scalar = parameter(FILM.loss)


class Hand(eqx.Module):
    """The hand that unrolls the arm.

    Arguments:
        kind: "speed" for a constant speed, or "force" for a constant force.
    """

    kind: str = eqx.field(static=True, default="speed")
    speed: Scalar = parameter(HAND.speed)
    force: Scalar = parameter(HAND.force)

    def __check_init__(self) -> None:
        if self.kind not in HANDS:
            raise InputError(f"there is no hand '{self.kind}': use one of {', '.join(HANDS)}")


class Unrolling(eqx.Module):
    """A rolled arm that is unrolled by a hand or by gas (fig. 14).

    Every array can be differentiated and replaced (`giajax.replace`).

    Arguments:
        filling: the arm with its gas, skin, ports and supply.
        roll: the roll.
        film: the film in the roll.
        hand: the hand that unrolls the arm if the order is "roll first".
        order: "roll first" (a hand unrolls the arm without gas, as in the paper), or "by gas".
        carried: whether the roll is carried instead of lying on a floor.

    Raises:
        InputError: the order is not one of these two.

    Example:
        >>> import giajax
        >>> round(float(giajax.mechanics.unrolling.Unrolling().pitch) * 1e3, 2)
        1.19
    """

    filling: Filling = inline(default_factory=Filling)
    roll: Roll = eqx.field(default_factory=Roll)
    film: Film = eqx.field(default_factory=Film)
    hand: Hand = eqx.field(default_factory=Hand)
    order: str = eqx.field(static=True, default="roll first")
    carried: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        if self.order not in ORDERS:
            raise InputError(f"there is no order '{self.order}': use one of {', '.join(ORDERS)}")

    @classmethod
    def from_section(cls, section: UnrollingSection, filling: Filling) -> Self:
        """Create the unrolling of a filling from an `[unrolling]` section.

        Raises:
            InputError: see the class.
        """
        made = cls(
            filling=filling,
            hand=Hand(kind=section.hand or "speed"),
            order=section.order or "roll first",
            carried=bool(section.carried),
        )
        return replace(made, section.values())

    def definition(self) -> dict[str, Any]:
        """Return the `[unrolling]` section with every key."""
        values = {path: np.asarray(p.value(self)) for path, p in declared(self).items()}
        words = {"order": self.order, "hand": self.hand.kind, "carried": self.carried}
        return {**words, **UnrollingSection.keys_of(values)}

    @property
    def by_gas(self) -> bool:
        """Whether gas unrolls the arm."""
        return self.order == "by gas"

    @property
    def ends(self) -> Float[Array, " link"]:
        """Position of the end of each link along the straight arm, m."""
        return jnp.cumsum(self.filling.arm.links.length)

    @property
    def length(self) -> Scalar:
        """Length of the arm, m."""
        return jnp.sum(self.filling.arm.links.length)

    @property
    def pitch(self) -> Scalar:
        """Thickness h of a layer of the roll, m, from pi (R^2 - R0^2) = h L for the whole arm."""
        roll = self.roll
        return jnp.pi * (roll.radius**2 - roll.core_radius**2) / self.length

    @property
    def film_stiffness(self) -> Scalar:
        """Bending stiffness of one film per width, N m: E t^3 / (12 (1 - nu^2))."""
        skin = self.filling.skin
        return skin.stiffness * self.film.thickness**2 / (12 * (1 - skin.poisson_ratio**2))

    @property
    def stretch(self) -> Scalar:
        """Pressure divided by the relative volume increase that it causes in the whole tube, Pa."""
        links = self.filling.arm.links
        each = links.volume / stretch_pressure(self.filling.skin, links.diameter)
        return jnp.sum(links.volume) / jnp.sum(each)


def _wound_from(unrolling: Unrolling, paid_out: Scalar) -> Float[Array, " link"]:
    """Return the position along the arm at which the wound part of each link starts, m."""
    ends = unrolling.ends
    return limited(paid_out, ends - unrolling.filling.arm.links.length, ends)


def roll_radius(unrolling: Unrolling, paid_out: Float[Array, "*x"]) -> Float[Array, "*x"]:
    """Return the radius R of the roll, m, from pi (R^2 - R0^2) = h (L - x).

    Arguments:
        unrolling: the unrolling arm.
        paid_out: unrolled length x of the arm, m.
    """
    return jnp.sqrt(_squared_radius(unrolling, paid_out))


def _squared_radius(unrolling: Unrolling, paid_out: Float[Array, "*x"]) -> Float[Array, "*x"]:
    # A trial step of the integrator may exceed the length of the arm.
    wound = larger(unrolling.length - paid_out, 0.0)
    return unrolling.roll.core_radius**2 + unrolling.pitch * wound / jnp.pi


class Inertia(NamedTuple):
    """Inertia of a roll.

    Attributes:
        mass: mass, kg.
        moment: moment of inertia about the axis of the roll, kg m^2.
    """

    mass: Scalar
    moment: Scalar


def roll_inertia(unrolling: Unrolling, paid_out: Scalar) -> Inertia:
    """Return mass and moment of inertia of the roll.

    The core is modelled as a thin tube, and the wound part of each link as a uniform ring. A ring
    between the radii a and b has the moment of inertia m (a^2 + b^2) / 2.
    """
    links, roll = unrolling.filling.arm.links, unrolling.roll
    begin, end = _wound_from(unrolling, paid_out), unrolling.ends
    mass = unrolling.filling.borne_mass * (end - begin) / links.length
    squares = _squared_radius(unrolling, begin) + _squared_radius(unrolling, end)
    moment = jnp.sum(mass * squares) / 2 + roll.core_mass * roll.core_radius**2
    return Inertia(jnp.sum(mass) + roll.core_mass, moment)


def rolling_mass(unrolling: Unrolling, paid_out: Scalar) -> Scalar:
    """Return the effective mass m + I / R^2 of the roll, kg.

    The kinetic energy is half of this mass times the squared speed. The roll turns about the line
    at which it touches the unrolled part of the arm, which is at rest.
    """
    inertia = roll_inertia(unrolling, paid_out)
    return inertia.mass + inertia.moment / _squared_radius(unrolling, paid_out)


def weight_energy(unrolling: Unrolling, paid_out: Scalar) -> Scalar:
    """Return the potential energy m g R of a roll on a floor, J; 0 if the roll is carried."""
    if unrolling.carried:
        return jnp.zeros_like(paid_out)
    mass = roll_inertia(unrolling, paid_out).mass
    return mass * STANDARD_GRAVITY * roll_radius(unrolling, paid_out)


def bending_energy(unrolling: Unrolling, paid_out: Scalar) -> Scalar:
    """Return the elastic energy of the two films relative to that of the fully wound arm, J.

    The films have the width w = pi d / 2 and the bending stiffness D, and are wound at the radius
    R. By creep, they retain the fraction s of this curvature. Their energy per length is
    D w (1 - s)^2 / R^2 in the roll and D w s^2 / R^2 when they are straight. The difference is
    integrated over the unrolled length.
    """
    diameter = unrolling.filling.arm.links.diameter
    begin = unrolling.ends - unrolling.filling.arm.links.length
    ratio = _squared_radius(unrolling, begin) / _squared_radius(
        unrolling, _wound_from(unrolling, paid_out)
    )
    # The integral of 1 / R^2 over a length.
    integral = jnp.pi / unrolling.pitch * jnp.log(ratio)
    width = jnp.pi * diameter / 2
    return (2 * unrolling.film.creep - 1) * unrolling.film_stiffness * jnp.sum(width * integral)


def open_volume(unrolling: Unrolling, paid_out: Scalar) -> Float[Array, " link"]:
    """Return the volume of the unrolled part of each link, tight and unstretched, m^3."""
    links = unrolling.filling.arm.links
    begin = unrolling.ends - links.length
    return links.volume * (_wound_from(unrolling, paid_out) - begin) / links.length


class Forces(NamedTuple):
    """Forces along the path of the roll, N; forces that oppose its motion are negative.

    Attributes:
        gas: pressure times cross-section of the tube.
        weight: force due to the weight of the roll, whose axis sinks as the roll becomes thinner.
        bending: force due to the bending energy of the film.
        peel: force that separates the layers of the film.
        loss: force proportional to the speed.
        inertia: force -M' v^2 / 2 due to the change in the effective mass M of the roll.
    """

    gas: Scalar
    weight: Scalar
    bending: Scalar
    peel: Scalar
    loss: Scalar
    inertia: Scalar


_CREEPING = 1e-4
"""Speed (m/s) at which the peel force reaches tanh(1) = 76 % of its full value."""


def roll_forces(unrolling: Unrolling, paid_out: Scalar, speed: Scalar, pressure: Scalar) -> Forces:
    """Return the forces on the roll except that of a hand.

    Arguments:
        unrolling: the unrolling arm.
        paid_out: unrolled length of the arm, m.
        speed: speed of the roll, m/s.
        pressure: gauge pressure in the unrolled part, Pa.
    """

    def slope(of: Any) -> Scalar:
        return jax.grad(of, argnums=1)(unrolling, paid_out)

    def volume(unrolling: Unrolling, x: Scalar) -> Scalar:
        return jnp.sum(open_volume(unrolling, x))

    return Forces(
        gas=pressure * slope(volume),
        weight=-slope(weight_energy),
        bending=-slope(bending_energy),
        peel=-unrolling.film.peel * jnp.tanh(speed / _CREEPING),
        loss=-unrolling.film.loss * speed,
        inertia=-slope(rolling_mass) * speed**2 / 2,
    )
