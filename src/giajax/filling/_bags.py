"""Bags: which links share one, and the pressure of what is in it."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..parameters import parameter
from ..quantities import SKIN
from ._gas import Gas

PerBag = Float[Array, " bag"]


class Skin(eqx.Module):
    """The skin of the bags: a thin elastic tube with closed ends."""

    stiffness: Scalar = parameter(SKIN.stiffness)
    poisson_ratio: Scalar = parameter(SKIN.poisson_ratio)
    slack: Scalar = parameter(SKIN.slack)


class BagState(NamedTuple):
    """What a bag's share of gas makes of it.

    Attributes:
        pressure: above that of the room, Pa.
        fullness: its volume over that of the tight bag without pressure; more where it stretches.
    """

    pressure: PerBag
    fullness: PerBag


def stretch_pressure(skin: Skin, diameter: Float[Array, "*tube"]) -> Float[Array, "*tube"]:
    """Pressure over the part of its volume by which it stretches a tube, Pa.

    Of a thin-walled tube with closed ends, hoop strain p r / (E t) (1 - nu / 2) twice, and
    p r / (E t) (1/2 - nu) along it: E t / (r (5/2 - 2 nu)).
    """
    return skin.stiffness / (diameter / 2 * (2.5 - 2 * skin.poisson_ratio))


def bag_state(gas: Gas, skin: Skin, stretch: PerBag, share: PerBag) -> BagState:
    """Pressure and volume of bags with this share of the gas that just fills them.

    Gas takes room until the bag is tight, and is then pressed together and stretches the skin:

        (1 + p / p_room) (1 + p / p_stretch) = 1 + s,  s = w softplus((share - 1) / w).

    The softplus is the last wrinkles: a bag is limp to within exp(-n) where n w of its gas is
    missing, has w log 2 at a share of 1, and s is share - 1 beyond.

    Arguments:
        gas: the gas.
        skin: of the bags.
        stretch: `stretch_pressure` of each, Pa.
        share: mass of gas over that which fills the bag at the pressure of the room.
    """
    beyond = skin.slack * jax.nn.softplus((share - 1) / skin.slack)
    room = gas.ambient_pressure
    sum_of_inverses = 1 / room + 1 / stretch
    root = jnp.sqrt(sum_of_inverses**2 + 4 * beyond / (room * stretch))
    pressure = 2 * beyond / (sum_of_inverses + root)
    return BagState(pressure, share / (1 + pressure / room))
