"""Where the gas comes from: a flow meter, a regulator or a bottle."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Scalar
from ..parameters import parameter
from ..quantities import SUPPLY
from ._gas import Gas
from ._orifice import Hole, mass_flow


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
        gas: the gas.
        supply: what feeds.
        pressure: of the first bag above that of the room, Pa.
        supplied: what the supply has fed, kg.
    """
    return _FEEDS[supply.kind](gas, supply, pressure, supplied)


def _metered(gas: Gas, supply: Supply, pressure: Scalar, supplied: Scalar) -> Scalar:
    return supply.flow * gas.density


def _regulated(gas: Gas, supply: Supply, pressure: Scalar, supplied: Scalar) -> Scalar:
    return _through_nozzle(gas, supply, supply.pressure, pressure)


def _from_bottle(gas: Gas, supply: Supply, pressure: Scalar, supplied: Scalar) -> Scalar:
    left = supply.bottle_pressure - supplied * gas.specific_energy / supply.bottle_volume
    return _through_nozzle(gas, supply, left, pressure)


def _through_nozzle(gas: Gas, supply: Supply, before: Scalar, after: Scalar) -> Scalar:
    hole = Hole(supply.nozzle_diameter, supply.nozzle_length, supply.nozzle_coefficient)
    room = gas.ambient_pressure
    # A step that the integrator tries may have emptied the bottle.
    return mass_flow(gas, hole, jnp.maximum(room + before, room / 2), room + after)


_FEEDS: dict[str, Callable[[Gas, Supply, Scalar, Scalar], Scalar]] = {
    "flow": _metered,
    "regulator": _regulated,
    "bottle": _from_bottle,
}
