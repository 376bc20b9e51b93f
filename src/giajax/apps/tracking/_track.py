"""Tracking of a recorded run: filtered, smoothed and predicted states of the arm."""

import bisect
import dataclasses
import functools
import itertools
import time as clock
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root

from ...fitting import FitResult, arm_model_of
from ...mechanics.arm import Arm, acceleration, pose
from ...models import AbstractModel, ArmModel, camera_of, clock_of
from ...recordings import Channel, Run
from ...runtime.arrays import Array, Float, on_device, scaled
from ...runtime.parallel import Tell, all_in_threads
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import WindSection
from ...schema.parameters import declared, find
from ...simulation import Signal
from ..design import known_before
from ._arm import Air, Bias, Held, TrackedArm, tracked_arm
from ._filter import Gaussian
from ._rounds import (
    GATE,
    Events,
    Filtered,
    Followed,
    Learning,
    Motion,
    System,
    Watch,
    filtered,
    predicted,
    rested,
    smoothed_states,
    watching,
)

STIFFNESS_SHARE = 3e-5
"""Default unmodelled torque (white noise), as a fraction of the mean stiffness, sqrt(s)."""

_LONGEST = 0.1  # longest interval between two events, s
SHORT = 1e-9  # interval before the first event, s; not 0, because slopes are divided by it
_AHEAD = 0.25  # longest interval of a prediction without measurements, s
_DOUBLINGS = 13  # doublings of a filter interval for which the arm rested before: 14 minutes
# Number of events per call, so that runs of all lengths use the same compiled programs, and number
# of first events by which the initial state is chosen.
_CHUNK, _DECIDES = 100, 200
_MOST = 5e7  # largest number of elements of an array; about eight such arrays need 3 GB
CHANGED = 6.0
"""Number of standard deviations from which a change of a parameter is reported."""
SHOWN = 0.9
"""Fraction of its initial deviation above which a state counts as hardly observed."""
# Largest number of relinearisations, and the change of a parameter, in standard deviations, below
# which they end.
_ROUNDS, _STAYS = 3, 0.02
# Decrease of the log-likelihood that a relinearisation may cause, because it is linearised about
# another state.
_WORSE = 1.0
# Standard deviations of the initial angles, rad, and rates, rad/s: of an arm at rest, and of an arm
# in a given initial state.
_AT_REST = np.deg2rad([1.0, 0.3])
_STATED = np.deg2rad([2.0, 1.0])


@dataclasses.dataclass(frozen=True)
class Unknown:
    """Unknown quantities in addition to the motion of the arm.

    Attributes:
        air: unknown wind; None if the wind of the run is known or the air is still.
        biases: unknown biases of sensors.
        considered: path -> standard deviation, SI units, of the consider parameters (Schmidt-Kalman
            filter), whose uncertainty is included and which are not estimated.
        correlation: correlation of the consider parameters; None if they are uncorrelated.
        estimated: path -> standard deviation, SI units, of the estimated parameters.
        torque: unmodelled torque of each joint, as white noise, N m sqrt(s); None for the default.
        ties: path of a parameter that depends on others -> expression, as in a fit.
        at_start: standard deviations of all initial angles and rates, rad and rad/s. By default
            they are 2 deg and 1 deg/s for the initial state of the run, and 1 deg and 0.3 deg/s for
            an arm at rest.
    """

    air: Air | None = None
    biases: tuple[Bias, ...] = ()
    considered: Mapping[str, float] = dataclasses.field(default_factory=dict)
    correlation: Float[np.ndarray, "path path"] | None = None
    estimated: Mapping[str, float] = dataclasses.field(default_factory=dict)
    torque: float | None = None
    ties: Mapping[str, str] = dataclasses.field(default_factory=dict)
    at_start: tuple[float, float] | None = None


@dataclasses.dataclass(frozen=True)
class States:
    """State versus time, with standard deviations.

    The standard deviations have the units and shapes of their values.

    Attributes:
        angles: angles of the joints, rad, shape (time, joint).
        rates: rates of the joints, rad/s, shape (time, joint).
        tip: position of the tip, m, shape (time, 3).
        ends: positions of the ends of the links, m, shape (time, link, 3); the last one is the tip.
        wind: mean of the unknown wind over the links, m/s, shape (time, 3), or None.
        parameters: path -> values of each consider parameter or estimated parameter, SI units.
        biases: biases, SI units, shape (time, bias).
        angle_deviations: standard deviations of the angles.
        rate_deviations: standard deviations of the rates.
        tip_deviations: standard deviations of the tip.
        end_deviations: standard deviations of the ends of the links.
        wind_deviations: standard deviations of the wind.
        parameter_deviations: standard deviations of the parameters.
        bias_deviations: standard deviations of the biases.
        mean: mean of the whole state vector.
        root: square root of its covariance.
    """

    angles: Float[np.ndarray, "time joint"]
    rates: Float[np.ndarray, "time joint"]
    tip: Float[np.ndarray, "time 3"]
    ends: Float[np.ndarray, "time link 3"]
    wind: Float[np.ndarray, "time 3"] | None
    parameters: dict[str, np.ndarray]
    biases: Float[np.ndarray, "time bias"]
    angle_deviations: Float[np.ndarray, "time joint"]
    rate_deviations: Float[np.ndarray, "time joint"]
    tip_deviations: Float[np.ndarray, "time 3"]
    end_deviations: Float[np.ndarray, "time link 3"]
    wind_deviations: Float[np.ndarray, "time 3"] | None
    parameter_deviations: dict[str, np.ndarray]
    bias_deviations: Float[np.ndarray, "time bias"]
    mean: Float[np.ndarray, "time state"]
    root: Float[np.ndarray, "time state state"]


