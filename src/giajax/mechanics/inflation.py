"""Gas dynamics of an inflatable arm: bags in a row, ports between them, and a gas supply."""

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
    """An ideal gas at room temperature; helium by default."""

    density: Scalar = parameter(GAS.density)
    ambient_pressure: Scalar = parameter(GAS.ambient_pressure)
    viscosity: Scalar = parameter(GAS.viscosity)
    heat_capacity_ratio: Scalar = parameter(GAS.heat_capacity_ratio)

    @property
    def specific_energy(self) -> Scalar:
        """R T of the gas, J/kg, which is its pressure divided by its density."""
        return self.ambient_pressure / self.density


PerBag = Float[Array, " bag"]


class Skin(eqx.Module):
    """The skin of the bags: a thin elastic tube with closed ends."""

    stiffness: Scalar = parameter(SKIN.stiffness)
    poisson_ratio: Scalar = parameter(SKIN.poisson_ratio)
    slack: Scalar = parameter(SKIN.slack)


class BagState(NamedTuple):
    """Pressure and relative volume of bags.

    Attributes:
        pressure: gauge pressure, Pa.
        fullness: volume divided by the volume of the tight bag without pressure; it exceeds 1 if
            the bag stretches.
    """

    pressure: PerBag
    fullness: PerBag


def stretch_pressure(skin: Skin, diameter: Float[Array, "*tube"]) -> Float[Array, "*tube"]:
    """Return the pressure divided by the relative increase in volume that it causes, Pa.

    In a thin-walled tube with closed ends, the hoop strain is p r / (E t) (1 - nu / 2), which
    counts twice, and the axial strain is p r / (E t) (1/2 - nu). The result is
    E t / (r (5/2 - 2 nu)).
    """
    return skin.stiffness / (diameter / 2 * (2.5 - 2 * skin.poisson_ratio))


def bag_state(gas: Gas, skin: Skin, stretch: PerBag, share: PerBag) -> BagState:
    """Return pressure and volume of bags that contain a share of the gas that just fills them.

    The gas unfolds the bag until it is tight. More gas is compressed and stretches the skin:

        (1 + p / p_room) (1 + p / p_stretch) = 1 + s,  s = w softplus((share - 1) / w).

    The softplus models the last wrinkles. If a fraction n w of the gas is missing, s is about
    w exp(-n), so the bag is nearly limp. At a share of 1, s is w log 2. For larger shares, s
    approaches share - 1.

    Arguments:
        stretch: `stretch_pressure` of each bag, Pa.
        share: mass of gas in the bag divided by the mass that fills it at ambient pressure.
    """
    beyond = skin.slack * jax.nn.softplus((share - 1) / skin.slack)
    room = gas.ambient_pressure
    sum_of_inverses = 1 / room + 1 / stretch
    root = jnp.sqrt(sum_of_inverses**2 + 4 * beyond / (room * stretch))
    pressure = 2 * beyond / (sum_of_inverses + root)
    return BagState(pressure, share / (1 + pressure / room))


class BagEnergy(NamedTuple):
    """Energy of bags per volume of the tight bag without pressure, J/m^3.

    Attributes:
        gas: work that the gas can do.
        skin: elastic energy of the skin.
    """

    gas: PerBag
    skin: PerBag


# Ends of the panels of the Gauss quadrature, as (share - 1) / slack. The panels are short where the
# curvature of the pressure is large.
_PANELS = np.array([-36.0, -12.0, -4.0, 4.0, 12.0, 36.0])
_NODES = 16


