"""An arm of balloons as gas: bags in a row, ports between them, and a supply."""

from itertools import pairwise
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ..runtime.arrays import Array, Float, Scalar, larger, limited
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema import GAS, PORTS, SKIN, SUPPLY, FillingSection
from ..schema.parameters import declared, inline, parameter, replace
from .arm import STANDARD_GRAVITY, Arm, bodies, takeichi_20m
from .wrinkling import stiff_share


class Gas(eqx.Module):
    """An ideal gas at the temperature of the room: helium."""

    density: Scalar = parameter(GAS.density)
    ambient_pressure: Scalar = parameter(GAS.ambient_pressure)
    viscosity: Scalar = parameter(GAS.viscosity)
    heat_capacity_ratio: Scalar = parameter(GAS.heat_capacity_ratio)

    @property
    def specific_energy(self) -> Scalar:
        """R T of the gas, J/kg: its pressure over its density."""
        return self.ambient_pressure / self.density


PerBag = Float[Array, " bag"]


class Skin(eqx.Module):
    """The skin of the bags: a thin elastic tube with closed ends."""

    stiffness: Scalar = parameter(SKIN.stiffness)
    poisson_ratio: Scalar = parameter(SKIN.poisson_ratio)
    slack: Scalar = parameter(SKIN.slack)


class BagState(NamedTuple):
    """What a bag's share of gas makes of it: its pressure above that of the room, Pa, and its
    volume over that of the tight bag without pressure, which is more where it stretches.
    """

    pressure: PerBag
    fullness: PerBag


def stretch_pressure(skin: Skin, diameter: Float[Array, "*tube"]) -> Float[Array, "*tube"]:
    """Pressure over the part of its volume by which it stretches a tube, Pa.

    Of a thin-walled tube with closed ends, hoop strain p r / (E t) (1 - nu / 2) twice, and
    p r / (E t) (1/2 - nu) along it: E t / (r (5/2 - 2 nu)).
    """
    return skin.stiffness / (diameter / 2 * (2.5 - 2 * skin.poisson_ratio))


def bag_state(gas: Gas, skin: Skin, stretch: PerBag, share: PerBag) -> BagState:
    """Pressure and volume of bags with this share of the gas that just fills them.

    Gas takes room until the bag is tight, and is then pressed together and stretches the skin:

        (1 + p / p_room) (1 + p / p_stretch) = 1 + s,  s = w softplus((share - 1) / w).

    The softplus is the last wrinkles: a bag is limp to within exp(-n) where n w of its gas is
    missing, has w log 2 at a share of 1, and s is share - 1 beyond.

    Arguments:
        stretch: `stretch_pressure` of each, Pa.
        share: mass of gas over that which fills the bag at the pressure of the room.
    """
    beyond = skin.slack * jax.nn.softplus((share - 1) / skin.slack)
    room = gas.ambient_pressure
    sum_of_inverses = 1 / room + 1 / stretch
    root = jnp.sqrt(sum_of_inverses**2 + 4 * beyond / (room * stretch))
    pressure = 2 * beyond / (sum_of_inverses + root)
    return BagState(pressure, share / (1 + pressure / room))


class BagEnergy(NamedTuple):
    """What bags hold of energy, J a cubic metre of the tight bag without pressure."""

    gas: PerBag
    skin: PerBag


# Where the pressure of a bag bends most, in slacks from full: ends of panels of Gauss's rule.
_PANELS = np.array([-36.0, -12.0, -4.0, 4.0, 12.0, 36.0])
_NODES = 16


