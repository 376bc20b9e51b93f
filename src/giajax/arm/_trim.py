"""Trim: the weights that make each link float."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float
from ..parameters import is_concrete
from ._arm import Arm
from ._bodies import bodies
from ._masses import Buoyancy


def net_lift(arm: Arm) -> Float[Array, " link"]:
    """Mass that each link could still carry: displaced air less all that moves with it, kg.

    Arguments:
        arm: an arm with buoyancy.

    Returns:
        Mass, kg, shape (link,); negative where a link is too heavy to float.

    Raises:
        InputError: the arm leaves buoyancy out.
    """
    if arm.buoyancy is None:
        raise InputError("this arm leaves buoyancy out: build it with buoyancy=True")
    return arm.air.density * arm.links.volume - bodies(arm).mass


def trimmed(arm: Arm, *, level: bool = False) -> Arm:
    """The arm with the trim weights that make each link float.

    Arguments:
        arm: an arm with buoyancy; its trim weights are replaced.
        level: also hang them where each link floats level: its centre of mass is then at the
            same distance along the link as its lift. Otherwise they hang where they are.

    Returns:
        The arm with other trim weights and, if it shall float level, other trim positions.

    Raises:
        InputError: it leaves buoyancy out, a link is too heavy to float, or its weight would
            hang beyond its ends.
    """
    if arm.buoyancy is None:
        raise InputError("this arm leaves buoyancy out: build it with buoyancy=True")
    bare = dataclasses.replace(arm.buoyancy, trim_mass=jnp.zeros_like(arm.links.mass))
    weights = net_lift(dataclasses.replace(arm, buoyancy=bare))
    if is_concrete(weights) and np.any(np.asarray(weights) < 0):
        link = int(np.argmin(np.asarray(weights))) + 1
        raise InputError(
            f"link {link} is {-float(weights[link - 1]):.3g} kg too heavy to float, so no trim "
            "weight balances it: make it lighter or larger"
        )
    held = dataclasses.replace(bare, trim_mass=weights)
    if level:
        held = dataclasses.replace(held, trim_position=_level(arm, bare, weights))
    return dataclasses.replace(arm, buoyancy=held)


def _level(arm: Arm, bare: Buoyancy, weights: Float[Array, " link"]) -> Float[Array, " link"]:
    """Where the weights hang, so that mass and displaced air balance about every point."""
    length = arm.links.length
    other = bodies(dataclasses.replace(arm, buoyancy=bare))
    moment = other.mass * (length / 2 - other.along)
    # Without a weight there is no place for it, and no moment that it could balance.
    place = length / 2 + moment / jnp.where(weights > 0, weights, jnp.inf)
    if is_concrete(place) and np.any(np.asarray((place < 0) | (place > length))):
        link = int(np.argmax(np.asarray(abs(place - length / 2) - length / 2))) + 1
        raise InputError(
            f"link {link} floats level only with its trim weight {float(place[link - 1]):.3g} m "
            f"along a link of {float(length[link - 1]):.3g} m: give buoyancy.trim_position"
        )
    return place
