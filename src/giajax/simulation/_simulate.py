"""Motion of an arm over time, on diffrax."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import Arm
from ..runtime.arrays import Array, Float
from ..runtime.text import InputError
from ..schema.parameters import is_concrete
from ._integrate import (
    Derivatives,
    StepsFor,
    adjoint,
    check_steps_for,
    guard_inputs,
    guard_outputs,
    integrate,
    refuse_disturbances,
)
from ._linearly_implicit import solver as solver_named
from ._pressures import Pressures, check_muscles
from ._signal import Signal, constant
from ._trajectory import SimulationError, Trajectory

MAX_STEPS = 100_000
"""Step limit of a simulation by default."""


def simulate(
    arm: Arm,
    command: Signal,
    times: Any,
    *,
    wind: Signal | Any | None = None,
    torque: Signal | None = None,
    pressure: Pressures | None = None,
    initial: tuple[Any, Any] | None = None,
    solver: str = "tsit5",
    rtol: Any = 1e-6,
    atol: Any = 1e-6,
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
            of link after link (width 3 times their number), three numbers, or
            None for still air. With added mass it must not jump: the force would be infinite.
        torque: of the joints' drives over time, beside springs and dampers, N m; width = number
            of joints.
        pressure: supplied to muscles over time (`Pressures`), where the arm has some; by default
            their controller supplies those that hold the command.
        initial: angles (rad) and rates (rad/s) at the first time, each of shape (joint,).
        solver: one of `giajax.SOLVERS`; "springs5", a linearly implicit additive Runge-Kutta method
            of order 5, is the fastest wherever springs, not accuracy, limit the steps of the
            default.
        rtol, atol: relative and absolute tolerance of a step, on angles (rad) and rates (rad/s);
            "springs5" weighs those (docs/solvers.md).
            The default keeps the tip of the 20 m arm within about 1e-4 m.
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
        InputError: shapes that do not fit the arm, times that do not increase, an unknown
            solver, mode or choice of steps.
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
    if wind is not None and not isinstance(wind, Signal):
        wind = constant(wind)
    state = _initial_state(arm, initial)
    _check(arm, command, times, wind, torque)
    check_muscles(arm, command, pressure)
    solver_named(solver)  # refuse a wrong name before anything is compiled
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
    arm: Arm, command: Signal, times: Array, wind: Signal | None, torque: Signal | None
) -> None:
    if command.width != arm.count:
        raise InputError(
            f"the command drives {command.width} joints and the arm has {arm.count}: "
            "give one column per joint"
        )
    if wind is not None and wind.width not in (3, 3 * arm.count):
        raise InputError(
            f"the wind has {wind.width} components: give x, y and z, or those of each of the "
            f"{arm.count} links"
        )
    if torque is not None and torque.width != arm.count:
        raise InputError(
            f"the torque drives {torque.width} joints and the arm has {arm.count}: "
            "give one column per joint"
        )
    check_wind(arm, wind)
    if times.ndim != 1 or times.shape[0] < 2:
        raise InputError(f"times has shape {times.shape}: give at least two times in one row")
    if is_concrete(times) and not np.all(np.diff(np.asarray(times)) > 0):
        raise InputError("the times do not increase strictly: sort them and drop doubles")


def check_wind(arm: Arm, wind: Signal | None) -> None:
    """Refuse (`InputError`) a wind that jumps where the arm has added mass.

    The jump would be an infinite force for no time. While a program is traced nothing is checked.
    """
    if wind is None or arm.air.added_mass_coefficient is None or not is_concrete(wind):
        return
    if bool(wind.jumps):
        raise InputError(
            "the wind jumps, and with added mass the force of that is infinite: give a wind that "
            'is linear between its rows (interpolation = "linear")'
        )
