"""Simulation of an arm's motion: the checks of `simulate`, and its compiled core on diffrax."""

from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import AbstractWind, Arm, mass_matrix, with_wind
from ..runtime.arrays import Array, Float, Scalar
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema import ALPHA, BETA, BRAIDED, DRIVE, GEOMETRY, LOAD, NECK
from ..schema.parameters import is_concrete
from ._motion import Inputs, Rates, fastest_rate, motion
from ._signal import Pressures, Signal, check_muscles, constant, followed
from ._solvers import Solver, check_method, solver as solver_named
from ._trajectory import RESULTS, SimulationError, Trajectory

if TYPE_CHECKING:
    import diffrax

# Disturbances of an arm, and the steps that derivatives with respect to a disturbance require.
#
# A step-size controller observes the errors of the motion, but not the errors of its derivatives.
# An arm at rest has no error at all, and an arm that moves in a plane has none perpendicular to it.
# The steps then grow until they are unstable for the oscillations of the derivative with respect
# to, for example, a cross wind or an initial angle. Derivatives with respect to the other
# parameters of links, joints and air are safe, because these parameters affect only what moves
# already.
#
# The caller chooses the steps. They do not depend on whether a simulation is differentiated, so its
# value is the same with and without derivatives.

StepsFor = Literal["motion", "derivatives"]
"""Purpose for which the steps of a simulation are short enough."""

# Parameters of an arm that are disturbances, in addition to the inputs and the initial state of
# every simulation. The parameters of a user-defined law are included because their effect is
# unknown.
_PARAMETERS = ("base_rotation", "gravity", "air.wind", "buoyancy", "point_masses", "pneumatics",
               "joints.laws", "air.wind_field")  # fmt: skip

# Parameters of the muscles, which have no common name. If pressures hold a joint, each of them
# moves it.
_GROUPS = (GEOMETRY, LOAD, ALPHA, BETA, BRAIDED, DRIVE, NECK)
_MUSCLES = {quantity.path.partition(".")[0] for group in _GROUPS for quantity in group}

_REFUSAL = (
    "a simulation with steps_for='motion' was differentiated with respect to a disturbance "
    f"(command, wind, torque, initial state, {', '.join(_PARAMETERS)}), for which its steps may be "
    "too long: call simulate with steps_for='derivatives', or the model's for_derivatives"
)


def is_disturbance(path: str) -> bool:
    """Return whether a parameter, or an element such as `air.wind[0]`, may move an arm at rest.

    A motion may be differentiated with respect to such a disturbance only with
    `steps_for="derivatives"`.
    """
    name = path.partition("[")[0]
    return any(name == known or name.startswith(f"{known}.") for known in (*_PARAMETERS, *_MUSCLES))


def check_steps_for(steps_for: str) -> None:
    """Reject (`InputError`) a choice of steps that is neither "motion" nor "derivatives"."""
    if steps_for not in get_args(StepsFor):
        raise InputError(
            f"steps_for={steps_for!r} is unknown: use 'motion', or 'derivatives' to differentiate "
            "with respect to the wind, the initial state and any other input that can move an "
            "arm at rest"
        )


def refuse_disturbances(steps_for: str, arm: Arm, inputs: Any) -> Scalar:
    """Return zero; raise `TypeError` for a tangent of a disturbance with `steps_for="motion"`.

    The zero must be added to a value that the simulation requires, otherwise it is optimised away.
    The error is raised while the program is traced, in forward or in reverse mode.
    """
    if steps_for != "motion":
        return jnp.zeros(())
    # Muscles in the gas of the links, because the gas pressure moves a joint that the muscles hold.
    muscles = None if arm.pneumatics is None else arm.pneumatics.in_links(arm.links)
    disturbances = (inputs, muscles, *(attrgetter(path)(arm) for path in _PARAMETERS))
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


def slides(arm: Arm) -> bool:
    """Return whether an arm has rate-independent states or contacts with friction."""
    touches = arm.contact is not None and arm.contact.rows > 0
    return arm.further_laws.mapped or touches


T = TypeVar("T")

Derivatives = Literal["forward", "reverse"]


def adjoint(derivatives: str) -> "diffrax.AbstractAdjoint":
    """Return the diffrax adjoint for a mode of differentiation.

    An `InputError` is raised for an unknown mode.
    """
    import diffrax

    if derivatives == "forward":
        return diffrax.ForwardMode()
    if derivatives == "reverse":
        return diffrax.RecursiveCheckpointAdjoint()
    raise InputError(
        f"derivatives={derivatives!r} is unknown: use 'forward' (few parameters: jax.jvp, "
        "jax.jacfwd) or 'reverse' (many parameters: jax.grad, jax.vjp)"
    )