def bag_energy(gas: Gas, skin: Skin, stretch: PerBag, share: PerBag) -> BagEnergy:
    """Work that the gas of bags could do until it is at the pressure of the room, and their skin.

    Of an ideal gas at the temperature of the room that is P V log(P / p_room) - p V, with P the
    absolute pressure and p that above the room, and of the skin the work of p on it. Where a bag
    takes gas, both together grow by R T log(P / p_room) a kilogram.

    Arguments: as of `bag_state`.
    """
    room, wrinkles = gas.ambient_pressure, 1 + skin.slack * _PANELS
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)

    def of_bag(stretch: Scalar, share: Scalar) -> BagEnergy:
        def state(share: Array) -> BagState:
            return bag_state(gas, skin, stretch, share)

        ends = limited(wrinkles, jnp.zeros_like(wrinkles), jnp.broadcast_to(share, wrinkles.shape))
        ends = jnp.append(ends, share)
        half = jnp.diff(ends)[:, None] / 2
        at = ends[:-1, None] + half * jnp.asarray(1 + nodes, share.dtype)[None]
        there, slope = jax.jvp(state, (at,), (jnp.ones_like(at),))
        weighted = half * jnp.asarray(weights, share.dtype)[None] * there.pressure * slope.fullness
        here = state(share)
        free = (room + here.pressure) * jnp.log1p(here.pressure / room) - here.pressure
        return BagEnergy(here.fullness * free, jnp.sum(weighted))

    found: BagEnergy = jax.vmap(of_bag)(stretch, share)
    return found


Numbers = Float[Array, "..."]


class Hole(NamedTuple):
    """A round hole: its diameter and length, m, and its discharge coefficient."""

    diameter: Numbers
    length: Numbers
    coefficient: Scalar


def mass_flow(gas: Gas, hole: Hole, before: Numbers, after: Numbers) -> Numbers:
    """Gas that a hole lets through, kg/s; negative from after to before.

    An isentropic orifice of Saint-Venant and Wantzel (ISO 6358-1 has it for air),

        m = C A p0 sqrt(2 k / ((k - 1) R T)) sqrt(g),  g = r^(2/k) - r^((k + 1)/k),

    with r the ratio of pressures, which is no less than the critical one,
    (2 / (k + 1))^(k / (k - 1)) = 0.487 for helium: there the slope of g is 0, and so the flow is
    smooth where it chokes. In series with it a short tube after Hagen and Poiseuille: in place of
    y = sqrt(g) it is y^2 + a y = g, so that the flow is laminar for small differences of pressure
    and has a slope at 0. Where the difference is small beside the pressure that is
    dp = 128 mu L Q / (pi d^4) + rho Q |Q| / (2 C^2 A^2).

    Pressures on both sides are absolute ones, Pa; the hole may be several.
    """
    k, rt = gas.heat_capacity_ratio, gas.specific_energy
    upstream = larger(before, after)
    most = 1 - critical_ratio(gas)
    signed = limited((before - after) / upstream, -most, most)
    drop = jnp.abs(signed)
    # g over the drop, which has a limit where there is none.
    known = jnp.where(drop == 0, most, drop)
    logarithm = jnp.log1p(-known)
    # Without what is lost where powers that are nearly the same are subtracted.
    known = jnp.exp(2 / k * logarithm) * -jnp.expm1((k - 1) / k * logarithm) / known
    slope = jnp.where(drop == 0, (k - 1) / k, known)
    area = jnp.pi / 4 * hole.diameter**2
    scale = hole.coefficient * area * upstream * jnp.sqrt(2 * k / ((k - 1) * rt))
    resistance = 128 * gas.viscosity * hole.length / (jnp.pi * hole.diameter**4)
    # For small drops the flow is (before - after) / resistance, times the density.
    laminar = scale * (k - 1) / k * resistance * rt / upstream**2
    return scale * signed * 2 * slope / (laminar + jnp.sqrt(laminar**2 + 4 * slope * drop))


def critical_ratio(gas: Gas) -> Scalar:
    """Pressure behind a hole over that before it, below which the flow is choked."""
    k = gas.heat_capacity_ratio
    return (2 / (k + 1)) ** (k / (k - 1))