@dataclasses.dataclass(frozen=True)
class Change:
    """Detected change of a parameter.

    Attributes:
        path: path of the parameter.
        time: estimated time of the change, s.
        found: exposure time of the measurement by which it was detected, s.
        size: size of the change, SI units, estimated at the detection.
        deviation: standard deviation of the size.
    """

    path: str
    time: float
    found: float
    size: float
    deviation: float


@dataclasses.dataclass(frozen=True)
class Track:
    """Tracked run, as returned by `track`.

    Attributes:
        run: run that was tracked.
        arm: state-space model of the arm.
        unknown: unknown quantities.
        times: times of all exposures, and intermediate times in long intervals, s, shape (event,).
        filtered: estimates from the measurements up to each time.
        smoothed: estimates from the whole run.
        now: predictions for the time at which each measurement arrives, from the measurements
            exposed up to that measurement; None without a delay.
        now_times: times of these predictions, s.
        latency: delay of the arrival of a measurement after its time stamp, s.
        there: whether each channel was measured, shape (event, channel).
        used: whether each measurement was used.
        off: innovations (measured minus predicted values), SI units.
        expected: standard deviations of the innovations, SI units.
        whitened: whitened innovations of the used measurements, with standard deviation 1.
        nis: normalised innovation squared of all measurements of each event.
        log_likelihood: log-likelihood of the measurements of each event.
        noise: name of each channel -> standard deviation of its noise, SI units.
        gate: largest innovation that is used, in standard deviations.
        start: initial estimate.
        seconds: computing time of the filter per event, without compilation, s.
        changes: detected changes of estimated parameters. The filter allows for a change from its
            detection on, and the smoother from the change itself.
        loosened: factor of the default unmodelled torque with which the run could be tracked, if no
            torque was given.
    """

    run: Run
    arm: TrackedArm
    unknown: Unknown
    times: Float[np.ndarray, " event"]
    filtered: States
    smoothed: States
    now: States | None
    now_times: Float[np.ndarray, " event"]
    latency: float
    there: np.ndarray
    used: np.ndarray
    off: np.ndarray
    expected: np.ndarray
    whitened: np.ndarray
    nis: np.ndarray
    log_likelihood: np.ndarray
    noise: dict[str, float]
    gate: float
    start: Gaussian
    seconds: float
    changes: tuple[Change, ...]
    loosened: int = 1


def considered_of(result: FitResult) -> tuple[dict[str, float], np.ndarray]:
    """Return the standard errors of the fitted parameters of the arm, and their correlation."""
    of_arm = declared(arm_model_of(result).arm)
    paths = [
        path
        for path in result.free
        if path.partition("[")[0] in of_arm and np.ndim(result.parameters[path].value) == 0
    ]
    errors, correlation = known_before(result, paths)
    kept = [index for index, path in enumerate(paths) if path in errors]
    return {paths[k]: errors[paths[k]] for k in kept}, correlation[np.ix_(kept, kept)]


def with_errors_of(model: AbstractModel | FitResult, unknown: Unknown) -> Unknown:
    """Return the unknowns, with consider parameters from a fit if none are given."""
    if not isinstance(model, FitResult):
        return unknown
    unknown = dataclasses.replace(unknown, ties=unknown.ties or model.config.get("ties", {}))
    if unknown.considered:
        return unknown
    errors, correlation = considered_of(model)
    kept = [k for k, path in enumerate(errors) if path not in unknown.estimated]
    return dataclasses.replace(
        unknown,
        considered={path: size for path, size in errors.items() if path not in unknown.estimated},
        correlation=correlation[np.ix_(kept, kept)],
    )


def model_and_unknown(
    model: AbstractModel | FitResult, run: Run, unknown: Unknown | None
) -> tuple[ArmModel, Unknown]:
    """Return the model of the arm for a run, and its unknowns, from a model or a fit.

    A fit also gives the consider parameters, with their standard errors.

    Raises:
        InputError: the model is not that of an arm.
    """
    unknown = with_errors_of(model, Unknown() if unknown is None else unknown)
    return arm_model_of(model.model_of(run) if isinstance(model, FitResult) else model), unknown


def has_own_wind(model: ArmModel) -> bool:
    """Return whether the arm itself has a wind, apart from that of a run."""
    return model.arm.air.wind is not None or model.arm.air.wind_field is not None


def delays_of(model: ArmModel, channels: Sequence[str]) -> dict[str, float]:
    """Return the delay of each channel, s."""
    sensors, found = model.sensors, {}
    for name in channels:
        channel = Channel.named(name)
        if channel.quantity == "pixel":
            delay: Any = clock_of(sensors, camera_of(sensors, channel))
        else:
            # As in a prediction, the sensor of the channel determines the clock.
            rows = sensors.rows({channel.kind})
            delay = getattr(rows[channel.kind][1], "delay", None) if rows else None
        found[name] = 0.0 if delay is None else float(delay)
    return found