def guard_outputs(tree: T, derivatives: str) -> T:
    """Return the outputs of a simulation, such that reverse-mode differentiation raises an error.

    This applies to `derivatives="forward"`.
    """
    if derivatives != "forward":
        return tree
    return eqxi.nondifferentiable_backward(
        tree,
        msg="simulate(derivatives='forward') was differentiated in reverse mode (jax.grad, "
        "jax.vjp): call it with derivatives='reverse', or use jax.jvp or jax.jacfwd",
    )


def guard_inputs(tree: T, derivatives: str) -> T:
    """Return the inputs of a simulation, such that forward-mode differentiation raises an error.

    This applies to `derivatives="reverse"`.
    """
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


# JAX does not permit forward-mode differentiation of a function with a custom vjp. The guard relies
# on this.
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
    solver: Solver,
    max_steps: int,
    derivatives: str,
    steps_for: str,
    span: tuple[Scalar, Scalar] | None = None,
    pressure: Pressures | None = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
) -> Trajectory:
    """Compiled core of `simulate`, without checks; a failure is a result code.

    Arguments:
        arm, command, times, wind, torque, pressure: as for `simulate`.
        state: angles (rad) and rates (rad/s) at the beginning, at which the hysteresis of the
            joints is unstrained.
        tolerances: relative and absolute tolerance of a step. solver, max_steps, derivatives,
            steps_for, stepsize_controller: as for `simulate`.
        span: start and end of the integration, s; defaults to the first and the last time.

    Raises:
        TypeError: it is differentiated with respect to a disturbance with `steps_for="motion"`.
    """
    # These are imported only if this function is compiled.
    import diffrax

    from ._controller import step_size_controller
    from ._linearly_implicit import LinearlyImplicit
    from ._return_mapping import with_return_mapping

    begin, end = (times[0], times[-1]) if span is None else span
    supplied = None if pressure is None else pressure.signal
    inputs = [signal for signal in (command, wind, torque, supplied) if signal is not None]
    rtol, atol = tolerances
    knots = [signal.corners(rtol) for signal in inputs]
    if wind is not None and arm.air.added_mass_coefficient is not None:
        # The force on the added mass depends on the rate of the wind, which jumps at each knot.
        knots[1] = (wind.times, jnp.full_like(wind.times, jnp.inf))
    # The ends of steps are not differentiated, although a command may be differentiated with
    # respect to the times of its knots.
    corners, bends = jax.lax.stop_gradient(tuple(map(jnp.concatenate, zip(*knots, strict=True))))
    if derivatives == "forward":
        rtol = rtol + refuse_disturbances(steps_for, arm, (inputs, state))
    method: Any = solver_named(solver, reverse=derivatives == "reverse")
    laws = arm.further_laws
    pulled = followed(command, arm.joints)
    moved = Inputs(arm, pulled, wind, torque, eqxi.prevbefore(end), pressure, first=begin)
    fastest = mobility = None
    if steps_for == "derivatives":
        rate = fastest_rate(arm, state[0], pressures=moved.supplied(begin, state[0]))
        implicit = isinstance(method, LinearlyImplicit)
        fastest = Rates(rate, fastest_rate(arm, state[0], springs=False) if implicit else rate)
        if arm.joints.laws:
            mobility = jax.lax.stop_gradient(jnp.linalg.inv(mass_matrix(arm, state[0])))
    controller: Any = stepsize_controller
    if not isinstance(controller, diffrax.StepTo):
        # Laws with rate-independent states follow the path between turning points within a step.
        own = arm.joints.further_laws.laws
        turning = any(law.rows > 0 and not law.slides for law in own)
        controller = step_size_controller(
            method,
            rtol,
            atol,
            corners,
            bends,
            fastest,
            turns=turning,
            mobility=mobility,
            inner=controller,
        )
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(motion),
        with_return_mapping(method, rtol, atol, derivatives) if slides(arm) else method,
        t0=begin,
        t1=end,
        dt0=None,
        y0=moved.start(state, begin),
        args=moved,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=controller,
        adjoint=adjoint(derivatives),
        max_steps=max_steps,
        throw=False,
    )
    assert solution.ys is not None
    angles, rates, memory, skin = jax.vmap(moved.parts)(solution.ys)
    counts = (solution.stats[f"num_{which}_steps"] for which in ("accepted", "rejected"))
    steps = jnp.stack([jnp.asarray(count) for count in counts])
    return Trajectory(
        times=times,
        angles=angles,
        rates=rates,
        memory=memory if laws.rows else None,
        pressures=jax.vmap(moved.inside)(times, memory),
        skin=skin if skin.size else None,
        arm=arm,
        command=command,
        wind=wind,
        torque=torque,
        result=_result(solution.result, jnp.all(jnp.isfinite(solution.ys))),
        steps=steps,
    )


