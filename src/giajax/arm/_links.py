"""The rigid links of an arm: sizes, masses and moments of inertia."""

import equinox as eqx
import numpy as np

from .._errors import InputError
from .._typing import Array, Float
from ..parameters import parameter
from ..quantities import LINKS


class Links(eqx.Module):
    """The rigid links, one element of each array per link."""

    length: Float[Array, " link"] = parameter(LINKS.length)
    diameter: Float[Array, " link"] = parameter(LINKS.diameter)
    mass: Float[Array, " link"] = parameter(LINKS.mass)
    centre_of_mass: Float[Array, " link"] = parameter(LINKS.centre_of_mass)
    inertia_transverse: Float[Array, " link"] = parameter(LINKS.inertia_transverse)
    inertia_axial: Float[Array, " link"] = parameter(LINKS.inertia_axial)
    fullness: Float[Array, " link"] = parameter(LINKS.fullness)

    def __check_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in self.__dataclass_fields__}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise InputError(
                f"the arrays of Links have shapes {sorted(shapes)}: "
                "give each the shape (number of links,)"
            )

    @property
    def count(self) -> int:
        """Number of links."""
        return self.length.shape[0]

    @property
    def volume(self) -> Float[Array, " link"]:
        """Air that each link displaces, m^3."""
        return np.pi / 4 * self.diameter**2 * self.length * self.fullness
