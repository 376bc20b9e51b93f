"""An arm that is filled: gas, bags, ports and supply."""

from itertools import pairwise
from typing import Any, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..arm import Arm, takeichi_20m
from ..kinds import FillingSection
from ..parameters import declared, inline, parameter, replace
from ..quantities import PORTS
from ._bags import PerBag, Skin, stretch_pressure
from ._gas import Gas
from ._supply import Supply


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
        gas: what they are filled with.
        skin: of the bags.
        ports: between them.
        supply: what feeds the first.
        shared: groups of neighbouring links, counted from 1, that are not welded apart and so are
            one bag.

    Raises:
        InputError: a link that the arm does not have, or another number of ports than lie between
            the bags.

    Example:
        >>> import giajax
        >>> giajax.Filling(shared=((1, 2), (3, 4, 5))).bags
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
                    f"between {self.bags} bags: give one number, or one for each"
                )

    @classmethod
    def from_section(cls, section: FillingSection, arm: Arm) -> Self:
        """The filling that a `[filling]` section states, of an arm.

        Raises:
            InputError: as of the class.
        """
        values = section.values()
        ports = {d.path: values.pop(d.path) for d in PORTS if d.path in values}
        shared = tuple(tuple(links) for links in section.shared or [])
        named: dict[str, Any] = {path.rpartition(".")[2]: value for path, value in ports.items()}
        made = cls(
            arm=arm,
            ports=Ports(**named),
            supply=Supply(kind=section.supply or "flow"),
            shared=shared,
        )
        return replace(made, values)

    def definition(self) -> dict[str, Any]:
        """The `[filling]` section, with every key."""
        values = {path: np.asarray(p.value(self)) for path, p in declared(self).items()}
        stated = FillingSection.keys_of(values)
        groups = {"shared": [list(links) for links in self.shared]} if self.shared else {}
        return {"supply": self.supply.kind, **groups, **stated}

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
                f"the links {list(group)} share a bag, but must be neighbours in their order, such "
                "as [3, 4, 5]: correct them"
            )
    for link in several:
        if not 1 <= link <= links:
            raise InputError(
                f"link {link} shares a bag, but the arm has {links} links: correct the number"
            )
        if several.count(link) > 1:
            raise InputError(
                f"link {link} shares a bag twice, but has one: put all links of it into one list"
            )