def _result(ended: "diffrax.RESULTS", finite: Array) -> Any:
    import diffrax

    where: Any = RESULTS.where
    code = where(finite, RESULTS.successful, RESULTS.not_finite)
    code = where(ended == diffrax.RESULTS.successful, code, RESULTS.not_finite)
    code = where(ended == diffrax.RESULTS.dt_min_reached, RESULTS.step_too_small, code)
    return where(ended == diffrax.RESULTS.max_steps_reached, RESULTS.max_steps_reached, code)


MAX_STEPS = 100_000
"""Default step limit of a simulation."""


def simulate(
    arm: Arm,
    command: Signal,
    times: Any,
    *,
    wind: Signal | AbstractWind | Callable[..., Any] | Any | None = None,
    torque: Signal | None = None,
    pressure: Pressures | None = None,
    initial: tuple[Any, Any] | None = None,
    solver: Solver = "springs5",
    rtol: Any = 1e-6,
    atol: Any = 1e-6,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
    max_steps: int = MAX_STEPS,
    derivatives: Derivatives = "forward",
    steps_for: StepsFor = "motion",
    throw: bool = True,
) -> Trajectory:
    """Simulate the motion of an arm.

    The arm is straight and at rest at the first time unless `initial` is given. The integrator
    never steps over a corner of the command or the wind.

    Arguments:
        arm: the arm.
        command: commanded angles over time, rad; width = number of joints.
        times: increasing times of the samples, s, shape (sample,).
        wind: velocity of the air in the base frame, m/s: a signal of width 3, a signal with x, y
            and z for each link (width 3 times the number of links), three numbers, a function of
            position and time (`giajax.mechanics.arm.with_wind`), which then belongs to the arm of
            the result, or None for still air. With added mass the wind must not jump, because the
            force would be infinite. A function has no corners: if it may be constant for a long
            time before a gust, limit the steps (`stepsize_controller=diffrax.PIDController(rtol,
            atol, dtmax=...)`).
        torque: torque of the joints' drives over time, in addition to springs and dampers, N m;
            width = number of joints.
        pressure: pressures supplied to muscles over time (`Pressures`), if the arm has muscles; by
            default the controller of the muscles supplies the pressures that hold the command.
        initial: angles (rad) and rates (rad/s) at the first time, each of shape (joint,).
        solver: one of `giajax.simulation.SOLVERS`. "springs5", a linearly implicit additive
            Runge-Kutta method of order 5, is the fastest if springs rather than accuracy limit the
            steps of explicit methods such as "tsit5". Any diffrax solver for ordinary differential
            equations, such as `diffrax.Kvaerno4()`, is also accepted.
        rtol, atol: relative and absolute tolerance of a step, on angles (rad) and rates (rad/s);
            "springs5" weights these errors (docs/solvers.md). The default limits the error of the
            tip of the 20 m arm to about 1e-4 m.
        stepsize_controller: diffrax controller that replaces the default `PIDController`: an
            adaptive controller, which receives these tolerances, or `diffrax.StepTo` from the first
            to the last time, which also steps over corners.
        max_steps: step limit.
        derivatives: "forward" for few parameters (`jax.jvp`, `jax.jacfwd`); "reverse" for many
            (`jax.grad`), which stores about the square root of the number of steps.
        steps_for: "motion" for steps that the accuracy of the motion requires, for which
            derivatives with respect to links, joints and air are as accurate as the motion.
            "derivatives" for steps that are also stable for parts at rest, which derivatives with
            respect to a disturbance require: the command, the wind, the torque, the initial state,
            or the arm's base rotation, gravity, wind, buoyancy, point masses and muscles. These
            steps are shorter while stiff joints are at rest. The value of the simulation is the
            same with and without derivatives.
        throw: raise an error if the simulation fails; otherwise check `Trajectory.result`.

    Returns:
        The motion at the times, with angles (rad), rates (rad/s) and how the simulation ended.

    Raises:
        InputError: a shape does not match the arm; the times do not increase; or the solver,
            controller, mode or choice of steps is unknown or unsuitable.
        SimulationError: the simulation failed and `throw` is true.
        RuntimeError, TypeError: it is differentiated in the mode that was not selected.
        TypeError: it is differentiated with respect to a disturbance with `steps_for="motion"`.

    Example:
        >>> import giajax, jax.numpy as jnp
        >>> arm = giajax.takeichi_20m()
        >>> command = giajax.joint_ramps(20, {1: 0.5236}, start=0.5, duration=1.0)
        >>> motion = giajax.simulate(arm, command, jnp.linspace(0.0, 25.0, 251))
        >>> motion.tip.shape
        (251, 3)
    """
    dtype = jnp.result_type(float)
    times = jnp.asarray(times, dtype=dtype)
    if callable(wind) and not isinstance(wind, Signal):
        arm, wind = with_wind(arm, wind), None
    elif wind is not None and not isinstance(wind, Signal):
        wind = constant(wind)
    state = _initial_state(arm, initial)
    _check(arm, command, times, wind, torque, stepsize_controller)
    check_muscles(arm, command, pressure)
    # Invalid arguments are rejected before compilation.
    check_method(solver, stepsize_controller)
    adjoint(derivatives)
    check_steps_for(steps_for)
    rtol, atol = (jnp.asarray(tolerance, dtype=dtype) for tolerance in (rtol, atol))
    inputs = (command, wind, torque, pressure, state)
    # Guards take a millisecond, and concrete values are not differentiated.
    guarded = not is_concrete((arm, inputs, times, rtol, atol))
    if guarded:
        # After `guard_inputs`, all inputs appear to be differentiated.
        rtol = rtol + refuse_disturbances(steps_for, arm, inputs)
        arm, inputs = guard_inputs((arm, inputs), derivatives)
    command, wind, torque, pressure, state = inputs
    trajectory = integrate(
        arm,
        command,
        times,
        wind,
        torque,
        state,
        (rtol, atol),
        solver=solver,
        max_steps=max_steps,
        derivatives=derivatives,
        steps_for=steps_for,
        pressure=pressure,
        stepsize_controller=stepsize_controller,
    )
    if guarded:
        trajectory = guard_outputs(trajectory, derivatives)
    if throw:
        if is_concrete(trajectory.result):
            if not trajectory.successful:
                raise SimulationError(trajectory.message)
        else:
            trajectory = trajectory.result.error_if(trajectory, ~trajectory.successful)
    return trajectory


