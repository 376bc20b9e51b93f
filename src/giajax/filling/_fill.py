"""Filling an arm, and what comes of it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._typing import Array, Scalar
from ..arm import STANDARD_GRAVITY
from ..parameters import check_within_bounds, declared
from ..quantities import GAS, PORTS, SKIN, SUPPLY
from ._filling import Filling
from ._integrate import Course, bags_at, course, net_lift_of_links
from ._stiffness import stiff_share
from ._supply import inflow

Numbers = npt.NDArray[np.float64]

LIMIT = 6 * 3600.0
"""When `fill` gives up, s."""

_TIMES = 401
_TOLERANCE = 1e-8


@dataclasses.dataclass(frozen=True)
class Filled:
    """An arm that was filled, over time.

    Links of one bag have the same fullness, pressure and times.

    Attributes:
        filling: what was filled.
        times: s, from 0 until all is full, shape (time,).
        fullness: volume of each link over that of its tube, shape (time, link).
        pressure: of each link above that of the room, Pa, shape (time, link).
        gas: mass in each link, kg, shape (time, link).
        supplied: mass that the supply has fed, kg, shape (time,).
        flow: of the supply, as volume at the pressure of the room, m^3/s, shape (time,).
        net_lift: what each link could carry beside itself, kg, shape (time, link).
        folding_moment: p pi r^3 of each link, at which it folds, N m, shape (time, link).
        stiffness: bending stiffness of each link, N m^2, shape (time, link); assumed: that of
            Comer and Levy's tube under the moment of its own weight at its end.
        full: when each link has the gas that fills it, s; NaN where it never has, shape (link,).
        lift_off: when each link's lift bears the link, s; NaN where it never does, shape (link,).
        arm_lift_off: when the lift of all links bears the mass of all, s.
        finished: whether all links were filled within the limit.
    """

    filling: Filling
    times: Numbers
    fullness: Numbers
    pressure: Numbers
    gas: Numbers
    supplied: Numbers
    flow: Numbers
    net_lift: Numbers
    folding_moment: Numbers
    stiffness: Numbers
    full: Numbers
    lift_off: Numbers
    arm_lift_off: float
    finished: bool

    @property
    def duration(self) -> float:
        """How long filling took, s; NaN where it was not finished."""
        return float(np.max(self.full))

    @property
    def imbalance(self) -> float:
        """Largest difference of what was fed and what is in the links, over what fills them."""
        return float(np.max(np.abs(self.supplied - self.gas.sum(axis=1)))) / float(
            np.sum(np.asarray(self.filling.full_mass))
        )


def fill(filling: Filling | None = None, *, limit: float = LIMIT) -> Filled:
    """Fill an arm of balloons with helium, until every link is full (fig. 15).

    Arguments:
        filling: arm, gas, ports and supply; those of the paper by default.
        limit: when to give up, s.

    Returns:
        Fullness, pressure, lift and stiffness of each link over time, and when each is full and
        lifts itself.

    Raises:
        InputError: a number that is out of its bounds, or steps that do not come to an end.

    Example:
        >>> import giajax
        >>> filled = giajax.fill()
        >>> round(filled.duration / 60, 1), round(filled.arm_lift_off / 60, 1)
        (23.2, 14.9)
    """
    made = Filling() if filling is None else filling
    if not 0 < limit < np.inf:
        raise InputError(f"the limit is {limit:g} s: give a positive number of seconds")
    check_filling(made)
    found = _integrated(made, limit)
    here = made.bag_of_link
    links = made.arm.links
    states = _states(made, found)
    pressure, fullness, flow, lift = (np.asarray(each) for each in states)
    radius, mass = np.asarray(links.diameter) / 2, np.asarray(links.mass)
    fold = np.pi * radius**3 * pressure[:, here]
    own = mass * STANDARD_GRAVITY * np.asarray(links.length) / 2
    with np.errstate(divide="ignore"):
        load = own / fold
    without_wrinkles = float(made.skin.stiffness) * np.pi * radius**3
    each_gas = np.asarray(found.share)[:, here] * np.asarray(made.gas.density * links.volume)
    return Filled(
        filling=made,
        times=np.asarray(found.times),
        fullness=fullness[:, here],
        pressure=pressure[:, here],
        gas=each_gas,
        supplied=np.asarray(found.supplied) * float(jnp.sum(made.full_mass)),
        flow=flow,
        net_lift=lift,
        folding_moment=fold,
        stiffness=without_wrinkles * stiff_share(load),
        full=np.asarray(found.full)[here],
        lift_off=np.asarray(found.lifts),
        arm_lift_off=float(found.lifts_all),
        finished=bool(found.finished),
    )


def _integrated(filling: Filling, limit: float) -> Course:
    """The gas over time.

    Raises:
        InputError: the steps did not come to an end.
    """
    found = tried(filling, limit, _TOLERANCE)
    if not bool(found.succeeded):
        raise InputError(
            f"the filling cannot be followed beyond {float(found.times[-1]):.3g} s, after "
            f"{int(found.steps)} steps: give narrower holes, or a larger skin_slack"
        )
    return found


def tried(filling: Filling, limit: float, tolerance: float) -> Course:
    """The gas over time, as far as its steps came."""
    if jnp.result_type(float) == jnp.float32:
        tolerance = max(tolerance, 1e-4)
    numbers = (jnp.asarray(number, jnp.result_type(float)) for number in (limit, tolerance))
    return course(filling, *numbers, times=_TIMES)


def check_filling(filling: Filling) -> None:
    """Refuse numbers that are out of bounds.

    Raises:
        InputError: naming the parameter, its value and its bounds.
    """
    own = {declaration.path for group in (GAS, SKIN, PORTS, SUPPLY) for declaration in group}
    for path, parameter in declared(filling).items():
        if path in own or path.startswith("links.") or path == "air.density":
            for value in np.ravel(np.asarray(parameter.value(filling))).tolist():
                # A bound of 0 is a port without a hole.
                closed = path in own and value <= parameter.declaration.lower
                check_within_bounds(parameter, value, free=closed)


@program
def _states(filling: Filling, found: Course) -> tuple[Array, Array, Array, Array]:
    """Pressure and fullness of bags, flow of the supply and net lift of links, by time."""
    total = jnp.sum(filling.full_mass)

    def at(share: Array, supplied: Scalar) -> tuple[Array, Array, Array, Array]:
        bags = bags_at(filling, share)
        fed = inflow(filling.gas, filling.supply, bags.pressure[0], supplied * total)
        lift = net_lift_of_links(filling, share)
        return bags.pressure, bags.fullness, fed / filling.gas.density, lift

    return jax.vmap(at)(found.share, found.supplied)
