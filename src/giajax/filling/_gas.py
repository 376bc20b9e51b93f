"""The gas that an arm is filled with."""

import equinox as eqx

from .._typing import Scalar
from ..parameters import parameter
from ..quantities import GAS


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
