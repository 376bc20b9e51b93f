"""Trim: the weights that make each link float."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float
from ..parameters import is_concrete
from ._bodies import bodies
from ._chain import Arm


def net_lift(arm: Arm) -> Float[Array, " link"]:
    """Mass that each link could still carry: displaced air less all that moves with it, kg.

    Arguments:
        arm: an arm with buoyancy.

    Raises:
        InputError: the arm leaves buoyancy out.
    """
    if arm.buoyancy is None:
        raise InputError("this arm leaves buoyancy out; build it with buoyancy=True")
    return arm.air.density * arm.links.volume - bodies(arm).mass


def trimmed(arm: Arm) -> Arm:
    """The arm with the trim weights that make each link float.

    Arguments:
        arm: an arm with buoyancy; its trim weights are replaced.

    Raises:
        InputError: it leaves buoyancy out, or a link is too heavy to float.
    """
    if arm.buoyancy is None:
        raise InputError("this arm leaves buoyancy out; build it with buoyancy=True")
    bare = dataclasses.replace(arm.buoyancy, trim_mass=jnp.zeros_like(arm.links.mass))
    weights = net_lift(dataclasses.replace(arm, buoyancy=bare))
    if is_concrete(weights) and np.any(np.asarray(weights) < 0):
        link = int(np.argmin(np.asarray(weights))) + 1
        raise InputError(
            f"link {link} is {-float(weights[link - 1]):.3g} kg too heavy to float, so no trim "
            "weight balances it; make it lighter or larger"
        )
    return dataclasses.replace(arm, buoyancy=dataclasses.replace(bare, trim_mass=weights))
