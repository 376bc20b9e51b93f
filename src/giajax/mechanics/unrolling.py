"""An arm that is wound on a core: geometry, inertia and energies of the roll as it is paid out."""

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
    """The roll: an arm that lies flat, wound on a core, its base outside."""

    radius: Scalar = parameter(ROLL.radius)
    core_radius: Scalar = parameter(ROLL.core_radius)
    core_mass: Scalar = parameter(ROLL.core_mass)
    start: Scalar = parameter(ROLL.start)
    start_speed: Scalar = parameter(ROLL.start_speed)


class Film(eqx.Module):
    """The film in the roll: how it bends, how its layers stick, and what else holds it back."""

    thickness: Scalar = parameter(FILM.thickness)
    creep: Scalar = parameter(FILM.creep)
    peel: Scalar = parameter(FILM.peel)
    loss: Scalar = parameter(FILM.loss)


class Hand(eqx.Module):
    """Who rolls the arm out.

    Arguments:
        kind: "speed" or "force", which of the two is held.
    """

    kind: str = eqx.field(static=True, default="speed")
    speed: Scalar = parameter(HAND.speed)
    force: Scalar = parameter(HAND.force)

    def __check_init__(self) -> None:
        if self.kind not in HANDS:
            raise InputError(f"there is no hand '{self.kind}': use one of {', '.join(HANDS)}")


