"""The compiled core of a simulation: diffrax on the equation of motion."""

from typing import TYPE_CHECKING, Any

import equinox.internal as eqxi
import jax
import jax.numpy as jnp

from .._program import program
from .._typing import Array, Float, Scalar
from ..arm import Arm
from ._derivatives import adjoint
from ._disturbances import refuse_disturbances
from ._motion import Inputs, motion
from ._pressures import Pressures
from ._rates import Rates, fastest_rate
from ._signal import Signal
from ._solvers import solver as solver_named
from ._trajectory import RESULTS, Trajectory

if TYPE_CHECKING:
    from diffrax import Solution


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
        arm, command, times, wind, torque: as of `simulate`.
        state: angles (rad) and rates (rad/s) at the beginning, shape (2, joint), where nothing
            strains the joints' hysteresis.
        tolerances: relative and absolute tolerance of a step.
        solver, max_steps, derivatives, steps_for: as of `simulate`.
        span: from when to when to integrate, s; by default from the first to the last time.
        pressure: as of `simulate`.

    Returns:
        The trajectory at the times; its result code says how the integration ended.

    Raises:
        TypeError: differentiated by a disturbance with `steps_for="motion"`.
    """
    # Slow to import, and needed only here, where the program is traced.
    import diffrax

    from ._catch_up import catching_up
    from ._controller import step_size_controller
    from ._linearly_implicit import LinearlyImplicit

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
        catching_up(method, rtol, atol, derivatives) if slides else method,
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
    steps = jnp.stack(
        [
            jnp.asarray(solution.stats["num_accepted_steps"]),
            jnp.asarray(solution.stats["num_rejected_steps"]),
        ]
    )
    return Trajectory(
        times=times,
        angles=angles,
        rates=rates,
        # Within a step sliding elements have not caught up yet.
        memory=jax.vmap(hysteresis.caught_up)(angles, memory) if hysteresis.rows else None,
        pressures=None if arm.pneumatics is None else jax.vmap(moved.inside)(times, muscles),
        skin=skin if skin.size else None,
        arm=arm,
        command=command,
        wind=wind,
        result=_result(solution, jnp.all(jnp.isfinite(solution.ys))),
        steps=steps,
    )


def _result(solution: "Solution", finite: Array) -> RESULTS:
    import diffrax

    def where(condition: Any, code: Any, otherwise: Any) -> Any:
        return RESULTS.where(condition, code, otherwise)

    ended = solution.result
    code = where(finite, RESULTS.successful, RESULTS.not_finite)
    code = where(ended == diffrax.RESULTS.successful, code, RESULTS.not_finite)
    code = where(ended == diffrax.RESULTS.dt_min_reached, RESULTS.step_too_small, code)
    return where(ended == diffrax.RESULTS.max_steps_reached, RESULTS.max_steps_reached, code)
