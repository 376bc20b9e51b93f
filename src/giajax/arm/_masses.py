"""What hangs on the links and what lifts them: helium, trim weights and point masses."""

import equinox as eqx

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import parameter

PerLink = Float[Array, ""] | Float[Array, " link"]
PerBody = Float[Array, ""] | Float[Array, " body"]


class Buoyancy(eqx.Module):
    """Archimedes: displaced air lifts each link at its centre; helium and trim move with it.

    With trim weights that balance the rest (`trimmed`), each link floats, and moves with a total
    mass equal to that of the air it displaces, whatever its structure weighs. The helium moves
    with the link, but does not spin with it about the link's own axis.
    """

    helium_density: Scalar = parameter(
        0.1664, unit="kg/m^3", lower=0, doc="density of the helium (20 C, 1 atm)"
    )
    trim_mass: PerLink = parameter(
        0.0,
        unit="kg",
        lower=0,
        each=True,
        doc="trim weight of a link (one number, or one per link)",
    )
    trim_position: PerLink = parameter(
        0.495,
        unit="m",
        each=True,
        assumed=True,
        doc="distance of the trim weight from the link's joint, along the link",
    )
    trim_depth: PerLink | None = parameter(
        0.15,
        unit="m",
        each=True,
        optional=True,
        doc="distance of the trim weight below the link's axis, in the straight arm",
    )
    imbalance: PerLink | None = parameter(
        0.0,
        unit="N",
        each=True,
        optional=True,
        doc="lift that is left over on a link (one number, or one per link); negative: weight",
    )


class PointMasses(eqx.Module):
    """Small bodies fixed to links: a camera at the tip, cables, tubes.

    Arguments:
        links: the link that carries each of them, counted from 1.
        mass: of each, kg.
        position: of each from its link's joint along the link, m.
        left, up: of each from the link's axis, in the straight arm, m; None: on the axis.
    """

    links: tuple[int, ...] = eqx.field(static=True)
    mass: PerBody = parameter(0.003, unit="kg", each=True, lower=0, doc="mass of a point mass")
    position: PerBody = parameter(
        0.99,
        unit="m",
        each=True,
        doc="distance of a point mass from its link's joint, along the link",
    )
    left: PerBody | None = parameter(
        0.0,
        unit="m",
        each=True,
        optional=True,
        doc="distance of a point mass to the left of its link's axis",
    )
    up: PerBody | None = parameter(
        0.0,
        unit="m",
        each=True,
        optional=True,
        doc="distance of a point mass above its link's axis",
    )

    def __check_init__(self) -> None:
        if not self.links or min(self.links) < 1:
            raise InputError("a point mass has no link, or one below 1: number its link from 1")
        for name in ("mass", "position", "left", "up"):
            value = getattr(self, name)
            if value is not None and value.shape not in ((), (len(self.links),)):
                raise InputError(
                    f"the point masses have {len(self.links)} links and a {name} of shape "
                    f"{value.shape}: give one number, or one each"
                )
