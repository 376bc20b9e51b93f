"""Test of a joint law: returned values, derivatives, and conservation of energy."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Float, Scalar, larger, limited, smaller
from ...runtime.process import enable_x64
from ...runtime.programs import NoStructureError, content, program
from ...runtime.text import InputError, tried
from ...schema.parameters import is_concrete
from ._joint_laws import AbstractJointLaw, JointState, States

# Amplitude (rad) and frequency (Hz) of each oscillation.
_MOTIONS = ((1e-3, 1.0), (0.03, 0.3), (0.4, 2.0), (1.5, 0.5), (0.0, 0.0), (0.3, 0.0))
_SAMPLES, _CYCLES = 96, 2.0
_STEP = 1e-7  # step of finite differences, in SI units
_PRESSURE = 1e5  # Pa
_MOST_STEPS = 1000  # integration steps of the states between two samples, at most
_SLOPES, _POWERS = 1e-2, 1e-3  # tolerances

_PASSED: set[tuple[type, int, str]] = set()


def check_joint_law(law: AbstractJointLaw, joints: int = 7) -> None:
    """Test a joint law on joints that oscillate under constant commands, and on joints at rest.

    If the law takes pressures, these are also constant. A traced law is not tested.

    Arguments:
        law: the joint law.
        joints: number of joints.

    Raises:
        InputError: a method raises an exception, returns a wrong shape or number type, has a value
            or derivative that is not finite, has a derivative that does not match finite
            differences, makes a joint depend on another joint, makes the energy depend on the rate,
            or releases more energy than the law has stored (unless `passive` is False). The message
            names the method.
    """
    if not is_concrete(law):
        return
    key: Any = None
    with suppress(NoStructureError):
        # The class itself is a part of the key, because a notebook cell that is run again creates
        # another class with the same name.
        key = type(law), joints, content(law)
    if key in _PASSED:
        return
    with jax.ensure_compile_time_eval(), enable_x64(True):
        law = jax.tree.map(lambda x: x.astype(float) if eqx.is_inexact_array(x) else x, law)
        _check_shapes(law, joints)
        for seed, (size, frequency) in enumerate(_MOTIONS):
            phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, (2, joints))
            numbers = (jnp.asarray(size), jnp.asarray(frequency), jnp.asarray(phases))
            _judge(law, *jax.tree.map(np.asarray, _tried(law, *numbers)))
    if key is not None:
        _PASSED.add(key)


# Length of a path in one direction, rad, and relative tolerance for the result of its two halves.
_WAY, _LEGS = 0.05, 1e-3


def _check_shapes(law: AbstractJointLaw, joints: int) -> None:
    name = type(law).__name__
    if any(each.name == "rows" and not each.metadata.get("static") for each in fields(law)):
        raise InputError(
            f"{name}.rows is a field: make it a constant of the class, or a static field"
        )
    rows: Any = law.rows
    if not isinstance(rows, int) or rows < 0:
        rows = "a method" if callable(rows) else rows
        raise InputError(f"{name}.rows is {rows}: give the number of states of each joint, or 0")
    each, states = jnp.zeros(joints), jnp.zeros((rows, joints))
    supply = jnp.zeros((2, joints))
    at = JointState(each, each, each, states, supply if law.takes_pressures else None)
    methods: dict[str, tuple[tuple[Any, ...], Any]] = {
        "unstrained": ((each,), states),
        "settled": ((at,), states),
        "commanded": ((each,), supply),
        "torque": ((at,), each),
        "energy": ((at,), each),
        "rate": ((at,), states),
        "return_mapped": ((each, states), states),
        "travelled": ((each, each, states), states),
        "slopes": ((at,), (each, each)),
        "state_slopes": ((at,), (states,) * 3),
        "stiffest": ((at,), each),
        "dissipation": ((at,), each),
    }
    for method, (given, like) in methods.items():
        with tried(f"{name}.{method}"):
            found = jax.eval_shape(getattr(law, method), *given)
        shapes = jax.tree.map(lambda x: getattr(x, "shape", None), (found, like))
        if shapes[0] != shapes[1]:
            raise InputError(
                f"{name}.{method} returns the shape {shapes[0]} for {joints} joints: return "
                f"{shapes[1]}"
            )
        kinds = {str(x.dtype) for x in jax.tree.leaves(found)} - {str(each.dtype)}
        if kinds:
            raise InputError(
                f"{name}.{method} returns {kinds.pop()}, but the angles are {each.dtype}: return "
                "numbers of the same type as the angles"
            )


@program
def _tried(
    law: AbstractJointLaw, size: Scalar, frequency: Scalar, phases: Float[Array, "2 joint"]
) -> tuple[JointState, dict[str, Any]]:
    """Return the joint state at each sample of a motion, and the quantities of `_found` there."""
    first, second = phases
    turn = 2 * np.pi * frequency
    span = _CYCLES / jnp.where(frequency > 0, frequency, 1)

    def motion(time: Any, states: States) -> JointState:
        angles = size * (jnp.sin(turn * time + first) + 0.3 * jnp.sin(2 * turn * time + second))
        rates = jnp.cos(turn * time + first) + 0.6 * jnp.cos(2 * turn * time + second)
        pressures = _PRESSURE * size * (1 + jnp.cos(phases)) if law.takes_pressures else None
        command = 0.2 * size * jnp.cos(second)
        return JointState(angles, size * turn * rates, command, states, pressures)

    def one(states: States, times: tuple[Scalar, Scalar]) -> tuple[States, Any]:
        time, end = times
        at = motion(time, states)
        states = _integrated(lambda t, x: law.rate(motion(t, x)), states, time, end)
        return law.return_mapped(motion(end, states).angles, states), (at, _found(law, at))

    start = law.settled(motion(0.0, jnp.zeros((law.rows, first.size))))
    times = span * jnp.linspace(0.0, 1.0, _SAMPLES)
    tried: tuple[JointState, dict[str, Any]]
    _, tried = jax.lax.scan(one, start, (times[:-1], times[1:]))
    return tried


def _integrated(
    rate: Callable[[Any, States], States], states: States, time: Scalar, end: Scalar
) -> States:
    """Return the states at the end of an interval, by Heun's method with adaptive steps.

    The integration ends early after `_MOST_STEPS` steps.
    """
    if not states.size:
        return states

    def going(carry: Any) -> Array:
        count, time, _, _ = carry
        return (count < _MOST_STEPS) & (time < end)

    def one(carry: Any) -> Any:
        count, time, states, step = carry
        step = smaller(step, end - time)
        first = step * rate(time, states)
        error = (step * rate(time + step, states + first) - first) / 2
        size = larger(jnp.max(jnp.abs(states)), jnp.max(jnp.abs(first)))
        wrong = jnp.max(jnp.abs(error)) / (1e-3 * size + 1e-300)
        done = wrong < 1
        states = jnp.where(done, states + first + error, states)
        wider = step * limited(0.9 / jnp.sqrt(wrong + 1e-300), 0.2, 5)
        return count + 1, jnp.where(done, time + step, time), states, wider

    end_of: Array = jax.lax.while_loop(going, one, (0, time, states, (end - time) / 10))[2]
    return end_of


def _size(x: Array) -> Array:
    return larger(jnp.abs(x), 1)


def _values(law: AbstractJointLaw, at: JointState) -> dict[str, Array]:
    driven = {"settled": law.settled(at), "commanded": law.commanded(at.command)}
    return {
        **(driven if law.takes_pressures else {}),
        "torque": law.torque(at),
        "energy": law.energy(at),
        "rate": law.rate(at),
        "return_mapped": law.return_mapped(at.angles, at.states),
        "unstrained": law.unstrained(at.angles),
    }


def _found(law: AbstractJointLaw, at: JointState) -> dict[str, Any]:
    """Compute all quantities that `_judge` checks at one sample.

    These are values, derivatives with finite differences to both sides, the influence of other
    joints, and powers.
    """
    parameters, rest = eqx.partition(law, eqx.is_inexact_array)
    given: dict[str, Any] = {**at._asdict(), "parameters": parameters}
    if at.pressures is None:
        del given["pressures"]
    here = _values(law, at)

    # The step of a large parameter is proportional to the parameter.
    along = {
        name: jax.tree.map(jnp.ones_like if name in at._fields else _size, value)
        for name, value in given.items()
    }
    if "pressures" in along:
        along["pressures"] = along["pressures"] * _PRESSURE

    def of(**moved: Any) -> dict[str, Array]:
        own = given | moved
        whole = eqx.combine(own.pop("parameters"), rest)
        return _values(whole, JointState(**own))

    def aside(steps: Array) -> dict[str, Array]:
        """Return the finite differences for a step in one of the given values.

        `steps` contains the step of each given value; all but one are 0.
        """
        moved = {
            name: jax.tree.map(lambda x, dx, step=step: x + step * dx, value, along[name])
            for (name, value), step in zip(given.items(), steps, strict=True)
        }
        return jax.tree.map(lambda x, x0: (x - x0) / jnp.sum(steps), of(**moved), here)

    ahead = _STEP * jnp.eye(len(given))
    sides = jax.vmap(aside)(jnp.concatenate([ahead, -ahead]))

    def slopes(place: int, name: str) -> tuple[dict[str, Array], ...]:
        slope = jax.jvp(lambda x: of(**{name: x}), (given[name],), (along[name],))[1]
        both = (place, place + len(given))
        return slope, *(jax.tree.map(lambda x, at=at: x[at], sides) for at in both)

    def others(moved: Array) -> dict[str, Array]:
        """Return the largest changes of the values of all other joints if one joint is displaced.

        `moved` is true for the joint that is displaced.
        """
        # The displacements differ, so that differences between two values change as well.
        rows = 0.004 * np.arange(1, law.rows + 1)[:, None]
        lengths = JointState(*map(jnp.asarray, (0.01, 0.013, -0.007, rows)))
        if at.pressures is not None:
            lengths = lengths._replace(pressures=jnp.asarray([[1e3], [1.7e3]]))
        there = _values(law, jax.tree.map(lambda x, dx: jnp.where(moved, x + dx, x), at, lengths))
        return {
            name: jnp.max(jnp.where(moved, 0, jnp.abs(value - here[name])), initial=0)
            for name, value in there.items()
        }

    after = at._replace(angles=at.angles + _STEP * at.rates)
    rate = law.rate(after._replace(states=at.states + _STEP * here["rate"]))
    states = at.states + _STEP / 2 * (here["rate"] + rate)
    passed = {}
    if type(law).travelled is not AbstractJointLaw.travelled:
        passed["travelled"] = law.travelled(at.angles, after.angles, at.states), states
        half, far = at.angles + _WAY / 2, at.angles + _WAY
        legs = law.travelled(half, far, law.travelled(at.angles, half, at.states))
        passed["legs"] = law.travelled(at.angles, far, at.states), legs
    after = after._replace(states=law.return_mapped(after.angles, states))
    return {
        "values": here,
        "slopes": {name: slopes(place, name) for place, name in enumerate(given)},
        "others": jax.vmap(others)(jnp.eye(at.angles.size, dtype=bool)),
        "taken": -(here["torque"] + law.torque(after)) / 2 * at.rates,
        "stored": (law.energy(after) - here["energy"]) / _STEP,
        # At the onset of sliding, rounding determines on which side the state is. Both values are
        # therefore permitted.
        "dissipation": (law.dissipation(at), law.dissipation(after)),
        "falling": law.slopes(at),
        "stiffest": law.stiffest(at),
        **passed,
    }


def _judge(law: AbstractJointLaw, at: JointState, found: dict[str, Any]) -> None:
    name = type(law).__name__

    def refuse(method: str, what: str, wrong: np.ndarray, action: str) -> None:
        if np.any(wrong):
            sample, joint = np.argwhere(wrong)[0][[0, -1]]
            angle, rate = at.angles[sample, joint], at.rates[sample, joint]
            where = f"at {angle:.3g} rad and {rate:.3g} rad/s"
            raise InputError(f"{name}.{method} {what} {where}: {action}")

    def largest(*values: np.ndarray) -> float:
        return sum(float(np.max(np.abs(value), initial=0)) for value in values) + 1e-9

    def between(slope: np.ndarray, slopes: Sequence[np.ndarray], margin: float) -> np.ndarray:
        """Return whether a slope lies between the slopes on both sides, which differ at a kink."""
        low, high = np.fmin(*slopes), np.fmax(*slopes)
        inside: np.ndarray = (low - margin <= slope) & (slope <= high + margin)
        return inside

    for method, value in found["values"].items():
        finite = (
            "correct it (safe_norm of giajax.runtime.arrays is a norm that can be differentiated "
            "at 0)"
        )
        refuse(method, "has a value that is not finite", ~np.isfinite(value), finite)
        apart = "compute each value from angle, rate, command, states and pressures of its joint"
        moves = found["others"][method] > 1e-9 * largest(value)
        refuse(method, "depends on another joint", moves, apart)
        for given, parts in found["slopes"].items():
            slope, *slopes = (part[method] for part in parts)
            what = f"has a derivative with respect to the {given} that"
            refuse(method, f"{what} is not finite", ~np.isfinite(slope), finite)
            wrong = ~between(slope, slopes, _SLOPES * largest(slope, value))
            refuse(
                method,
                f"{what} does not match finite differences",
                wrong,
                "correct its custom derivative rule, or remove it",
            )
    moves = found["slopes"]["rates"][0]["energy"] != 0
    refuse(
        "energy",
        "depends on the rate",
        moves,
        "let the stored energy depend only on angle, command and states",
    )
    if "travelled" in found:
        followed, states = (each - at.states for each in found["travelled"])
        wrong = np.abs(followed - states) > _SLOPES * largest(states)
        what = f"does not match the integral of {name}.rate over a short path"
        refuse("travelled", what, wrong, "correct one of them, or remove it")
        whole, legs = found["legs"]
        wrong = np.abs(whole - legs) > _LEGS * largest(legs)
        refuse("travelled", "does not match the result of two half paths", wrong, "correct it")
    stiffness, stiffest = found["falling"][0], found["stiffest"]
    within = np.abs(at.angles) <= law.largest_angle
    wrong = within & (stiffest < stiffness - 1e-6 * largest(stiffness)) | ~np.isfinite(stiffest)
    what = f"is less than {name}.slopes, or not finite,"
    refuse("stiffest", what, wrong, "correct it, or remove it, so that derivatives are used")
    for given, falling in zip(("angles", "rates"), found["falling"], strict=True):
        slopes = [part["torque"] for part in found["slopes"][given][1:]]
        wrong = ~between(-falling, slopes, _SLOPES * largest(*slopes, found["values"]["torque"]))
        what = f"does not match the negative derivative of the torque with respect to the {given}"
        refuse("slopes", what, wrong, "correct it, or remove it, so that derivatives are used")
    taken, stored = found["taken"], found["stored"]
    lost, size = taken - stored, np.abs(taken) + np.abs(stored)
    margin = _POWERS * size + 1e-6 * largest(size) + 1e-8 * largest(found["values"]["energy"])
    if law.passive:
        what = f"releases more energy than {name}.energy had stored"
        refuse("torque", what, lost < -margin, "correct one of them, or set passive = False")
    if type(law).dissipation is not AbstractJointLaw.dissipation:
        what = "does not match the loss computed from torque and energy"
        wrong = ~between(lost, found["dissipation"], margin)
        refuse("dissipation", what, wrong, "correct it, or remove it, so that derivatives are used")
