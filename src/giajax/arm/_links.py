"""The rigid links of an arm: sizes, masses and moments of inertia."""

import equinox as eqx
import numpy as np

from .._errors import InputError
from .._typing import Array, Float
from ..parameters import parameter


class Links(eqx.Module):
    """The rigid links, one element of each array per link."""

    length: Float[Array, " link"] = parameter(
        0.99, unit="m", lower=0, doc="length of a link, joint to joint"
    )
    diameter: Float[Array, " link"] = parameter(
        0.3, unit="m", lower=0, doc="diameter of a link, as the air sees it"
    )
    mass: Float[Array, " link"] = parameter(
        0.047, unit="kg", lower=0, doc="mass of a link that moves with it"
    )
    centre_of_mass: Float[Array, " link"] = parameter(
        0.495, unit="m", doc="distance of a link's centre of mass from its joint, along the link"
    )
    # A thin-walled tube of mass 0.047 kg, length 0.99 m and diameter 0.3 m.
    inertia_transverse: Float[Array, " link"] = parameter(
        0.004367475,
        unit="kg m^2",
        lower=0,
        assumed=True,
        doc="moment of inertia about a transverse axis through the centre of mass (thin tube)",
    )
    inertia_axial: Float[Array, " link"] = parameter(
        0.0010575,
        unit="kg m^2",
        lower=0,
        assumed=True,
        doc="moment of inertia about the link's own axis (thin tube)",
    )
    fullness: Float[Array, " link"] = parameter(
        1.0,
        unit="",
        lower=0,
        assumed=True,
        doc="displaced volume of a link over that of the cylinder of its length and diameter",
    )

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