def noise_of(run: Run, channels: Sequence[str], result: FitResult | None) -> dict[str, float]:
    """Return the standard deviation of the noise of each channel, SI, from the run or from the fit.

    Raises:
        InputError: neither the run nor the fit gives the noise of a channel.
    """
    known: dict[str, float] = {}
    for fitted in () if result is None else result.runs:
        for name, channel in fitted.channels.items():
            known.setdefault(name, channel.noise)
    quantities: dict[str, float] = {}
    for name, noise in known.items():
        if name in run.channels:
            quantities.setdefault(run.channels[name].quantity, noise)
    found = {}
    for name in channels:
        stated = run.noise(name)
        if stated is None:
            stated = known.get(name, quantities.get(run.channels[name].quantity))
        if stated is None or not stated > 0:
            raise InputError(
                f"the noise of {name} of '{run.name}' is unknown: give it in [noise], or give a "
                "fit with --model"
            )
        found[name] = float(stated)
    return found


@dataclasses.dataclass(frozen=True)
class Plan:
    """Events of a run, and the known inputs in any interval.

    Attributes:
        times: times of the events, s.
        events: events for the filter.
        command: commanded angles versus time.
        wind: known wind versus time; None if it is unknown or the air is still.
        width: number of columns of the wind in `held` if `wind` is None: 3 if the wind is unknown,
            0 in still air.
    """

    times: np.ndarray
    events: Events
    command: Signal
    wind: Signal | None
    width: int

    def held(self, begin: np.ndarray, end: np.ndarray) -> Held:
        """Return the known inputs of intervals; a jump at the end of an interval is excluded."""
        length = end - begin
        last = end - 1e-9 * np.maximum(length, 1e-3)
        edges = np.stack([begin, last], axis=-1)
        command = _values(self.command, edges, self.command.width)
        wind = np.zeros((*edges.shape, self.width))
        if self.wind is not None:
            wind = _values(self.wind, edges, self.wind.width)
        return Held(*(jnp.asarray(each, float) for each in (begin, length, command, wind)))


def _values(signal: Signal, times: np.ndarray, width: int) -> np.ndarray:
    knots, values, slopes = (
        np.asarray(each) for each in (signal.times, signal.values, signal.slopes)
    )
    at = np.maximum(np.searchsorted(knots, times.ravel(), side="right") - 1, 0)
    # Before its first knot, a signal has the value at that knot.
    since = np.maximum(times.ravel() - knots[at], 0.0)
    return (values[at] + since[:, None] * slopes[at]).reshape(*times.shape, width)


def planned(model: ArmModel, run: Run, channels: Sequence[str], *, unknown_air: bool) -> Plan:
    """Return the exposures of a run in order of time, with intermediate steps in long intervals.

    Raises:
        InputError: the run is not driven by commanded angles.
    """
    for name in run.commands:
        if run.channels[name].kind != "joint_command":
            raise InputError(
                f"'{run.name}' drives the arm by {name}, but tracking needs commanded angles: "
                "remove the column"
            )
    inputs = model.prepare(run)
    assert run.times is not None
    delays = delays_of(model, channels)
    table = np.stack([np.asarray(run.values[name], float) for name in channels], axis=1)
    rows: dict[float, np.ndarray] = {}
    for late in sorted(set(delays.values())):
        columns = [index for index, name in enumerate(channels) if delays[name] == late]
        for stamp, values in zip(run.times - late, table[:, columns], strict=True):
            row = rows.setdefault(round(float(stamp), 9), np.full(len(channels), np.nan))
            row[columns] = values
    # The initial state is that at the first row, so earlier exposures cannot be used.
    first = round(float(run.times[0]), 9)
    exposures = np.array([first, *(each for each in sorted(rows) if each > first)])
    if len(exposures) < 2:
        raise InputError(f"'{run.name}' has no measurement after its first row: give a longer run")
    # Add the knots of the command and the wind, because both are linear in each interval.
    knots = [np.asarray(inputs.command.times)]
    knots += [] if inputs.wind is None else [np.asarray(inputs.wind.times)]
    bends = np.concatenate(knots).round(9)
    bends = bends[(bends > first) & (bends < exposures[-1])]
    corners = np.unique(np.concatenate([exposures, bends]))
    apart = np.concatenate([[True], np.diff(corners) > 1e-6]) | np.isin(corners, exposures)
    times = [first]
    for before, after in itertools.pairwise(corners[apart]):
        count = max(int(np.ceil((after - before) / _LONGEST - 1e-6)), 1)
        times += [*np.linspace(before, after, count + 1)[1:-1].tolist(), after]
    moments = np.array(times)
    empty = np.full(len(channels), np.nan)
    values = np.stack([rows.get(round(float(each), 9), empty) for each in moments])
    begin = np.concatenate([[moments[0] - SHORT], moments[:-1]])
    width = 3 if unknown_air else 0
    plan = Plan(moments, None, inputs.command, inputs.wind, width)  # type: ignore[arg-type]
    there = np.isfinite(values)
    events = Events(
        plan.held(begin, moments), jnp.asarray(np.where(there, values, 0.0)), jnp.asarray(there)
    )
    return dataclasses.replace(plan, events=events)


@program
def _balance(arm: Arm, angles: Array, command: Array, wind: Array | None) -> tuple[Array, Array]:
    def off(angles: Array) -> tuple[Array, Array]:
        found = acceleration(arm, angles, jnp.zeros_like(angles), command, wind, None)
        return found, found

    slope, found = jax.jacfwd(off, has_aux=True)(angles)
    return found, slope


