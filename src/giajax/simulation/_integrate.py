"""The compiled core of a simulation: diffrax on the equation of motion."""

from operator import attrgetter
from typing import Any, Literal, TypeVar, get_args

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp

from ..mechanics.arm import Arm
from ..runtime.arrays import Array, Float, Scalar
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema import ALPHA, BETA, BRAIDED, DRIVE, GEOMETRY, LOAD
from ._controller import step_size_controller
from ._linearly_implicit import LinearlyImplicit, solver as solver_named
from ._motion import Inputs, Rates, fastest_rate, motion
from ._pressures import Pressures
from ._return_mapping import with_return_mapping
from ._signal import Signal
from ._trajectory import RESULTS, Trajectory

# What disturbs an arm, and the steps that derivatives by a disturbance need.
#
# A step-size controller sees the errors of the motion, not those of its derivatives. An arm at
# rest has no error at all, and one that moves in a plane has none across it: the steps then grow
# until they are unstable for what a derivative sets swinging there, by a wind across or a first
# angle. Derivatives by the other parameters of links, joints and air are safe, because those
# parameters move only what moves already.
#
# Which steps are taken is the caller's choice, not a consequence of being differentiated, so that
# a simulation has the same value with and without its derivatives.

StepsFor = Literal["motion", "derivatives"]
"""What the steps of a simulation are short enough for."""

# Of an arm, beside the inputs and the initial state of every simulation.
_PARAMETERS = ("base_rotation", "gravity", "air.wind", "buoyancy", "point_masses", "pneumatics")

# Of the muscles, whose parameters have no common name: where pressures hold a joint, each of them
# moves it.
_GROUPS = (GEOMETRY, LOAD, ALPHA, BETA, BRAIDED, DRIVE)
_MUSCLES = {quantity.path.partition(".")[0] for group in _GROUPS for quantity in group}

_REFUSAL = (
    "a simulation with steps_for='motion' was differentiated by a disturbance (command, wind, "
    f"torque, initial state, {', '.join(_PARAMETERS)}), for which its steps may be too long: "
    "call simulate with steps_for='derivatives', or the model's for_derivatives"
)


def is_disturbance(path: str) -> bool:
    """Whether a parameter of an arm may set moving what is at rest, or an element: `air.wind[0]`.

    Only with `steps_for="derivatives"` may a motion be differentiated by such a disturbance.
    """
    name = path.partition("[")[0]
    return any(name == known or name.startswith(f"{known}.") for known in (*_PARAMETERS, *_MUSCLES))


def check_steps_for(steps_for: str) -> None:
    """Refuse (`InputError`) a choice of steps that is neither "motion" nor "derivatives"."""
    if steps_for not in get_args(StepsFor):
        raise InputError(
            f"steps_for={steps_for!r} is unknown: use 'motion', or 'derivatives' to differentiate "
            "by the wind, the initial state and whatever else may move what is at rest"
        )


def refuse_disturbances(steps_for: str, arm: Arm, inputs: Any) -> Scalar:
    """Zero; raises `TypeError` where steps for the motion would meet a disturbance's tangent.

    The zero must be added to something that the simulation needs, or nothing keeps it. The error is
    raised while the program is traced, in forward or in reverse mode.
    """
    if steps_for != "motion":
        return jnp.zeros(())
    disturbances = (inputs, *(attrgetter(path)(arm) for path in _PARAMETERS))
    return jax.lax.stop_gradient(_undisturbed(disturbances))


@eqx.filter_custom_jvp
def _undisturbed(disturbances: Any) -> Array:
    return jnp.zeros(())


@_undisturbed.def_jvp
def _undisturbed_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    # Tangents that are known to be zero are None here.
    if jax.tree.leaves(tangents):
        raise TypeError(_REFUSAL)
    return jnp.zeros(()), jnp.zeros(())


T = TypeVar("T")

Derivatives = Literal["forward", "reverse"]


def adjoint(derivatives: str) -> diffrax.AbstractAdjoint:
    """The diffrax adjoint that offers a mode of differentiation; `InputError` for another one."""
    if derivatives == "forward":
        return diffrax.ForwardMode()
    if derivatives == "reverse":
        return diffrax.RecursiveCheckpointAdjoint()
    raise InputError(
        f"derivatives={derivatives!r} is unknown: use 'forward' (few parameters: jax.jvp, "
        "jax.jacfwd) or 'reverse' (many parameters: jax.grad, jax.vjp)"
    )


def guard_outputs(tree: T, derivatives: str) -> T:
    """Outputs of a simulation; a cotangent that enters one in forward mode raises a sentence."""
    if derivatives != "forward":
        return tree
    return eqxi.nondifferentiable_backward(
        tree,
        msg="simulate(derivatives='forward') was differentiated in reverse mode (jax.grad, "
        "jax.vjp): call it with derivatives='reverse', or use jax.jvp or jax.jacfwd",
    )