class Unrolling(eqx.Module):
    """A rolled arm that is paid out by a hand or by gas (fig. 14).

    Every array may be differentiated and replaced (`giajax.replace`).

    Arguments:
        filling: the arm, its gas, skin and supply, and how it is filled when it is unrolled.
        order: "roll first" (a hand rolls the arm out without gas, as in the paper), or "by gas".
        carried: the roll is carried, and does not lie on a floor.

    Raises:
        InputError: another order.

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
        """The unrolling that an `[unrolling]` section states, of what is filled.

        Raises:
            InputError: as of the class.
        """
        made = cls(
            filling=filling,
            hand=Hand(kind=section.hand or "speed"),
            order=section.order or "roll first",
            carried=bool(section.carried),
        )
        return replace(made, section.values())

    def definition(self) -> dict[str, Any]:
        """The `[unrolling]` section, with every key."""
        values = {path: np.asarray(p.value(self)) for path, p in declared(self).items()}
        words = {"order": self.order, "hand": self.hand.kind, "carried": self.carried}
        return {**words, **UnrollingSection.keys_of(values)}

    @property
    def by_gas(self) -> bool:
        """Whether gas drives it."""
        return self.order == "by gas"

    @property
    def ends(self) -> Float[Array, " link"]:
        """Where each link ends along the straight arm, m."""
        return jnp.cumsum(self.filling.arm.links.length)

    @property
    def length(self) -> Scalar:
        """Length of the arm, m."""
        return jnp.sum(self.filling.arm.links.length)

    @property
    def pitch(self) -> Scalar:
        """Thickness h of a layer of the roll, m, by pi (R^2 - R0^2) = h L of the whole arm."""
        roll = self.roll
        return jnp.pi * (roll.radius**2 - roll.core_radius**2) / self.length

    @property
    def film_stiffness(self) -> Scalar:
        """Bending stiffness of one film over its width, N m: E t^3 / (12 (1 - nu^2))."""
        skin = self.filling.skin
        return skin.stiffness * self.film.thickness**2 / (12 * (1 - skin.poisson_ratio**2))

    @property
    def stretch(self) -> Scalar:
        """Pressure over the part of its volume by which the whole tube stretches, Pa."""
        links = self.filling.arm.links
        each = links.volume / stretch_pressure(self.filling.skin, links.diameter)
        return jnp.sum(links.volume) / jnp.sum(each)


def _wound_from(unrolling: Unrolling, paid_out: Scalar) -> Float[Array, " link"]:
    """Where the part of each link that is still wound begins, m along the arm."""
    ends = unrolling.ends
    return limited(paid_out, ends - unrolling.filling.arm.links.length, ends)


def roll_radius(unrolling: Unrolling, paid_out: Float[Array, "*x"]) -> Float[Array, "*x"]:
    """Radius of the roll, m, with so much of the arm paid out (m): pi (R^2 - R0^2) = h (L - x)."""
    return jnp.sqrt(_squared_radius(unrolling, paid_out))


def _squared_radius(unrolling: Unrolling, paid_out: Float[Array, "*x"]) -> Float[Array, "*x"]:
    # A step that the integrator tries may go beyond the end.
    wound = larger(unrolling.length - paid_out, 0.0)
    return unrolling.roll.core_radius**2 + unrolling.pitch * wound / jnp.pi


class Inertia(NamedTuple):
    """Of a roll: its mass, kg, and its moment of inertia about its axis, kg m^2."""

    mass: Scalar
    moment: Scalar


def roll_inertia(unrolling: Unrolling, paid_out: Scalar) -> Inertia:
    """Mass and moment of inertia of the roll: the core, and a ring of each link's wound part.

    A uniform ring from radius a to b has m (a^2 + b^2) / 2. The spiral is taken for rings, and the
    core for a thin tube.
    """
    links, roll = unrolling.filling.arm.links, unrolling.roll
    begin, end = _wound_from(unrolling, paid_out), unrolling.ends
    mass = unrolling.filling.borne_mass * (end - begin) / links.length
    squares = _squared_radius(unrolling, begin) + _squared_radius(unrolling, end)
    moment = jnp.sum(mass * squares) / 2 + roll.core_mass * roll.core_radius**2
    return Inertia(jnp.sum(mass) + roll.core_mass, moment)


def rolling_mass(unrolling: Unrolling, paid_out: Scalar) -> Scalar:
    """What the roll has of inertia against its speed, kg: the kinetic energy is half of it v^2.

    The roll turns about the line where it touches what is paid out, which is at rest: m + I / R^2.
    """
    inertia = roll_inertia(unrolling, paid_out)
    return inertia.mass + inertia.moment / _squared_radius(unrolling, paid_out)


def weight_energy(unrolling: Unrolling, paid_out: Scalar) -> Scalar:
    """Potential energy of the roll on a floor, J: m g R; none where it is carried."""
    if unrolling.carried:
        return jnp.zeros_like(paid_out)
    mass = roll_inertia(unrolling, paid_out).mass
    return mass * STANDARD_GRAVITY * roll_radius(unrolling, paid_out)


def bending_energy(unrolling: Unrolling, paid_out: Scalar) -> Scalar:
    """Elastic energy of the two films beyond that of the whole arm in the roll, J.

    Of films of the width pi d / 2 and the bending stiffness D, wound at the radius R, of whose
    curvature they keep the share s as their own: D w (1 - s)^2 / R^2 a metre in the roll, and
    D w s^2 / R^2 when they are straight. The difference is integrated over what is paid out.
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
    """Volume of each link that is paid out, tight and not stretched, m^3."""
    links = unrolling.filling.arm.links
    begin = unrolling.ends - links.length
    return links.volume * (_wound_from(unrolling, paid_out) - begin) / links.length


class Forces(NamedTuple):
    """Forces along the way of the roll, N; those that hold it back are negative.

    Attributes:
        gas: pressure times the area of the tube.
        weight: of the roll, which sinks as it gets thinner.
        bending: of the film.
        peel: of layers that come apart.
        loss: over the speed.
        inertia: of the change of the roll's inertia, -M' v^2 / 2.
    """

    gas: Scalar
    weight: Scalar
    bending: Scalar
    peel: Scalar
    loss: Scalar
    inertia: Scalar


_CREEPING = 1e-4
"""Speed (m/s) at which the peel force has reached tanh(1) = 76 % of its value."""


def roll_forces(unrolling: Unrolling, paid_out: Scalar, speed: Scalar, pressure: Scalar) -> Forces:
    """The forces on the roll, but that of a hand.

    Arguments:
        paid_out: length of the arm that is paid out, m.
        speed: of the roll, m/s.
        pressure: in what is paid out, above that of the room, Pa.
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