def bag_energy(gas: Gas, skin: Skin, stretch: PerBag, share: PerBag) -> BagEnergy:
    """Return the work that the gas of bags and their skin can do until ambient pressure is reached.

    For an ideal gas at room temperature, this work is P V log(P / p_room) - p V, where P is the
    absolute pressure and p the gauge pressure. For the skin, it is the work that p has done on it.
    If gas flows into a bag, the sum of both increases by R T log(P / p_room) per kilogram.

    The arguments are those of `bag_state`.
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
    """A round hole.

    Attributes:
        diameter: diameter, m.
        length: length, m.
        coefficient: discharge coefficient.
    """

    diameter: Numbers
    length: Numbers
    coefficient: Scalar


def mass_flow(gas: Gas, hole: Hole, before: Numbers, after: Numbers) -> Numbers:
    """Return the mass flow through a hole, kg/s; negative for a flow from `after` to `before`.

    The hole is an isentropic orifice after Saint-Venant and Wantzel (ISO 6358-1 gives it for air),

        m = C A p0 sqrt(2 k / ((k - 1) R T)) sqrt(g),  g = r^(2/k) - r^((k + 1)/k).

    Here r is the pressure ratio, but at least the critical ratio
    (2 / (k + 1))^(k / (k - 1)) = 0.487 for helium. There the derivative of g is 0, so the flow is
    smooth at the onset of choking. A short tube after Hagen and Poiseuille is in series with the
    orifice: y = sqrt(g) is replaced by the solution of y^2 + a y = g. The flow is then laminar for
    small pressure differences and has a finite derivative at 0. If the pressure difference is small
    compared to the pressure, this means dp = 128 mu L Q / (pi d^4) + rho Q |Q| / (2 C^2 A^2).

    Arguments:
        gas: properties of the gas.
        hole: one hole, or several holes with arrays of dimensions.
        before, after: absolute pressures on both sides, Pa.
    """
    k, rt = gas.heat_capacity_ratio, gas.specific_energy
    upstream = larger(before, after)
    most = 1 - critical_ratio(gas)
    signed = limited((before - after) / upstream, -most, most)
    drop = jnp.abs(signed)
    # The ratio of g to the drop has a finite limit where the drop is 0.
    known = jnp.where(drop == 0, most, drop)
    logarithm = jnp.log1p(-known)
    # `expm1` avoids the cancellation in the difference of two powers that are nearly equal.
    known = jnp.exp(2 / k * logarithm) * -jnp.expm1((k - 1) / k * logarithm) / known
    slope = jnp.where(drop == 0, (k - 1) / k, known)
    area = jnp.pi / 4 * hole.diameter**2
    scale = hole.coefficient * area * upstream * jnp.sqrt(2 * k / ((k - 1) * rt))
    resistance = 128 * gas.viscosity * hole.length / (jnp.pi * hole.diameter**4)
    # For small drops the flow is (before - after) / resistance, times the density.
    laminar = scale * (k - 1) / k * resistance * rt / upstream**2
    return scale * signed * 2 * slope / (laminar + jnp.sqrt(laminar**2 + 4 * slope * drop))


def critical_ratio(gas: Gas) -> Scalar:
    """Return the ratio of downstream to upstream pressure below which the flow is choked."""
    k = gas.heat_capacity_ratio
    return (2 / (k + 1)) ** (k / (k - 1))


class Supply(eqx.Module):
    """The gas supply of the first bag.

    Arguments:
        kind: "flow" (a controller holds the flow constant at any pressure), "regulator" (a
            regulator holds the pressure upstream of a nozzle) or "bottle" (a bottle at room
            temperature empties through a nozzle).
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
"""The parameter that increases the flow from each kind of supply."""


def inflow(gas: Gas, supply: Supply, pressure: Scalar, supplied: Scalar) -> Scalar:
    """Return the mass flow from the supply, kg/s.

    Arguments:
        gas: properties of the gas.
        supply: the supply.
        pressure: gauge pressure of the first bag, Pa.
        supplied: mass of gas that the supply has delivered so far, kg.
    """
    if supply.kind == "flow":
        return supply.flow * gas.density
    before = supply.pressure
    if supply.kind == "bottle":
        spent = supplied * gas.specific_energy / supply.bottle_volume
        before = supply.bottle_pressure - spent
    hole = Hole(supply.nozzle_diameter, supply.nozzle_length, supply.nozzle_coefficient)
    room = gas.ambient_pressure
    # In a trial step of the integrator, the bottle may be empty.
    return mass_flow(gas, hole, larger(room + before, room / 2), room + pressure)


Floats = npt.NDArray[np.float64]


# The function is compiled, because otherwise each of its about forty operations would be dispatched
# separately.
_stiff_shares = program(stiff_share)