class Supply(eqx.Module):
    """What feeds the first bag.

    Arguments:
        kind: "flow" (a flow meter holds it whatever the pressure), "regulator" (it holds a pressure
            before a restriction) or "bottle" (which empties through one, at the temperature of the
            room).
    """

    kind: str = eqx.field(static=True, default="flow")
    flow: Scalar = parameter(SUPPLY.flow)
    pressure: Scalar = parameter(SUPPLY.pressure)
    bottle_volume: Scalar = parameter(SUPPLY.bottle_volume)
    bottle_pressure: Scalar = parameter(SUPPLY.bottle_pressure)
    nozzle_diameter: Scalar = parameter(SUPPLY.nozzle_diameter)
    nozzle_length: Scalar = parameter(SUPPLY.nozzle_length)
    nozzle_coefficient: Scalar = parameter(SUPPLY.nozzle_coefficient)

    def __check_init__(self) -> None:
        if self.kind not in STRENGTHS:
            raise InputError(f"there is no supply '{self.kind}': use one of {', '.join(STRENGTHS)}")


STRENGTHS = {
    "flow": SUPPLY.flow.path,
    "regulator": SUPPLY.pressure.path,
    "bottle": SUPPLY.nozzle_diameter.path,
}
"""The parameter of each kind of supply that makes it feed more."""


def inflow(gas: Gas, supply: Supply, pressure: Scalar, supplied: Scalar) -> Scalar:
    """Gas that the supply feeds, kg/s.

    Arguments:
        pressure: of the first bag above that of the room, Pa.
        supplied: what the supply has fed, kg.
    """
    if supply.kind == "flow":
        return supply.flow * gas.density
    before = supply.pressure
    if supply.kind == "bottle":
        spent = supplied * gas.specific_energy / supply.bottle_volume
        before = supply.bottle_pressure - spent
    hole = Hole(supply.nozzle_diameter, supply.nozzle_length, supply.nozzle_coefficient)
    room = gas.ambient_pressure
    # A step that the integrator tries may have emptied the bottle.
    return mass_flow(gas, hole, larger(room + before, room / 2), room + pressure)


Floats = npt.NDArray[np.float64]


# Compiled, or each of some forty operations would be dispatched by itself.
_stiff_shares = program(stiff_share)


def bending_stiffness(arm: Arm, skin: Skin, pressure: npt.ArrayLike | None = None) -> Floats:
    """Bending stiffness of each link that bears its own weight from one end, N m^2 (`stiff_share`).

    Arguments:
        pressure: of the links, Pa, shape (..., link); `links.pressure` by default.
    """
    links = arm.links
    radius, mass = np.asarray(links.diameter) / 2, np.asarray(links.mass)
    fold = np.pi * radius**3 * np.asarray(links.pressure if pressure is None else pressure)
    own = mass * STANDARD_GRAVITY * np.asarray(links.length) / 2
    with np.errstate(divide="ignore"):
        load = own / fold
    share: Floats = np.asarray(_stiff_shares(jnp.asarray(load)))
    return float(skin.stiffness) * np.pi * radius**3 * share


class Ports(eqx.Module):
    """The ports between neighbouring bags, from the base on."""

    diameter: Scalar | Float[Array, " port"] = parameter(PORTS.diameter)
    length: Scalar | Float[Array, " port"] = parameter(PORTS.length)
    discharge_coefficient: Scalar = parameter(PORTS.discharge_coefficient)