def guard_inputs(tree: T, derivatives: str) -> T:
    """Inputs of a simulation; a tangent that enters one in reverse mode raises a sentence."""
    if derivatives != "reverse":
        return tree
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
    try:
        arrays = _reverse_only(arrays)
    except TypeError:
        raise TypeError(
            "simulate(derivatives='reverse') was differentiated in forward mode (jax.jvp, "
            "jax.jacfwd): call it with derivatives='forward', or use jax.grad or jax.vjp"
        ) from None
    return eqx.combine(arrays, rest)


@jax.custom_vjp
def _reverse_only(tree: Any) -> Any:
    return tree


# JAX refuses to push a tangent through a function with a custom vjp: that is the guard.
_reverse_only.defvjp(lambda tree: (tree, None), lambda _, cotangent: (cotangent,))


@program
def integrate(
    arm: Arm,
    command: Signal,
    times: Float[Array, " sample"],
    wind: Signal | None,
    torque: Signal | None,
    state: Float[Array, "2 joint"],
    tolerances: tuple[Scalar, Scalar],
    *,
    solver: str,
    max_steps: int,
    derivatives: str,
    steps_for: str,
    span: tuple[Scalar, Scalar] | None = None,
    pressure: Pressures | None = None,
) -> Trajectory:
    """The compiled core of `simulate`: no checks, and a failure is a result code.

    Arguments:
        arm, command, times, wind, torque, pressure: as of `simulate`.
        state: angles (rad) and rates (rad/s) at the beginning, where nothing strains the joints'
            hysteresis.
        tolerances: relative and absolute tolerance of a step.
        solver, max_steps, derivatives, steps_for: as of `simulate`.
        span: from when to when to integrate, s; by default from the first to the last time.

    Raises:
        TypeError: differentiated by a disturbance with `steps_for="motion"`.
    """
    begin, end = (times[0], times[-1]) if span is None else span
    supplied = None if pressure is None else pressure.signal
    inputs = [signal for signal in (command, wind, torque, supplied) if signal is not None]
    rtol, atol = tolerances
    knots = [signal.corners(rtol) for signal in inputs]
    if wind is not None and arm.air.added_mass_coefficient is not None:
        # Added mass feels the rate of the wind, which jumps at each of its knots.
        knots[1] = (wind.times, jnp.full_like(wind.times, jnp.inf))
    # Where steps end is no part of what is differentiated, and a command may be, by when it turns.
    corners, bends = jax.lax.stop_gradient(tuple(map(jnp.concatenate, zip(*knots, strict=True))))
    if derivatives == "forward":
        rtol = rtol + refuse_disturbances(steps_for, arm, (inputs, state))
    method = solver_named(solver, reverse=derivatives == "reverse")
    hysteresis = arm.joints.hysteresis
    fastest = None
    if steps_for == "derivatives":
        rate = fastest_rate(arm, state[0])
        implicit = isinstance(method, LinearlyImplicit)
        fastest = Rates(rate, fastest_rate(arm, state[0], springs=False) if implicit else rate)
    moved = Inputs(arm, command, wind, torque, eqxi.prevbefore(end), pressure)
    slides = hysteresis.stops.rows > 0 or (arm.contact is not None and arm.contact.rows > 0)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(motion),
        with_return_mapping(method, rtol, atol, derivatives) if slides else method,
        t0=begin,
        t1=end,
        dt0=None,
        y0=moved.start(state, begin),
        args=moved,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=step_size_controller(
            method, rtol, atol, corners, bends, fastest, turns=hysteresis.rows > 0
        ),
        adjoint=adjoint(derivatives),
        max_steps=max_steps,
        throw=False,
    )
    assert solution.ys is not None
    angles, rates, memory, muscles, skin = jax.vmap(moved.parts)(solution.ys)
    counts = (solution.stats[f"num_{which}_steps"] for which in ("accepted", "rejected"))
    steps = jnp.stack([jnp.asarray(count) for count in counts])
    return Trajectory(
        times=times,
        angles=angles,
        rates=rates,
        # Within a step sliding elements have not caught up yet.
        memory=jax.vmap(hysteresis.return_mapped)(angles, memory) if hysteresis.rows else None,
        pressures=None if arm.pneumatics is None else jax.vmap(moved.inside)(times, muscles),
        skin=skin if skin.size else None,
        arm=arm,
        command=command,
        wind=wind,
        result=_result(solution.result, jnp.all(jnp.isfinite(solution.ys))),
        steps=steps,
    )


def _result(ended: diffrax.RESULTS, finite: Array) -> Any:
    where: Any = RESULTS.where
    code = where(finite, RESULTS.successful, RESULTS.not_finite)
    code = where(ended == diffrax.RESULTS.successful, code, RESULTS.not_finite)
    code = where(ended == diffrax.RESULTS.dt_min_reached, RESULTS.step_too_small, code)
    return where(ended == diffrax.RESULTS.max_steps_reached, RESULTS.max_steps_reached, code)