def bending_stiffness(arm: Arm, skin: Skin, pressure: npt.ArrayLike | None = None) -> Floats:
    """Return the bending stiffness of each link, N m^2.

    Each link is supported at one end and bears its own weight. `stiff_share` accounts for wrinkles.

    Arguments:
        arm: the arm.
        skin: the skin of the links.
        pressure: gauge pressure of the links, Pa, shape (..., link); `links.pressure` by default.
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
    """The ports between neighbouring bags, in order from the base to the tip."""

    diameter: Scalar | Float[Array, " port"] = parameter(PORTS.diameter)
    length: Scalar | Float[Array, " port"] = parameter(PORTS.length)
    discharge_coefficient: Scalar = parameter(PORTS.discharge_coefficient)


class Filling(eqx.Module):
    """A row of bags supplied with gas at the base; each bag is filled through a port (fig. 15).

    Every array can be differentiated and replaced (`giajax.replace`).

    Arguments:
        arm: the arm whose links are the bags; the arm of the paper by default.
        gas: properties of the gas.
        skin: the skin of the bags.
        ports: the ports between the bags.
        supply: the gas supply of the first bag.
        shared: groups of neighbouring links, numbered from 1, that are not separated by a weld and
            therefore form one bag.

    Raises:
        InputError: the arm does not have one of the links, or the number of ports is not the number
            of pairs of neighbouring bags.

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
                    f"ports between {self.bags} bags: give one number, or one for each port"
                )

    @classmethod
    def from_section(cls, section: FillingSection, arm: Arm) -> Self:
        """Create the filling of an arm from a `[filling]` section.

        Raises:
            InputError: see the class.
        """
        values = section.values()
        ports: dict[str, Any] = {
            d.path.rpartition(".")[2]: values.pop(d.path) for d in PORTS if d.path in values
        }
        shared = tuple(tuple(links) for links in section.shared or [])
        supply = Supply(kind=section.supply or "flow")
        return replace(cls(arm=arm, ports=Ports(**ports), supply=supply, shared=shared), values)

    def definition(self) -> dict[str, Any]:
        """Return the `[filling]` section with every key."""
        values = {path: np.asarray(p.value(self)) for path, p in declared(self).items()}
        stated = FillingSection.keys_of(values)
        groups = {"shared": [list(links) for links in self.shared]} if self.shared else {}
        return {"supply": self.supply.kind, **groups, **stated}

    def flows(self, pressure: PerBag, supplied: Scalar) -> tuple[Scalar, Float[Array, " port"]]:
        """Return the mass flows from the supply and through each port towards the tip, kg/s.

        Arguments:
            pressure: gauge pressure of the bags, Pa.
            supplied: mass of gas that the supply has delivered so far, kg.
        """
        absolute = self.gas.ambient_pressure + pressure
        hole = Hole(*jax.tree.leaves(self.ports))
        between = mass_flow(self.gas, hole, absolute[:-1], absolute[1:])
        return inflow(self.gas, self.supply, pressure[0], supplied), between

    @property
    def bag_of_link(self) -> npt.NDArray[np.int64]:
        """Index of the bag of each link, from 0."""
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
        """Volume of each tight and unstretched bag, m^3."""
        return jnp.zeros(self.bags).at[self.bag_of_link].add(self.arm.links.volume)

    @property
    def full_mass(self) -> PerBag:
        """Mass of gas that fills each bag at ambient pressure, kg."""
        return self.gas.density * self.volume

    @property
    def borne_mass(self) -> Float[Array, " link"]:
        """Mass that the lift of the gas of each link must bear, kg: the link and its payload."""
        borne = bodies(self.arm).mass
        if self.arm.buoyancy is not None:
            # The gas of the links is the gas of the bags, which is counted separately.
            borne = borne - self.arm.buoyancy.helium_density * self.arm.links.volume
        return borne

    @property
    def stretch(self) -> PerBag:
        """Pressure divided by the relative increase in volume that it causes in each bag, Pa.

        If a bag consists of links of several diameters, the volume increase is the sum over the
        links.
        """
        links = self.arm.links
        each = links.volume / stretch_pressure(self.skin, links.diameter)
        return self.volume / jnp.zeros(self.bags).at[self.bag_of_link].add(each)


def _check_shared(shared: tuple[tuple[int, ...], ...], links: int) -> None:
    """Check that groups consist of neighbouring links of the arm, each in at most one group."""
    several = [link for group in shared for link in group]
    for group in shared:
        if len(group) < 2 or any(b != a + 1 for a, b in pairwise(group)):
            raise InputError(
                f"the links {list(group)} share a bag, but must be neighbours in ascending order, "
                "such as [3, 4, 5]: correct the list"
            )
    for link in several:
        if not 1 <= link <= links:
            raise InputError(
                f"link {link} shares a bag, but the arm has only {links} links: correct the number"
            )
        if several.count(link) > 1:
            raise InputError(
                f"link {link} is in two lists of shared bags, but can belong to only one bag: put "
                "all links of this bag into one list"
            )