def rest_in(arm: Arm, command: np.ndarray, wind: np.ndarray | None) -> np.ndarray | None:
    """Return the equilibrium angles of an arm under a command in a wind, rad, or None."""
    blows = None if wind is None else jnp.asarray(wind, float)

    def off(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        given = (jnp.asarray(angles, float), jnp.asarray(command, float), blows)
        found, slope = _balance(arm, *given)
        return np.asarray(found), np.asarray(slope)

    found = root(off, command, jac=True, options={"xtol": 1e-10})
    return found.x if found.success and np.all(np.isfinite(found.x)) else None


def starts(
    tracked: TrackedArm,
    held: Held,
    unknown: Unknown,
    stated: Any,
    motion: Callable[[Gaussian, Held], Motion],
    rest: Sequence[bool] = (False, True),
) -> list[Gaussian]:
    """Return the candidates for the initial estimate.

    The arm starts in the given state, or has been at rest for a long time. An unknown mean flow has
    the initial guess or the opposite value, at which the derivative of the drag is different.

    Arguments:
        tracked: state-space model of the arm.
        held: known inputs of the first interval.
        unknown: unknown quantities.
        stated: initial angles and rates of the run.
        motion: function that returns the linearised motion of a state in an interval.
        rest: alternatives to try: False for the given state, True for an arm at rest.
    """
    where, air = tracked.slices(), unknown.air
    flows = [None] if air is None else [air.wind.mean, -air.wind.mean]
    command = np.asarray(held.command[0])
    angles, rates = np.asarray(stated.angle, float), np.asarray(stated.rate, float)
    found = []
    for flow in flows:
        mean, deviation = np.zeros(tracked.size), np.zeros(tracked.size)
        if air is not None and flow is not None:
            mean[where["mean flow"]] = flow
            deviation[where["mean flow"]] = air.mean_deviation
        known = np.asarray(held.wind[0])
        blows = None if not known.size and flow is None else _of_links(tracked, known, flow)
        spread = dict(unknown.considered) | dict(unknown.estimated)
        mean[where["parameters"]] = [_nominal(tracked, path) for path in tracked.paths]
        covariance = np.diag([spread[path] ** 2 for path in tracked.paths])
        count = len(unknown.considered)
        if unknown.correlation is not None and count:
            errors = np.array([*unknown.considered.values()])
            covariance[:count, :count] = unknown.correlation * np.outer(errors, errors)
        deviation[where["biases"]] = np.asarray(tracked.bias_deviation)
        reached, pulled = tracked.followed(command)
        mean[where["drive"]] = reached if tracked.lags else []
        deviation[where["drive"]] = _AT_REST[0]
        size = tracked.joints
        for rests in rest:
            here = rest_in(tracked.model.arm, pulled, blows) if rests else angles
            if here is None:
                continue
            begun, root_of = mean.copy(), np.diag(deviation)
            begun[:size], begun[size : 2 * size] = here, 0.0 if rests else rates
            spreads = unknown.at_start or (_AT_REST if rests else _STATED)
            root_of[range(size), range(size)] = spreads[0]
            root_of[range(size, 2 * size), range(size, 2 * size)] = spreads[1]
            if tracked.gusts is not None:
                root_of[where["gusts"], where["gusts"]] = tracked.gusts.roots()
            inside = where["parameters"]
            if tracked.paths:
                roots, turns = np.linalg.eigh(covariance)
                root_of[inside, inside] = turns * np.sqrt(np.maximum(roots, 0.0))
            state = np.asarray(tracked.memory_at(begun, command))
            begun[where["arm"]] = state.ravel()
            start = Gaussian(jnp.asarray(begun), jnp.asarray(root_of))
            if rests:
                often = held._replace(length=jnp.asarray(_LONGEST, float))
                start = rested(start, motion(start, often), _DOUBLINGS)
                size_of = float(jnp.max(start.deviations[: tracked.joints]))
                if not size_of < np.pi:  # the equilibrium is not stable
                    continue
            found.append(start)
    return found


def _of_links(tracked: TrackedArm, known: np.ndarray, flow: np.ndarray | None) -> np.ndarray:
    count = tracked.joints
    wind = np.zeros((count, 3))
    if known.size:
        wind = wind + (known[None] if known.size == 3 else known.reshape(count, 3))
    return wind if flow is None else wind + flow[None]


def _nominal(tracked: TrackedArm, path: str) -> float:
    late = tracked.delay_of(path)
    return float(find(tracked.model, path).value(tracked.model)) if late is None else late


Outputs = tuple[Array, Array, Array, Array]


def _output(tracked: TrackedArm, state: Gaussian) -> Outputs:
    """Return the ends of the links and the mean wind of a state, and their standard deviations."""

    def both(vector: Array) -> tuple[Array, Array]:
        arm = tracked.with_parameters(vector).arm
        here = pose(arm, vector[: tracked.joints])
        ends = (here.joint + scaled(arm.links.length, here.direction)).T.ravel()
        wind = tracked.wind(vector)
        found = ends if wind is None else jnp.concatenate([ends, jnp.mean(wind, axis=0)])
        return found, found

    slope, found = jax.jacfwd(both, has_aux=True)(state.mean)
    spread = jnp.sqrt(jnp.sum((slope @ state.root) ** 2, axis=1))
    places, count = (tracked.joints, 3), 3 * tracked.joints
    return (
        found[:count].reshape(places),
        spread[:count].reshape(places),
        found[count:],
        spread[count:],
    )


@program
def _outputs(tracked: TrackedArm, states: Gaussian) -> Outputs:
    rows: Outputs = jax.lax.map(lambda state: _output(tracked, state), states)
    return rows


@program
def _output_alone(tracked: TrackedArm, state: Gaussian) -> Outputs:
    return _output(tracked, state)


def as_states(tracked: TrackedArm, states: Gaussian) -> States:
    """Return the distributions of state vectors as named quantities."""
    if len(states.mean) == 1:  # from a tracker, once per row: avoid the padding to a chunk
        found: Any = [
            each[None] for each in _output_alone(tracked, Gaussian(*(x[0] for x in states)))
        ]
    else:
        found = _of_each(_outputs, tracked, (states,))
    link_ends, end_deviations, wind, wind_deviations = map(np.asarray, found)
    mean, root_of = np.asarray(states.mean), np.asarray(states.root)
    deviations = np.sqrt(np.sum(root_of**2, axis=2))
    where, count = tracked.slices(), tracked.joints
    of = {path: where["parameters"].start + k for k, path in enumerate(tracked.paths)}
    blows = wind.shape[1] > 0
    return States(
        angles=mean[:, :count],
        rates=mean[:, count : 2 * count],
        tip=link_ends[:, -1],
        ends=link_ends,
        wind=wind if blows else None,
        parameters={path: mean[:, index] for path, index in of.items()},
        biases=mean[:, where["biases"]],
        angle_deviations=deviations[:, :count],
        rate_deviations=deviations[:, count : 2 * count],
        tip_deviations=end_deviations[:, -1],
        end_deviations=end_deviations,
        wind_deviations=wind_deviations if blows else None,
        parameter_deviations={path: deviations[:, index] for path, index in of.items()},
        bias_deviations=deviations[:, where["biases"]],
        mean=mean,
        root=root_of,
    )


def usual_torque(model: ArmModel) -> float:
    """Return the default unmodelled torque, N m sqrt(s)."""
    joints = model.arm.joints
    return STIFFNESS_SHARE * float(
        np.mean([*joints.pitch_stiffness.ravel(), *joints.yaw_stiffness.ravel()])
    )


def estimated_states(tracked: TrackedArm, unknown: Unknown) -> Array:
    """Return which states are estimated: all except the consider parameters."""
    first = tracked.slices()["parameters"].start
    places = np.arange(tracked.size) - first
    return jnp.asarray((places < 0) | (places >= len(unknown.considered)))


class Settings(NamedTuple):
    """Settings of the filter for a run.

    Attributes:
        estimated: whether each state is estimated.
        gate: largest innovation that is used, in standard deviations.
        blind: whether each measured value is replaced by its prediction.
        watch: detector of changes of parameters; None if no parameter is estimated.
    """

    estimated: Array
    gate: Array
    blind: Array
    watch: Watch | None


def begun_at(
    model: ArmModel,
    run: Run,
    noise: Mapping[str, float],
    unknown: Unknown,
    gate: float,
    start: Gaussian | None = None,
) -> tuple[TrackedArm, Plan, Gaussian, Settings]:
    """Return the state-space model, the events, the initial estimate and the settings for a run.

    Of several candidates for the initial estimate, the one that explains the first events best is
    chosen. If `start` is given, it is used.

    Raises:
        InputError: the run is too long for its number of states, or `planned` does not support it.
    """
    names = list(noise)
    known = run.definition.section(WindSection).velocity_m_per_s is not None or bool(run.winds)
    if unknown.air is not None and (known or has_own_wind(model)):
        raise InputError(
            f"the wind of '{run.name}' is given by its columns, by [wind] or by the arm: remove "
            "this wind, or do not track a wind"
        )
    tracked = tracked_arm(
        model,
        names,
        noise,
        air=unknown.air,
        biases=(*unknown.biases, *correlated_noise_of(run, names)),
        paths=(*unknown.considered, *unknown.estimated),
        torque=usual_torque(model) if unknown.torque is None else unknown.torque,
        ties=unknown.ties,
    )
    plan = planned(model, run, names, unknown_air=unknown.air is not None)
    if len(plan.times) * tracked.size**2 > _MOST:
        raise InputError(
            f"'{run.name}' has {len(plan.times)} times with {tracked.size} states each, which are "
            "too many: split it into several runs"
        )
    watch = None
    if (directions := watched_parameters(tracked, unknown)) is not None:
        watch, events = watching(directions), plan.events
        seen = np.where(events.there, events.values, np.nan)
        moves = jnp.asarray(moving(plan.times, seen, np.asarray(tracked.noise)))
        learning = Learning(events.held.length, moves, jnp.zeros((len(moves), tracked.size)))
        plan = dataclasses.replace(plan, events=events._replace(learning=learning))
    estimated = estimated_states(tracked, unknown)
    settings = Settings(estimated, jnp.asarray(gate, float), jnp.asarray(False), watch)
    if start is not None:
        return tracked, plan, start, settings
    one = _first(plan.events, 1)
    one = one._replace(there=jnp.zeros_like(one.there))

    def motion(start: Gaussian, held: Held) -> Motion:
        event = one._replace(held=jax.tree.map(lambda leaf: leaf[None], held))
        _, rows = followed_through(tracked, start, event, settings)
        found: Motion = _taken(rows.motion, 0)
        return found

    first: Any = _taken(plan.events.held, 0)
    begins = starts(tracked, first, unknown, model.prepare(run).initial, motion)
    return tracked, plan, chosen(tracked, plan, begins, settings), settings


def watched_parameters(tracked: TrackedArm, unknown: Unknown) -> Array | None:
    """Return the direction of each estimated parameter, scaled by its initial standard deviation.

    The result is None if no parameter is estimated.
    """
    first = tracked.slices()["parameters"].start + len(unknown.considered)
    spread = np.array([*unknown.estimated.values()])
    found = spread[:, None] * np.eye(tracked.size)[first : first + len(spread)]
    return jnp.asarray(found) if len(spread) else None


def track(
    model: AbstractModel | FitResult,
    run: Run,
    *,
    unknown: Unknown | None = None,
    latency: float = 0.0,
    gate: float = GATE,
    channels: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Track:
    """Track a recorded run: estimate its states with standard deviations, filtered and smoothed.

    Arguments:
        model: model of the arm, or a fit of it, whose parameters are then consider parameters.
        run: run with commands and measurements.
        unknown: unknown quantities in addition to the motion; defaults to the consider parameters
            of the fit.
        latency: delay of the arrival of a measurement after its time stamp, s, in addition to the
            delay of its clock.
        gate: innovation, in standard deviations, above which a measurement is not used for the
            estimate.
        channels: channels to use; defaults to all measured channels.
        progress: function that is called with progress messages.

    Raises:
        InputError: the run is not of an arm, its noise is unknown, or it is not driven by commanded
            angles.

    Example:
        >>> import giajax
        >>> run = giajax.read_run("data/synthetic/base_step.csv")  # doctest: +SKIP
        >>> found = giajax.track(giajax.model_for([run]), run)  # doctest: +SKIP
    """
    say = progress or (lambda _: None)
    result = model if isinstance(model, FitResult) else None
    stated, unknown = model_and_unknown(model, run, unknown)
    run.require_observations()
    if run.times is None:
        raise InputError(f"'{run.name}' has no times: give a run over time")
    names = list(run.observations if channels is None else channels)
    if not (0 <= latency < 60 and gate > 0):
        raise InputError(
            f"the latency is {latency:g} s, and the gate is {gate:g}: give a latency of 0 to 60 s, "
            "and a positive gate"
        )
    noise = noise_of(run, names, result)
    say("estimating the initial state ...")
    # If the unmodelled torque is not given, try larger values for a model that lacks more effects.
    # A run that can be tracked can then be judged.
    factors = (1, 2, 4) if unknown.torque is None else (1,)
    for factor in factors:
        if factor > 1:
            torque = factor * usual_torque(stated)
            say(
                f"the state became infinite; repeating with an unmodelled torque of {torque:.2g} "
                "..."
            )
            unknown = dataclasses.replace(unknown, torque=torque)
        tracked, plan, begun, settings = begun_at(stated, run, noise, unknown, gate)
        say(f"filtering {len(plan.times)} times ...")
        course = watched_through(tracked, begun, plan, settings)
        found = course.rows
        states = as_states(tracked, found.state)
        if np.all(np.isfinite(states.mean)):
            break
    else:
        raise InputError(
            f"the arm cannot be tracked in '{run.name}', because its state becomes infinite: allow "
            f"more unmodelled torque than {float(tracked.torque):.2g} (--torque-noise), or compare "
            "model and wind with the run first ('giajax fit')"
        )
    if not np.any(found.used):
        raise InputError(
            f"no measurement of '{run.name}' is accepted, because each deviates by more than "
            f"{gate:g} standard deviations: compare the model with the run first ('giajax fit'), "
            "or allow larger deviations (--gate)"
        )
    say("smoothing ...")
    every = settings._replace(estimated=jnp.ones_like(settings.estimated))
    if len(unknown.considered) or course.changes:
        # The smoother also estimates the consider parameters of the filter.
        _, found = followed_through(tracked, begun, course.events, every)
    smooth, _ = linearised_again(tracked, begun, _moving_at_some_time(course.events), every, found)
    after = as_states(tracked, smooth)
    if not np.all(np.isfinite(after.mean)):
        raise InputError(
            f"the smoothed state of '{run.name}' is not finite: allow more unmodelled torque, or "
            "compare the model with the run first ('giajax fit')"
        )
    late = max(delays_of(stated, names).values()) + latency
    now, now_times = None, plan.times
    if late > 0:
        say("computing the estimates with latency ...")
        now = as_states(tracked, _ahead(tracked, plan, course.rows.state, late))
        now_times = plan.times + late
    seen = course.rows.innovation
    return Track(
        run=run,
        arm=tracked,
        unknown=unknown,
        times=plan.times,
        filtered=states,
        smoothed=after,
        now=now,
        now_times=now_times,
        latency=latency,
        there=np.asarray(plan.events.there),
        used=np.asarray(course.rows.used),
        off=np.asarray(seen.off),
        expected=np.asarray(seen.deviations),
        whitened=np.asarray(seen.whitened),
        nis=np.asarray(seen.nis),
        log_likelihood=np.asarray(seen.log_likelihood),
        noise=noise,
        gate=gate,
        start=begun,
        seconds=course.seconds,
        changes=course.changes,
        loosened=factor,
    )


def correlated_noise_of(run: Run, names: Sequence[str]) -> list[Bias]:
    """Return the correlated noise of a run as time-varying biases, one for each channel."""
    found = []
    for name in names:
        stated = run.correlated_noise(name)
        if stated is not None and stated[0] > 0:
            found.append(Bias((name,), stated[0], stated[1]))
    return found


def chosen(
    tracked: TrackedArm, plan: Plan, begins: Sequence[Gaussian], settings: Settings
) -> Gaussian:
    """Return the initial estimate that explains the first measurements best."""
    if len(begins) == 1:
        return begins[0]
    events = _first(plan.events, _DECIDES)

    def likely(start: Gaussian, _: Tell) -> float:
        return log_likelihood_of(followed_through(tracked, start, events, settings)[1])

    jobs = [functools.partial(likely, start) for start in begins]
    totals = np.array(all_in_threads(jobs))
    return begins[int(np.argmax(np.where(np.isnan(totals), -np.inf, totals)))]


def begun_with(system: System, start: Gaussian, watch: Watch | None = None) -> Followed:
    """Return the initial state of a filter."""
    return Followed(start, jnp.zeros(system.noise.shape[0], int), watch)


def _calls(count: int) -> list[tuple[int, int]]:
    """Return the first row and the number of rows of each call, for a total number of rows."""
    return [(begin, min(_CHUNK, count - begin)) for begin in range(0, count, _CHUNK)]


# NumPy takes and joins rows here: JAX would compile a program for each shape.


def _taken(rows: Any, at: Any) -> Any:
    """Return the rows at an index, a slice or indices."""
    return jax.tree.map(lambda leaf: on_device(np.asarray(leaf)[at]), rows)


def _some(rows: Any, begin: int, size: int) -> Any:
    """Return the rows of a call, padded to the size of all calls with the last of `size` rows."""
    return _taken(rows, np.minimum(np.arange(begin, begin + _CHUNK), begin + size - 1))


def _first(rows: Any, size: int) -> Any:
    return _taken(rows, slice(size))


def _joined(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: on_device(np.concatenate(leaves)), *parts)


LATELY, FEW = 10.0, 4
"""Time (s) and number of values before a measurement that decide whether the arm moves."""
_MOVES = 2.0  # standard deviation of a channel that counts as motion, relative to its noise


def moving(times: np.ndarray, values: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return whether any channel has recently moved by more than its noise, at each time.

    At rest, a parameter affects the measurements only by products of errors, whose information a
    linearised filter overestimates. The median of three values is used, so that an outlier does not
    count as motion.

    Arguments:
        times: increasing times, s, shape (event,).
        values: measured values, SI units, shape (event, channel); NaN if not measured.
        noise: standard deviations of the noise, SI units, shape (channel,).
    """
    found = np.zeros(len(times), bool)
    begins = np.searchsorted(times, np.asarray(times) - LATELY)
    for column, size in zip(values.T, noise, strict=True):
        there = np.flatnonzero(np.isfinite(column))
        if len(there) < 3:
            continue
        known = column[there] / size
        middle = np.median(np.stack([known[:-2], known[1:-1], known[2:]]), axis=0)
        middle -= middle[0]
        sums = np.cumsum(np.stack([np.ones_like(middle), middle, middle**2]), axis=1)
        sums = np.pad(sums, ((0, 0), (1, 0)))
        last = np.searchsorted(there[2:], np.arange(len(times)), side="right")
        # Use at least the last few values of a channel that is rarely measured.
        first = np.minimum(np.searchsorted(there[2:], begins), np.maximum(last - FEW, 0))
        count, mean, square = sums[:, last] - sums[:, first]
        count = np.maximum(count, 1)
        found |= square / count - (mean / count) ** 2 > _MOVES**2
    return found


def _one_call(
    system: System,
    followed: Followed,
    events: Events,
    settings: Settings,
    begin: int,
    size: int,
    about: tuple[Array, Array] | None = None,
) -> tuple[Followed, Filtered]:
    """Run the filter over the events of one call."""
    if settings.watch is not None and about is None:
        # The placeholder keeps the structure of the arguments, so that one program is compiled.
        nowhere = jnp.full((_CHUNK, followed.state.mean.shape[0]), jnp.nan)
        near: Any = (nowhere, nowhere)
    else:
        near = _some(about, begin, size)
    how = (settings.estimated, settings.gate, settings.blind, near, jnp.asarray(size))
    return filtered(system, followed, _some(events, begin, size), *how)


def followed_through(
    system: System,
    start: Gaussian | Followed,
    events: Events,
    settings: Settings,
    about: tuple[Array, Array] | None = None,
) -> tuple[Followed, Filtered]:
    """Run the filter over all events without acting on suspected changes.

    Returns:
        The state of the filter after all events, and the results for each event.
    """
    followed = start if isinstance(start, Followed) else begun_with(system, start, settings.watch)
    parts = []
    for begin, size in _calls(len(events.values)):
        followed, found = _one_call(system, followed, events, settings, begin, size, about)
        parts.append(_first(found, size))
    rows: Filtered = _joined(parts)
    return followed, rows


class Course(NamedTuple):
    """Result of `watched_through`.

    Attributes:
        rows: results of the filter for each event.
        seconds: computing time per event, s.
        changes: detected changes.
        events: events that allow for these changes.
    """

    rows: Filtered
    seconds: float
    changes: tuple[Change, ...]
    events: Events


def watched_through(tracked: TrackedArm, start: Gaussian, plan: Plan, settings: Settings) -> Course:
    """Run the filter over all events, and act on detected changes.

    After a detection, the filter returns to the time of the change, and the uncertainty of the
    parameter is reset to its initial value at that time. The reported states between the change and
    its detection remain those from before the detection.
    """
    times, events, count = plan.times, plan.events, len(plan.times)
    parts: list[Filtered] = []
    # The latest results, from which the filter restarts after a change.
    latest: list[Filtered] = []
    changes: list[Change] = []
    seconds = []
    followed, begin = begun_with(tracked, start, settings.watch), 0
    while begin < count:
        size = min(_CHUNK, count - begin)
        begun = clock.perf_counter()
        last, found = jax.block_until_ready(
            _one_call(tracked, followed, events, settings, begin, size)
        )
        seconds.append((clock.perf_counter() - begun) / size)
        watch, suspected = settings.watch, found.suspected
        squares = np.zeros(size) if suspected is None else suspected.square[:size]
        far = np.flatnonzero(squares > CHANGED**2)
        if watch is None or suspected is None or not far.size:
            parts.append(_first(found, size))
            latest.append(parts[-1])
            followed, begin = last, begin + size
            continue
        at = int(far[0])
        parts.append(_first(found, at + 1))
        latest.append(parts[-1])
        end = begin + at
        since = since_when(times[: end + 1], float(times[end]), float(suspected.age[at]))
        direction = watch.directions[int(suspected.which[at])]
        index = int(jnp.argmax(jnp.abs(direction)))
        changes.append(
            Change(
                tracked.paths[index - tracked.slices()["parameters"].start],
                float(times[since]),
                float(times[end]),
                float(suspected.size[at]),
                float(suspected.deviation[at]),
            )
        )
        assert events.learning is not None
        loosened = events.learning.loosened.at[since + 1].add(direction)
        events = events._replace(learning=events.learning._replace(loosened=loosened))
        before = _first(_joined(latest), since + 1)
        known = _taken(before, -1)
        again = Followed(known.state, known.left_out, watch)
        between = _taken(events, slice(since + 1, end + 1))
        followed, after = followed_through(tracked, again, between, settings)
        latest, begin = [before, after], end + 1
    return Course(_joined(parts), min(seconds), tuple(changes), events)


def since_when(times: Sequence[float] | np.ndarray, now: float, age: float) -> int:
    """Return the index of the event that was `age` seconds ago, but not of the last event."""
    place = bisect.bisect_right(times, now - age + 1e-9) - 1
    return min(max(place, 0), len(times) - 2)


def smoothed_through(rows: Filtered) -> Gaussian:
    """Run the smoother over all events."""
    after: Any = _taken(rows.state, -1)
    parts: list[Gaussian] = [jax.tree.map(lambda leaf: leaf[None], after)]
    given = _first(rows.state, -1), _taken(rows.motion, slice(1, None))
    for begin, size in reversed(_calls(len(rows.state.mean) - 1)):
        states, motions = _some(given, begin, size)
        found = smoothed_states(after, states, motions, jnp.arange(_CHUNK) < size)
        after = _taken(found, 0)
        parts.append(_first(found, size))
    whole: Gaussian = _joined(parts[::-1])
    return whole


def _moving_at_some_time(events: Events) -> Events:
    """Return events that all allow the estimation of parameters, if any of them does.

    The filter is linearised about its current estimate and must therefore not estimate parameters
    at rest. The linearisation about smoothed states is also accurate at rest.
    """
    learning = events.learning
    if learning is None:
        return events
    moves = jnp.broadcast_to(jnp.any(learning.moves), learning.moves.shape)
    return events._replace(learning=learning._replace(moves=moves))


def linearised_again(
    system: System, start: Gaussian | Followed, events: Events, settings: Settings, rows: Filtered
) -> tuple[Gaussian, Filtered]:
    """Return smoothed and filtered states, relinearised about the smoothed states.

    The iteration ends when the parameters have converged. A first iteration may overshoot and
    reduce the likelihood, which the next one corrects. The result is the last iteration whose
    likelihood is about as high as that of any earlier one.
    """
    smooth = smoothed_through(rows)
    if settings.watch is None:
        return smooth, rows
    kept, most = (smooth, rows), log_likelihood_of(rows)
    directions = settings.watch.directions
    for _ in range(_ROUNDS):
        mean = smooth.mean
        # There is no smoothed state before the first interval.
        about = (jnp.concatenate([jnp.full_like(mean[:1], jnp.nan), mean[:-1]]), mean)
        _, again = followed_through(system, start, events, settings, about)
        better = smoothed_through(again)
        if not np.all(np.isfinite(better.mean)):
            break
        likelihood = log_likelihood_of(again)
        if likelihood > most - _WORSE:
            kept, most = (better, again), max(most, likelihood)
        far = jnp.abs((better.mean - smooth.mean) @ directions.T)
        smooth = better
        if jnp.all(far < _STAYS * jnp.linalg.norm(directions @ better.root, axis=-1)):
            break
    return kept


def log_likelihood_of(rows: Filtered) -> float:
    """Return the log-likelihood of all measurements together."""
    return float(jnp.sum(rows.innovation.log_likelihood))


def _of_each(function: Callable[..., Any], tracked: TrackedArm, rows: Any) -> Any:
    calls = _calls(len(jax.tree.leaves(rows)[0]))
    return _joined([_first(function(tracked, *_some(rows, *call)), call[1]) for call in calls])


def _ahead(tracked: TrackedArm, plan: Plan, states: Gaussian, late: float) -> Gaussian:
    """Predict each state `late` seconds ahead."""
    count = max(int(np.ceil(late / _AHEAD - 1e-9)), 1)
    edges = plan.times[:, None] + np.linspace(0.0, late, count + 1)[None]
    found: Gaussian = _of_each(predicted, tracked, (states, plan.held(edges[:, :-1], edges[:, 1:])))
    return found