class Filling(eqx.Module):
    """Bags in a row, fed at the base, each through the port of the one before it (fig. 15).

    Every array may be differentiated and replaced (`giajax.replace`).

    Arguments:
        arm: whose links are the bags; the paper's by default.
        shared: groups of neighbouring links, counted from 1, that are not welded apart and so are
            one bag.

    Raises:
        InputError: a link that the arm does not have, or another number of ports than lie between
            the bags.

    Example:
        >>> import giajax
        >>> giajax.mechanics.inflation.Filling(shared=((1, 2), (3, 4, 5))).bags
        17
    """

    arm: Arm = inline(default_factory=takeichi_20m)
    gas: Gas = eqx.field(default_factory=Gas)
    skin: Skin = eqx.field(default_factory=Skin)
    ports: Ports = eqx.field(default_factory=Ports)
    supply: Supply = eqx.field(default_factory=Supply)
    shared: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())

    def __check_init__(self) -> None:
        _check_shared(self.shared, self.arm.count)
        for name in ("diameter", "length"):
            shape = getattr(self.ports, name).shape
            if shape not in ((), (self.bags - 1,)):
                raise InputError(
                    f"the ports have {shape[0]} values of {name}, but there are {self.bags - 1} "
                    f"between {self.bags} bags: give one number, or one for each port"
                )

    @classmethod
    def from_section(cls, section: FillingSection, arm: Arm) -> Self:
        """The filling that a `[filling]` section states, of an arm.

        Raises:
            InputError: as of the class.
        """
        values = section.values()
        ports: dict[str, Any] = {
            d.path.rpartition(".")[2]: values.pop(d.path) for d in PORTS if d.path in values
        }
        shared = tuple(tuple(links) for links in section.shared or [])
        supply = Supply(kind=section.supply or "flow")
        return replace(cls(arm=arm, ports=Ports(**ports), supply=supply, shared=shared), values)

    def definition(self) -> dict[str, Any]:
        """The `[filling]` section, with every key."""
        values = {path: np.asarray(p.value(self)) for path, p in declared(self).items()}
        stated = FillingSection.keys_of(values)
        groups = {"shared": [list(links) for links in self.shared]} if self.shared else {}
        return {"supply": self.supply.kind, **groups, **stated}

    def flows(self, pressure: PerBag, supplied: Scalar) -> tuple[Scalar, Float[Array, " port"]]:
        """Gas from the supply and through each port towards the tip, kg/s.

        Arguments:
            pressure: in the bags, Pa.
            supplied: by the supply so far, kg.
        """
        absolute = self.gas.ambient_pressure + pressure
        hole = Hole(*jax.tree.leaves(self.ports))
        between = mass_flow(self.gas, hole, absolute[:-1], absolute[1:])
        return inflow(self.gas, self.supply, pressure[0], supplied), between

    @property
    def bag_of_link(self) -> npt.NDArray[np.int64]:
        """The bag of each link, counted from 0."""
        first = np.ones(self.arm.count, dtype=np.int64)
        for links in self.shared:
            first[np.asarray(links[1:]) - 1] = 0
        return np.cumsum(first) - 1

    @property
    def bags(self) -> int:
        """Number of bags."""
        return int(self.bag_of_link[-1]) + 1

    @property
    def volume(self) -> PerBag:
        """Volume of each bag when it is tight and not stretched, m^3."""
        return jnp.zeros(self.bags).at[self.bag_of_link].add(self.arm.links.volume)

    @property
    def full_mass(self) -> PerBag:
        """Gas that fills each bag at the pressure of the room, kg."""
        return self.gas.density * self.volume

    @property
    def borne_mass(self) -> Float[Array, " link"]:
        """What the lift of each link's gas must bear, kg: the link and all that it carries."""
        borne = bodies(self.arm).mass
        if self.arm.buoyancy is not None:
            # Its gas is that which is being filled in.
            borne = borne - self.arm.buoyancy.helium_density * self.arm.links.volume
        return borne

    @property
    def stretch(self) -> PerBag:
        """Pressure over the part of its volume by which each bag stretches, Pa.

        Of links of several diameters in one bag, what stretches all of them by their sum.
        """
        links = self.arm.links
        each = links.volume / stretch_pressure(self.skin, links.diameter)
        return self.volume / jnp.zeros(self.bags).at[self.bag_of_link].add(each)


def _check_shared(shared: tuple[tuple[int, ...], ...], links: int) -> None:
    """Refuse groups that are not of neighbours, or that have a link twice or one beyond the arm."""
    several = [link for group in shared for link in group]
    for group in shared:
        if len(group) < 2 or any(b != a + 1 for a, b in pairwise(group)):
            raise InputError(
                f"the links {list(group)} share a bag, but must be neighbours in ascending order, "
                f"such as [3, 4, 5]: correct the list"
            )
    for link in several:
        if not 1 <= link <= links:
            raise InputError(
                f"link {link} shares a bag, but the arm has only {links} links: correct the number"
            )
        if several.count(link) > 1:
            raise InputError(
                f"link {link} is in two lists of shared bags, but can belong to only one bag: put "
                f"all links of this bag into one list"
            )