def _initial_state(arm: Arm, initial: tuple[Any, Any] | None) -> Float[Array, "2 joint"]:
    dtype = jnp.result_type(float)
    if initial is None:
        return jnp.zeros((2, arm.count), dtype=dtype)
    angles, rates = (jnp.asarray(part, dtype=dtype) for part in initial)
    if angles.shape != (arm.count,) or rates.shape != (arm.count,):
        raise InputError(
            f"the initial angles and rates have shapes {angles.shape} and {rates.shape}: "
            f"give one value for each of the {arm.count} joints"
        )
    return jnp.stack([angles, rates])


def _check(
    arm: Arm,
    command: Signal,
    times: Array,
    wind: Signal | None,
    torque: Signal | None,
    controller: Any,
) -> None:
    if command.width != arm.count:
        raise InputError(
            f"the command drives {command.width} joints, but the arm has {arm.count}: "
            "give one column for each joint"
        )
    if wind is not None and wind.width not in (3, 3 * arm.count):
        raise InputError(
            f"the wind has {wind.width} components: give x, y and z, or three components for each "
            f"of the {arm.count} links"
        )
    if torque is not None and torque.width != arm.count:
        raise InputError(
            f"the torque acts on {torque.width} joints, but the arm has {arm.count}: "
            "give one column for each joint"
        )
    check_wind(arm, wind)
    if controller is not None:
        _check_steps(controller, times)
    if times.ndim != 1 or times.shape[0] < 2:
        raise InputError(
            f"times has shape {times.shape}: give a one-dimensional array of at least two times"
        )
    if is_concrete(times) and not np.all(np.diff(np.asarray(times)) > 0):
        raise InputError("the times do not increase strictly: sort them and remove duplicates")


def _check_steps(controller: Any, times: Array) -> None:
    import diffrax

    if isinstance(controller, diffrax.StepTo) and is_concrete((times, controller.ts)):
        ends = [[float(each[0]), float(each[-1])] for each in (controller.ts, times)]
        if ends[0] != ends[1]:
            raise InputError(
                f"StepTo covers {ends[0]} s, but the times cover {ends[1]} s: make the two "
                "intervals equal"
            )


def check_wind(arm: Arm, wind: Signal | None) -> None:
    """Reject (`InputError`) a wind that jumps if the arm has added mass.

    The jump would cause an infinite force of zero duration. While a program is traced nothing is
    checked.
    """
    if wind is None or arm.air.added_mass_coefficient is None or not is_concrete(wind):
        return
    if bool(wind.jumps):
        raise InputError(
            "the wind is discontinuous, which causes an infinite force with added mass: give a "
            'wind that is linear between samples (interpolation = "linear")'
        )
