"""What hangs on the links and what lifts them: helium, trim weights and point masses."""

import equinox as eqx

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import parameter
from ..quantities import BUOYANCY, POINT_MASSES

PerLink = Float[Array, ""] | Float[Array, " link"]
PerBody = Float[Array, ""] | Float[Array, " body"]


class Buoyancy(eqx.Module):
    """Archimedes: displaced air lifts each link at its centre; helium and trim move with it.

    With trim weights that balance the rest (`trimmed`), each link floats, and moves with a total
    mass equal to that of the air it displaces, whatever its structure weighs. The helium moves
    with the link, but does not spin with it about the link's own axis.
    """

    helium_density: Scalar = parameter(BUOYANCY.helium_density)
    trim_mass: PerLink = parameter(BUOYANCY.trim_mass)
    trim_position: PerLink = parameter(BUOYANCY.trim_position)
    trim_depth: PerLink | None = parameter(BUOYANCY.trim_depth)
    imbalance: PerLink | None = parameter(BUOYANCY.imbalance)


class PointMasses(eqx.Module):
    """Small bodies fixed to links: a camera at the tip, cables, tubes, the ball of a pendulum.

    Arguments:
        links: the link that carries each of them, counted from 1.
        mass: of each, kg.
        position: of each from its link's joint along the link, m.
        left, up: of each from the link's axis, in the straight arm, m; None: on the axis.
        drag_area: C_D A of each, m^2; None: no body has a drag of its own.
    """

    links: tuple[int, ...] = eqx.field(static=True)
    mass: PerBody = parameter(POINT_MASSES.mass)
    position: PerBody = parameter(POINT_MASSES.position)
    left: PerBody | None = parameter(POINT_MASSES.left)
    up: PerBody | None = parameter(POINT_MASSES.up)
    drag_area: PerBody | None = parameter(POINT_MASSES.drag_area)

    def __check_init__(self) -> None:
        if not self.links or min(self.links) < 1:
            raise InputError("a point mass has no link, or one below 1: number its link from 1")
        for name in ("mass", "position", "left", "up", "drag_area"):
            value = getattr(self, name)
            if value is not None and value.shape not in ((), (len(self.links),)):
                raise InputError(
                    f"the point masses have {len(self.links)} links and a {name} of shape "
                    f"{value.shape}: give one number, or one each"
                )
