"""The air around an arm: its properties, and which of its effects count."""

from collections.abc import Sequence

import equinox as eqx

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import parameter
from ..quantities import AIR

DRAGS = ("centre", "strip")
"""Where drag acts: at each link's centre (eq. 1), or along the link."""

DRAG_CURVES = ("constant", "cylinder")
"""How C_D depends on the Reynolds number."""

ADDED_MASSES = ("kirchhoff", "inertia")
"""What added mass does beside resisting accelerations."""


class Air(eqx.Module):
    """The air: by default as the paper's eq. (1) sees it, and on request all of it.

    - `drag = "centre"`: eq. (1), with the full velocity of each link's centre.
    - `drag = "strip"`: cross-flow drag, from the velocity normal to the link alone, integrated
      along the link by `strip_points` Gauss points; `axial_coefficient` adds what acts along it.
    - `drag_curve = "constant"`: C_D is `drag_coefficient`. "cylinder": it follows the Reynolds
      number as that of a smooth circular cylinder does, scaled so that `drag_coefficient` is its
      value at Re = 1e5.
    - `added_mass_coefficient`: the air that a link must move out of its way.
    - `added_mass = "kirchhoff"`: with the terms that follow from its energy, which are products of
      velocities. "inertia": without them, as in engines that add it to their mass matrix alone;
      energy is not conserved then. It is here to compare with those.
    - `wind`: a constant wind, beside that of the run.
    """

    density: Scalar = parameter(AIR.density)
    drag_coefficient: Scalar = parameter(AIR.drag_coefficient)
    axial_coefficient: Scalar | None = parameter(AIR.axial_coefficient)
    added_mass_coefficient: Scalar | None = parameter(AIR.added_mass_coefficient)
    wind: Float[Array, "3"] | None = parameter(AIR.wind)
    viscosity: Scalar = parameter(AIR.viscosity)
    drag: str = eqx.field(static=True, default="centre")
    strip_points: int = eqx.field(static=True, default=3)
    drag_curve: str = eqx.field(static=True, default="constant")
    added_mass: str = eqx.field(static=True, default="kirchhoff")

    def __check_init__(self) -> None:
        _check_choice("drag", self.drag, DRAGS)
        _check_choice("drag_curve", self.drag_curve, DRAG_CURVES)
        _check_choice("added_mass", self.added_mass, ADDED_MASSES)
        if self.strip_points < 1:
            raise InputError(f"strip_points is {self.strip_points}: give at least 1")
        if self.axial_coefficient is not None and self.drag == "centre":
            raise InputError(
                "drag = 'centre' has the full velocity already and no axial coefficient: "
                "use drag = 'strip', or leave air.axial_coefficient out"
            )


def _check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Refuse a value that is not among the choices.

    Raises:
        InputError: naming the choices.
    """
    if value not in choices:
        raise InputError(f"{name} is {value!r}: use one of {', '.join(choices)}")
