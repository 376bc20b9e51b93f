"""Ready-made arms."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ..quantities import AIR, BUOYANCY, LINKS, POINT_MASSES
from ._arm import Arm
from ._build import chain
from ._masses import PointMasses

STANDARD_GRAVITY = 9.80665


def takeichi_20m(links: int = 20, **changes: Any) -> Arm:
    """The 20 m, 20-link helium-balloon arm of Takeichi, Suzumori, Endo and Nabae.

    Alternating pitch and yaw joints, links of 0.99 m, 0.30 m and 0.047 kg (table 2), drag by
    eq. (1), no gravity because trim weights balance the buoyancy. Stiffnesses, damping and C_D
    are assumed: the paper gives none, and finding them is a fit's job.

    Arguments:
        links: number of links; the paper's arm has 20.
        changes: arguments of `chain`.

    Returns:
        The arm.

    Example:
        >>> import giajax
        >>> giajax.takeichi_20m().count
        20
    """
    return chain(links, **changes)


def takeichi_20m_full(links: int = 20, **changes: Any) -> Arm:
    """The same arm with the air that the paper leaves out.

    Cross-flow drag along the links with C_D by Reynolds number, added mass, gravity and
    buoyancy, trim weights that make each link float level and hang 0.15 m below its axis, and
    the camera of 3 g at the tip.

    Arguments:
        links: number of links.
        changes: arguments of `chain`.

    Returns:
        The arm.
    """
    extras = {AIR.added_mass_coefficient.path: AIR.added_mass_coefficient.default}
    if changes.get("drag", "strip") == "strip":
        extras[AIR.axial_coefficient.path] = AIR.axial_coefficient.default
    floats = changes.get("buoyancy", True)
    if floats:
        extras[BUOYANCY.trim_depth.path] = BUOYANCY.trim_depth.default
    length = changes.get("length")
    tip = LINKS.length.default if length is None else float(np.ravel(length)[-1])
    mass = POINT_MASSES.mass.default
    camera = PointMasses((links,), mass=jnp.full(1, mass), position=jnp.full(1, tip))
    defaults = {
        "gravity": STANDARD_GRAVITY,
        "drag": "strip",
        "drag_curve": "cylinder",
        "buoyancy": floats,
        "trim": floats,
        "point_masses": camera,
    }
    parameters = {**extras, **(changes.pop("parameters", None) or {})}
    return chain(links, **{**defaults, **changes}, parameters=parameters)


def pendulum(links: int = 1, **changes: Any) -> Arm:
    """A pendulum of thin rods that hang down, in a plane, without springs, damping and air.

    Rods of 1 m, 2 cm and 1 kg; all joints have the same axis, and all angles are 0 where the
    pendulum hangs at rest. Free the damping, or give what is known of it.

    Arguments:
        links: number of links.
        changes: arguments of `chain`.

    Returns:
        The pendulum.

    Example:
        >>> import giajax
        >>> double = giajax.pendulum(2, length=[0.3, 0.2], parameters={"joints.damping": 1e-3})
    """
    absent = ("joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping")
    none = dict.fromkeys((*absent, "air.drag_coefficient"), 0.0)
    defaults = {
        "length": 1.0,
        "diameter": 0.02,
        "mass": 1.0,
        "joint_axes": ["pitch"] * links,
        "gravity": STANDARD_GRAVITY,
        "base_rotation": (0.0, np.pi / 2, 0.0),
    }
    parameters = {**none, **(changes.pop("parameters", None) or {})}
    return chain(links, **{**defaults, **changes}, parameters=parameters)


PRESETS: dict[str, Callable[..., Arm]] = {
    "takeichi_20m": takeichi_20m,
    "takeichi_20m_full": takeichi_20m_full,
    "pendulum": pendulum,
}
"""Presets by name; each takes the number of links and the arguments of `chain`."""


def preset(name: str, links: int | None = None, **changes: Any) -> Arm:
    """The preset of a name, changed by arguments of `chain`.

    Arguments:
        name: a key of `PRESETS`.
        links: number of links; by default that of the preset.
        changes: arguments of `chain`.

    Returns:
        The arm.

    Raises:
        InputError: there is no such preset.
    """
    if name not in PRESETS:
        raise InputError(f"there is no arm preset '{name}': use one of {', '.join(PRESETS)}")
    return PRESETS[name](**changes) if links is None else PRESETS[name](links, **changes)
