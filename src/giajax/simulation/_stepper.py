"""Stepwise simulation, for an operator or a controller that decides during the motion."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import Arm
from ..runtime.arrays import Array, Float, Scalar
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema.parameters import is_concrete
from ._motion import Inputs, State, motion
from ._return_mapping import with_return_mapping
from ._signal import Signal, check_muscles, constant
from ._simulate import slides
from ._solvers import Solver, check_method, solver as solver_named


class Moment(eqx.Module):
    """State of an arm at one time of its motion.

    Attributes:
        time: time, s.
        state: state of the joints: angles (rad), rates (rad/s), and the memory of the arm.
        command: commanded angles, rad.
        wind: velocity of the air, m/s, for the whole arm or for each link; None for still air.
    """

    time: Scalar
    state: State
    command: Float[Array, " joint"]
    wind: Float[Array, " width"] | None

    @property
    def angles(self) -> Float[Array, " joint"]:
        """Joint angles, rad."""
        return self.state[0]

    @property
    def rates(self) -> Float[Array, " joint"]:
        """Joint rates, rad/s."""
        return self.state[1]


# Tolerance of iterative methods, and step limit of one interval with error control.
_TOLERANCE, _MOST_STEPS = 1e-6, 1000


class Stepper(eqx.Module):
    """Simulation in fixed intervals, compiled once, with commands that may be decided between them.

    An interval is the time between two decisions. During an interval the command and the wind
    change linearly from the current to the given values. The interval is integrated in a number of
    equal steps without error control. To check the accuracy, compare with `simulate` once, or halve
    the steps. An arm that hits an obstacle temporarily requires shorter steps: give a `tolerance`.

    Attributes:
        arm: the arm.
        interval: time between two decisions, s.
        steps: number of integration steps per interval.
        solver: as for `simulate`; "springs5" is stable with long steps.
        tolerance: tolerance of a step, as for `simulate`. Steps are shortened if necessary, and the
            state is NaN if no step is short enough. Only forward-mode differentiation is then
            supported (`jax.jvp`, `jax.jacfwd`). With None, all steps are equal.

    Example:
        >>> import giajax, jax.numpy as jnp
        >>> stepper = giajax.simulation.Stepper(giajax.takeichi_20m(), interval=0.1, steps=2)
        >>> moment = stepper.start()
        >>> for _ in range(10):
        ...     moment = stepper.advance(moment, moment.command.at[0].add(0.005))
        >>> round(float(moment.time), 3)
        1.0
    """

    arm: Arm
    interval: Scalar = eqx.field(converter=lambda x: jnp.asarray(x, dtype=jnp.result_type(float)))
    steps: int = eqx.field(static=True, default=1)
    solver: Solver = eqx.field(static=True, default="springs5")
    tolerance: Scalar | None = eqx.field(
        converter=lambda x: None if x is None else jnp.asarray(x, dtype=jnp.result_type(float)),
        default=None,
    )

    def __check_init__(self) -> None:
        """Reject (`InputError`) non-positive values, unknown solvers, and lags of drives."""
        # The values are compared as numbers, because the result of comparing traced arrays is
        # unknown.
        if is_concrete(self.interval) and not (
            self.interval.ndim == 0 and 0 < float(self.interval) < np.inf
        ):
            raise InputError(f"the interval is {self.interval} s: give one positive number")
        if self.steps < 1:
            raise InputError(f"an interval has {self.steps} steps: give at least one")
        for name in ("drive_gain", "drive_lag", "drive_saturation"):
            if getattr(self.arm.joints, name) is not None:
                raise InputError(
                    f"the arm has joints.{name}, which stepwise simulation does not support: omit "
                    "this parameter, or call simulate"
                )
        tolerance = self.tolerance
        if tolerance is not None and is_concrete(tolerance) and not float(tolerance) > 0:
            raise InputError(f"the tolerance is {self.tolerance}: give a positive number, or None")
        if self.tolerance is None:
            solver_named(self.solver)
        else:
            check_method(self.solver)

    def start(
        self,
        angles: Any | None = None,
        rates: Any | None = None,
        *,
        command: Any | None = None,
        wind: Any | None = None,
        time: float = 0.0,
    ) -> Moment:
        """Return the state at the beginning, at which the hysteresis of the joints is unstrained.

        Arguments:
            angles: angles of the joints, rad, shape (joint,); straight by default.
            rates: rates of the joints, rad/s, shape (joint,); at rest by default.
            command: commanded angles, rad, shape (joint,); defaults to the angles of the joints.
            wind: velocity of the air, m/s, of shape (3,) or (3 * link,), or None for still air
                during the whole motion.
            time: initial time, s.

        Raises:
            InputError: a shape does not match the arm, or muscles cannot follow the command.
        """
        count = self.arm.count
        angles = _row("angles", count, np.zeros(count) if angles is None else angles)
        rates = _row("rates", count, np.zeros(count) if rates is None else rates)
        command = angles if command is None else _row("command", count, command)
        if wind is not None:
            wind = jnp.ravel(jnp.asarray(wind))
            wind = _row("wind", 3 * count if wind.size == 3 * count else 3, wind)
        check_muscles(self.arm, constant(command), None)
        at = jnp.asarray(time, dtype=angles.dtype)
        inputs = Inputs(self.arm, constant(command), None, None, at)
        return Moment(at, inputs.start(jnp.stack([angles, rates]), at), command, wind)

    def advance(self, moment: Moment, command: Any, wind: Any | None = None) -> Moment:
        """Return the state after one interval.

        Arguments:
            moment: current state.
            command: commanded angles at the end of the interval, rad, shape (joint,).
            wind: velocity of the air at the end of the interval, as for `start`; unchanged by
                default.

        Raises:
            InputError: a shape does not match the arm, or a wind is given after a start in still
                air.
        """
        command = _row("command", self.arm.count, command)
        if moment.wind is None and wind is not None:
            raise InputError(
                "a wind is given, but the simulation was started in still air: give a wind at the "
                "start, for example 0 m/s"
            )
        if moment.wind is not None:
            wind = moment.wind if wind is None else _row("wind", moment.wind.size, wind)
        return _advance(self, moment, command, wind)


@program
def _advance(stepper: Stepper, moment: Moment, command: Array, wind: Array | None) -> Moment:
    arm, interval = stepper.arm, stepper.interval
    inputs = Inputs(
        arm,
        _line(moment.command, command, interval),
        None if wind is None or moment.wind is None else _line(moment.wind, wind, interval),
        None,
        interval,
        begin=moment.time,
    )
    method: Any = solver_named(stepper.solver, reverse=stepper.tolerance is None)
    if slides(arm):
        method = with_return_mapping(method, _TOLERANCE, _TOLERANCE, "forward")
    terms = diffrax.ODETerm(motion)
    if stepper.tolerance is not None:
        solution = diffrax.diffeqsolve(
            terms,
            method,
            t0=jnp.zeros_like(interval),
            t1=interval,
            dt0=interval / stepper.steps,
            y0=moment.state,
            args=inputs,
            stepsize_controller=diffrax.PIDController(stepper.tolerance, stepper.tolerance),
            adjoint=diffrax.ForwardMode(),
            max_steps=_MOST_STEPS,
            throw=False,
        )
        assert solution.ys is not None
        ended = solution.result == diffrax.RESULTS.successful
        state = jnp.where(ended, solution.ys[-1], jnp.nan)
        return Moment(moment.time + interval, state, command, wind)
    # Times are relative to the interval, so that steps are equally accurate at the end of a long
    # motion.
    ends = jnp.arange(1, stepper.steps + 1, dtype=interval.dtype) * (interval / stepper.steps)

    def one(carry: Any, end: Array) -> tuple[Any, None]:
        state, inner, before, first = carry
        state, _, _, inner, _ = method.step(terms, before, end, state, inputs, inner, first)
        return (state, inner, end, jnp.asarray(False)), None

    begin = jnp.zeros_like(interval)
    inner = method.init(terms, begin, ends[0], moment.state, inputs)
    start: Any = (moment.state, inner, begin, jnp.asarray(True))
    (state, *_), _ = jax.lax.scan(one, start, ends)
    return Moment(moment.time + interval, state, command, wind)


def _line(before: Array, after: Array, duration: Scalar) -> Signal:
    """Return a signal that changes linearly from one value to another."""
    slope = (after - before) / duration
    time = jnp.zeros((1,), before.dtype)
    return Signal(time, before[None], slope[None], jnp.full_like(time, jnp.inf))


def _row(name: str, count: int, values: Any) -> Array:
    row = jnp.asarray(values, dtype=jnp.result_type(float))
    if row.shape != (count,):
        raise InputError(
            f"the argument {name} has the shape {row.shape}: give {count} numbers in one row"
        )
    return row
