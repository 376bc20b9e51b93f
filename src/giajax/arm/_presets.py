"""Ready-made arms, and the general constructor that they use."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ..parameters import declaration
from ._chain import Air, Arm, Joints, Links, named_axes


def chain(
    links: int = 20,
    *,
    length: Any = None,
    diameter: Any = None,
    mass: Any = None,
    centre_of_mass: Any = None,
    inertia_transverse: Any = None,
    inertia_axial: Any = None,
    joint_axes: str | Sequence[str | Sequence[float]] = "pitch_yaw",
    base_rotation: Any = (0.0, 0.0, 0.0),
    gravity: Any = 0.0,
    air_density: Any = None,
) -> Arm:
    """Build an arm; what is not given is the paper's (`takeichi_20m`).

    Arguments:
        links: number of links.
        length, diameter: of a link, m; a number for all links or one per link.
        mass: of a link, kg; likewise.
        centre_of_mass: from the link's joint along the link, m; half the length by default.
        inertia_transverse, inertia_axial: about the centre of mass, kg m^2; those of a
            thin-walled tube of the link's mass, length and diameter by default.
        joint_axes: "pitch_yaw", or for each joint "pitch", "yaw" or a vector.
        base_rotation: rotation vector of the straight arm, rad, shape (3,).
        gravity: along -z, m/s^2.
        air_density: kg/m^3.

    Returns:
        The arm, with the default stiffnesses, damping and drag coefficient.

    Raises:
        InputError: a list whose length is not the number of links, a number that is not finite
            or, where physics needs it, not positive.
    """
    if links < 1:
        raise InputError(f"an arm of {links} links cannot be built; give at least 1")

    def per_link(name: str, value: Any, fallback: Any = None) -> Any:
        declared = declaration(Links, name)
        if value is None:
            value = declared.default if fallback is None else fallback
        array = np.asarray(value, dtype=float)
        if array.shape not in ((), (1,), (links,)):
            raise InputError(
                f"{name} has {array.size} values for {links} links; give one number or {links}"
            )
        if not np.all(np.isfinite(array)) or not np.all(array > declared.lower):
            raise InputError(
                f"{name} must be finite and greater than {declared.lower:g} {declared.unit}"
            )
        return np.broadcast_to(array, (links,))

    length = per_link("length", length)
    diameter = per_link("diameter", diameter)
    mass = per_link("mass", mass)
    axial = mass * (diameter / 2) ** 2
    return Arm(
        links=Links(
            length=length,
            diameter=diameter,
            mass=mass,
            centre_of_mass=per_link("centre_of_mass", centre_of_mass, length / 2),
            inertia_transverse=per_link(
                "inertia_transverse", inertia_transverse, axial / 2 + mass * length**2 / 12
            ),
            inertia_axial=per_link("inertia_axial", inertia_axial, axial),
        ),
        joints=Joints(axes=named_axes(joint_axes, links)),
        air=Air() if air_density is None else Air(density=air_density),
        base_rotation=jnp.asarray(base_rotation, dtype=float),
        gravity=gravity,
    )


def takeichi_20m(links: int = 20) -> Arm:
    """The 20 m, 20-link helium-balloon arm of Takeichi, Suzumori, Endo and Nabae.

    Alternating pitch and yaw joints, links of 0.99 m, 0.30 m and 0.047 kg (table 2), drag by
    eq. (1), no gravity because trim weights balance the buoyancy. Stiffnesses, damping and C_D
    are assumed: the paper gives none, and finding them is a fit's job.

    Arguments:
        links: number of links; the paper's arm has 20.

    Example:
        >>> import giajax
        >>> giajax.takeichi_20m().count
        20
    """
    return chain(links)


PRESETS = {"takeichi_20m": takeichi_20m}


def preset(name: str, links: int | None = None) -> Arm:
    """The preset of a name.

    Raises:
        InputError: there is no such preset.
    """
    if name not in PRESETS:
        raise InputError(f"there is no arm preset '{name}'; use one of: {', '.join(PRESETS)}")
    return PRESETS[name]() if links is None else PRESETS[name](links)
