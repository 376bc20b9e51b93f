"""All angles at which two pressures hold a joint, their stability and stiffness.

Where the muscles are straight their levers grow with the angle of the outer one: the pair is then
unstable, and the same two pressures hold the joint on either side of 0. That is the paper's
singularity at 0 deg.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._typing import Array
from ._equilibrium import Equilibria, Equilibrium
from ._geometry import check_geometry
from ._pair import JointPair
from ._path import BRANCHES
from ._search import JUMP, Roots, angles_to_search, search
from ._torque import OneSide, checked_pressures

# A torque below this (N m) at 0 is the rounding of 0, and an angle below this (rad) is 0.
_NO_TORQUE = 1e-12
_NO_ANGLE = 1e-9

# Where each array of a side has what belongs to the angle 0.
_ZERO = -1


def equilibria(
    pair: JointPair, pressures: npt.ArrayLike | Array, load: float | Array = 0.0
) -> Equilibria:
    """All angles within -60 to 60 deg at which two pressures hold a joint.

    The torque is evaluated every 0.1 deg and at its kinks; each interval is divided at the
    extremum of the torque where there is one inside, so that neither of two near roots is missed.

    Arguments:
        pair: the joint and its muscles.
        pressures: of the first and the second muscle, Pa, shape (2,).
        load: torque from outside, towards negative angles, N m.

    Returns:
        The equilibria by angle, and what the torque does at the ends of the range.

    Raises:
        InputError: pressures that are not two numbers of at least 0, or an impossible geometry.

    Example:
        >>> import giajax, numpy as np
        >>> pair = giajax.JointPair()
        >>> command = giajax.pair_command(pair, np.deg2rad(20.0))
        >>> rests = giajax.equilibria(pair, command.pressures)
        >>> [(round(float(np.rad2deg(item.angle)), 1), item.stable) for item in rests.every]
        [(-6.0, True), (-3.3, False), (20.0, True)]
    """
    pressures = checked_pressures(pressures)
    load = jnp.asarray(load, dtype=pressures.dtype)
    if not bool(jnp.isfinite(load)):
        raise InputError("the load is not finite: give a torque in N m")
    check_geometry(pair.joint.geometry)
    sides = {}
    for ahead in (False, True):
        nodes = jnp.asarray(angles_to_search(pair, ahead), dtype=pressures.dtype)
        roots = search(OneSide(pair, pressures, load, jnp.asarray(ahead)), nodes)
        sides[ahead] = jax.device_get(roots)
    resting = [item for ahead, roots in sides.items() for item in _listed(roots, ahead)]
    idle = [bool(roots.idle) for roots in sides.values()]
    resting += [] if any(idle) else _at_zero(sides[False], sides[True])
    return Equilibria(
        every=tuple(sorted(resting, key=lambda item: item.angle)),
        at_lower_stop=bool(sides[False].first < 0),
        at_upper_stop=bool(sides[True].last > 0),
        indifferent=any(idle),
    )


def _listed(roots: Roots, ahead: bool) -> list[Equilibrium]:
    """The roots of one side, without one at 0."""
    rows = [row for row in range(int(roots.count)) if abs(roots.angles[row]) > _NO_ANGLE]
    return [_equilibrium(roots, row, ahead, **_in_jump(roots, row)) for row in rows]


def _in_jump(roots: Roots, row: int) -> dict[str, Any]:
    """What is different at a root in a jump of the torque; nothing elsewhere."""
    below, above = float(roots.below[row]), float(roots.above[row])
    if abs(above - below) <= JUMP:
        return {}
    falls = above < below
    if min(abs(below), abs(above)) <= JUMP:
        return {"stable": falls and bool(roots.slopes[row] < 0)}
    slope = float(roots.slopes[row] + roots.resistance[row])
    stiffness = math.inf if falls else -math.inf
    return {"stiffness": stiffness, "muscle_stiffness": -slope, "stable": falls, "at_step": True}


def _equilibrium(roots: Roots, row: int, ahead: bool, **more: Any) -> Equilibrium:
    stiffness = -float(roots.slopes[row])
    facts: dict[str, Any] = {
        "angle": float(roots.angles[row]),
        "stiffness": stiffness,
        "muscle_stiffness": stiffness - float(roots.resistance[row]),
        "stable": stiffness > 0,
        "branches": (
            _branch(ahead, bool(roots.engaged[0][row])),
            _branch(not ahead, bool(roots.engaged[1][row])),
        ),
    }
    return Equilibrium(**{**facts, **more})


def _branch(inner: bool, engaged: bool) -> str:
    return BRANCHES[(0 if engaged else 1) if inner else (3 if engaged else 2)]


def _at_zero(behind: Roots, ahead: Roots) -> list[Equilibrium]:
    """The equilibrium at 0, if there is one.

    The torque steps there by alpha(0) - beta(0) on either side. It may change its sign in the
    step, or be zero at one of its ends, where only the other side decides what is stable.
    """
    before, after = float(behind.last), float(ahead.first)
    to_zero = {False: after < 0, True: before > 0}  # what the torque beyond 0 does
    if abs(before) <= _NO_TORQUE and abs(after) <= _NO_TORQUE:
        return [_equilibrium(ahead, _ZERO, True)]
    for value, side, is_ahead in ((after, ahead, True), (before, behind, False)):
        if abs(value) <= _NO_TORQUE:
            stable = bool(side.slopes[_ZERO] < 0) and to_zero[is_ahead]
            return [_equilibrium(side, _ZERO, is_ahead, stable=stable)]
    if before * after > 0:
        return []
    stable = before > 0
    stiffness = math.inf if stable else -math.inf
    muscles = -float(ahead.slopes[_ZERO] + ahead.resistance[_ZERO])
    return [
        _equilibrium(
            ahead,
            _ZERO,
            True,
            stiffness=stiffness,
            muscle_stiffness=muscles,
            stable=stable,
            at_step=True,
        )
    ]
