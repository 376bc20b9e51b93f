"""Motion of an arm over time: the checks of `simulate`, and its compiled core on diffrax."""

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
# What parameters of a law of one's own move is not known.
_PARAMETERS = ("base_rotation", "gravity", "air.wind", "buoyancy", "point_masses", "pneumatics",
               "joints.laws", "air.wind_field")  # fmt: skip

# Of the muscles, whose parameters have no common name: where pressures hold a joint, each of them
# moves it.
_GROUPS = (GEOMETRY, LOAD, ALPHA, BETA, BRAIDED, DRIVE, NECK)
_MUSCLES = {quantity.path.partition(".")[0] for group in _GROUPS for quantity in group}

_REFUSAL = (
    "a simulation with steps_for='motion' was differentiated with respect to a disturbance "
    "(command, wind, "
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
            f"with respect to the wind, the initial state and any other input that can move an "
            f"arm at rest"
        )


def refuse_disturbances(steps_for: str, arm: Arm, inputs: Any) -> Scalar:
    """Zero; raises `TypeError` where steps for the motion would meet a disturbance's tangent.

    The zero must be added to something that the simulation needs, or nothing keeps it. The error is
    raised while the program is traced, in forward or in reverse mode.
    """
    if steps_for != "motion":
        return jnp.zeros(())
    # Muscles in the gas of links, which moves a joint that it holds.
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
    """Whether something follows the way of joints or slides along obstacles, step by step."""
    touches = arm.contact is not None and arm.contact.rows > 0
    return arm.further_laws.mapped or touches


T = TypeVar("T")

Derivatives = Literal["forward", "reverse"]


def adjoint(derivatives: str) -> "diffrax.AbstractAdjoint":
    """The diffrax adjoint that offers a mode of differentiation; `InputError` for another one."""
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
    solver: Solver,
    max_steps: int,
    derivatives: str,
    steps_for: str,
    span: tuple[Scalar, Scalar] | None = None,
    pressure: Pressures | None = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
) -> Trajectory:
    """The compiled core of `simulate`: no checks, and a failure is a result code.

    Arguments:
        arm, command, times, wind, torque, pressure: as of `simulate`.
        state: angles (rad) and rates (rad/s) at the beginning, where nothing strains the joints'
            hysteresis.
        tolerances: relative and absolute tolerance of a step.
        solver, max_steps, derivatives, steps_for, stepsize_controller: as of `simulate`.
        span: from when to when to integrate, s; by default from the first to the last time.

    Raises:
        TypeError: differentiated by a disturbance with `steps_for="motion"`.
    """
    # Only where this is compiled.
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
        # Added mass feels the rate of the wind, which jumps at each of its knots.
        knots[1] = (wind.times, jnp.full_like(wind.times, jnp.inf))
    # Where steps end is no part of what is differentiated, and a command may be, by when it turns.
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
        # Those with states by the way alone are followed from turn to turn within a step.
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
"""Step limit of a simulation by default."""


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

    The arm starts at the first time, straight and at rest unless `initial` says otherwise. The
    integrator never steps over a corner of the command or the wind.

    Arguments:
        arm: the arm.
        command: commanded angles over time, rad; width = number of joints.
        times: increasing times of the samples, s, shape (sample,).
        wind: velocity of the air in the base frame, m/s: a signal of width 3, one of x, y and z
            of link after link (width 3 times their number), three numbers, a function of place
            and time (`giajax.mechanics.arm.with_wind`), which the arm of the motion then has, or
            None for still air. With added mass it must not jump: the force would be infinite.
            A function has no corners: where it may be still for long before a gust, give steps a
            length (`stepsize_controller=diffrax.PIDController(rtol, atol, dtmax=...)`).
        torque: of the joints' drives over time, beside springs and dampers, N m; width = number
            of joints.
        pressure: supplied to muscles over time (`Pressures`), where the arm has some; by default
            their controller supplies those that hold the command.
        initial: angles (rad) and rates (rad/s) at the first time, each of shape (joint,).
        solver: one of `giajax.simulation.SOLVERS`; "springs5", a linearly implicit additive
            Runge-Kutta method of order 5, is the fastest wherever springs, not accuracy, limit the
            steps of explicit ones, such as "tsit5". Or any solver of diffrax for ordinary
            differential equations, such as `diffrax.Kvaerno4()`.
        rtol, atol: relative and absolute tolerance of a step, on angles (rad) and rates (rad/s);
            "springs5" weighs those (docs/solvers.md).
            The default keeps the tip of the 20 m arm within about 1e-4 m.
        stepsize_controller: of diffrax, in place of its `PIDController` with its defaults; an
            adaptive one, which has these tolerances, or `diffrax.StepTo` from the first to the
            last time, which steps over corners, too.
        max_steps: step limit.
        derivatives: "forward" for few parameters (`jax.jvp`, `jax.jacfwd`); "reverse" for many
            (`jax.grad`), which keeps about the square root of the number of steps in memory.
        steps_for: "motion" for steps that the motion needs, whose derivatives by links, joints
            and air are as exact as it is; "derivatives" for steps that are stable for whatever
            is at rest, too, as derivatives by a disturbance need: the command, the wind, the
            torque, the initial state, or the arm's base rotation, gravity, wind, buoyancy,
            point masses and muscles. Those are shorter where stiff joints rest; the value of the
            simulation is the same with and without derivatives.
        throw: raise when the simulation fails; otherwise read `Trajectory.result`.

    Returns:
        The motion at the times, with angles (rad), rates (rad/s) and how the simulation ended.

    Raises:
        InputError: shapes that do not fit the arm, times that do not increase, an unknown or
            unsuitable solver, controller, mode or choice of steps.
        SimulationError: the simulation failed and `throw` is true.
        RuntimeError, TypeError: differentiated in the mode that was not asked for.
        TypeError: differentiated by a disturbance with `steps_for="motion"`.

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
    # What is wrong is refused before anything is compiled.
    check_method(solver, stepsize_controller)
    adjoint(derivatives)
    check_steps_for(steps_for)
    rtol, atol = (jnp.asarray(tolerance, dtype=dtype) for tolerance in (rtol, atol))
    inputs = (command, wind, torque, pressure, state)
    # Guards cost a millisecond, and what is known now is not differentiated.
    guarded = not is_concrete((arm, inputs, times, rtol, atol))
    if guarded:
        # Behind the guard of the inputs everything seems to be differentiated.
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
            f"of the "
            f"{arm.count} links"
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
                f"StepTo covers {ends[0]} s, but the times cover {ends[1]}: make both the same"
            )


def check_wind(arm: Arm, wind: Signal | None) -> None:
    """Refuse (`InputError`) a wind that jumps where the arm has added mass.

    The jump would be an infinite force for no time. While a program is traced nothing is checked.
    """
    if wind is None or arm.air.added_mass_coefficient is None or not is_concrete(wind):
        return
    if bool(wind.jumps):
        raise InputError(
            "the wind is discontinuous, which causes an infinite force with added mass: give a "
            "wind that "
            'is linear between samples (interpolation = "linear")'
        )
