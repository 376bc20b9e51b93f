"""A recorded run tracked: where the arm was, and what a controller would have known of it."""

import bisect
import dataclasses
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
from ...runtime.arrays import Array, Float, scaled
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
"""Default unmodelled torque, as a share of the mean stiffness (white noise), root(s)."""

_LONGEST = 0.1  # between two events, s
SHORT = 1e-9  # the interval before the first event, s, by which slopes are divided
_AHEAD = 0.25  # of an interval in which nothing is measured, s
_DOUBLINGS = 13  # of an interval of the filter, which an arm has stood at the start: 14 minutes
# Events of one call, so that runs of every length have the same programs; after some of them the
# start is chosen that explains them best.
_CHUNK, _DECIDES = 100, 200
_MOST = 5e7  # numbers of one of some eight kinds that are kept: 3 GB
CHANGED = 6.0
"""Number of standard deviations from which a change of a parameter is reported."""
SHOWN = 0.9
"""Share of its initial deviation above which a state counts as hardly observed."""
_ROUNDS, _STAYS = 3, 0.02  # of linearising once more, until a parameter moves by less deviations
_WORSE = 1.0  # of the log-likelihood, by which a round may be, as it is linearised elsewhere
# Of the state at the start: of an arm that has come to rest, and of one that starts as stated.
_AT_REST = np.deg2rad([1.0, 0.3])
_STATED = np.deg2rad([2.0, 1.0])


@dataclasses.dataclass(frozen=True)
class Unknown:
    """What is unknown beside the motion of the arm.

    Attributes:
        air: the wind; None where that of the run is known, or the air is still.
        biases: of sensors.
        considered: standard deviations (SI) of parameters by path, whose uncertainty counts and
            which are not estimated.
        correlation: between them; None: none.
        estimated: of those that are estimated, too.
        torque: unmodelled torque of each joint, as white noise, N m root(s); None: a default.
        ties: expressions by the path of the parameter that follows from others, as of a fit.
        at_start: standard deviations of all angles and rates then, rad and rad/s; None: 2 degrees
            and 1 degree/s about what the run states, 1 and 0.3 where the arm has come to rest.
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
    """A state over time, with its deviations.

    Attributes:
        angles: of the joints, rad, shape (time, joint).
        rates: of the joints, rad/s, likewise.
        tip: m, shape (time, 3).
        ends: of the links, m, shape (time, link, 3); the last one is the tip.
        wind: mean over the links of the wind that is unknown, m/s, shape (time, 3), or None.
        parameters: uncertain ones by path, SI, considered or estimated.
        biases: SI, shape (time, bias).
        angle_deviations: standard deviations, as the values; so are the next ones.
        rate_deviations: of the rates.
        tip_deviations: of the tip.
        end_deviations: of the ends of the links.
        wind_deviations: of the wind.
        parameter_deviations: of the parameters.
        bias_deviations: of the biases.
        mean: the whole state.
        root: of its covariance.
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
    """A parameter that has changed while the arm moved.

    Attributes:
        path: of the parameter.
        time: about when it changed, s.
        found: at the exposure of which measurement that was seen, s.
        size: by which it changed, SI, as seen then.
        deviation: of that.
    """

    path: str
    time: float
    found: float
    size: float
    deviation: float


@dataclasses.dataclass(frozen=True)
class Track:
    """A run tracked; made by `track`.

    Attributes:
        arm: what was tracked.
        unknown: of it.
        times: s, shape (event,): of all exposures, and of times between two that are far apart.
        filtered: by what was measured until each time.
        smoothed: by the whole run.
        now: what the filter expects of the time at which a measurement comes, by what was exposed
            until it was; None without a delay.
        now_times: of these, s.
        latency: after the stamp, s.
        there: which channels were measured, shape (event, channel).
        used: which counted.
        off: measured minus expected, SI.
        expected: deviation of that, SI.
        whitened: what counted of that, as independent numbers of deviation 1.
        nis: of each event, the square of all that was measured over what is expected.
        log_likelihood: of the measurements of each event.
        noise: standard deviation of each channel, SI, by name.
        gate: as given.
        start: what was known at the start.
        seconds: that the filter takes for an event, without compiling.
        changes: of estimated parameters; from when one was found the filter allows for it, from
            when it happened the smoother does.
        loosened: how many times the usual unmodelled torque it took to follow the run, where no
            torque was stated.
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
    """Standard errors of the arm's parameters that a fit found, by path, and their correlation."""
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
    """With the errors of a fit considered, where nothing else is."""
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
    """The arm of a run and what is unknown of it: of a fit, as it is for that run, and its errors.

    Raises:
        InputError: it is not an arm.
    """
    unknown = with_errors_of(model, Unknown() if unknown is None else unknown)
    return arm_model_of(model.model_of(run) if isinstance(model, FitResult) else model), unknown


def has_own_wind(model: ArmModel) -> bool:
    """Whether the arm states a wind, beside that of a run."""
    return model.arm.air.wind is not None or model.arm.air.wind_field is not None


def delays_of(model: ArmModel, channels: Sequence[str]) -> dict[str, float]:
    """How late each channel shows the arm, s."""
    sensors, found = model.sensors, {}
    for name in channels:
        channel = Channel.named(name)
        if channel.quantity == "pixel":
            delay: Any = clock_of(sensors, camera_of(sensors, channel))
        else:
            # As a prediction has it: what shows a row has the clock.
            rows = sensors.rows({channel.kind})
            delay = getattr(rows[channel.kind][1], "delay", None) if rows else None
        found[name] = 0.0 if delay is None else float(delay)
    return found


def noise_of(run: Run, channels: Sequence[str], result: FitResult | None) -> dict[str, float]:
    """Standard deviation of each channel, SI: as the run states it, or as the fit found it.

    Raises:
        InputError: neither says one.
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
                f"the noise of {name} of '{run.name}' is unknown: state it in [noise], or give a "
                "fit with --model"
            )
        found[name] = float(stated)
    return found


@dataclasses.dataclass(frozen=True)
class Plan:
    """The events of a run, and what is known of any interval of it.

    Attributes:
        times: of the events, s.
        events: for the filter.
        command: over time.
        wind: over time; None in still air.
        width: of the wind where it is unknown, 3, or 0.
    """

    times: np.ndarray
    events: Events
    command: Signal
    wind: Signal | None
    width: int

    def held(self, begin: np.ndarray, end: np.ndarray) -> Held:
        """What is known of intervals; a jump at their end is not one of them."""
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
    # Before its first knot a signal has the value there.
    since = np.maximum(times.ravel() - knots[at], 0.0)
    return (values[at] + since[:, None] * slopes[at]).reshape(*times.shape, width)


def planned(model: ArmModel, run: Run, channels: Sequence[str], *, unknown_air: bool) -> Plan:
    """The exposures of a run in their order, with steps between those that are far apart.

    Raises:
        InputError: a run that is driven otherwise than by commanded angles.
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
    # The run says how the arm is at its first row; what was exposed before is of no use.
    first = round(float(run.times[0]), 9)
    exposures = np.array([first, *(each for each in sorted(rows) if each > first)])
    if len(exposures) < 2:
        raise InputError(f"'{run.name}' has no measurement after its first row: give a longer run")
    # A command that bends within an interval would be straight in it.
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
    """Angles (rad) at which an arm rests under a command in a wind; None where none are found."""
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
    """What may be known of the arm at the start, of which `held` is the first interval.

    It starts as stated, or has come to rest long ago; and the mean flow is what it is guessed to
    be, or the opposite of it, about which drag has another slope. `motion` is that of a state.
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
                if not size_of < np.pi:  # no rest that it stays at
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
    """Ends of the links and mean wind of a state, and their deviations."""

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
    """Distributions of the whole state as what they are of."""
    if len(states.mean) == 1:  # of a tracker, which is asked after each row
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
    """The default of the unmodelled torque, N m root(s)."""
    joints = model.arm.joints
    return STIFFNESS_SHARE * float(
        np.mean([*joints.pitch_stiffness.ravel(), *joints.yaw_stiffness.ravel()])
    )


def estimated_states(tracked: TrackedArm, unknown: Unknown) -> Array:
    """Which states measurements change: all but the parameters that are considered."""
    first = tracked.slices()["parameters"].start
    places = np.arange(tracked.size) - first
    return jnp.asarray((places < 0) | (places >= len(unknown.considered)))


class Settings(NamedTuple):
    """Of the filter over a run.

    Attributes:
        estimated: which states measurements change.
        gate: deviations; a measurement that is farther off does not count.
        blind: whether each measured value is taken to be the expected one.
        watch: for changes of parameters; None where none is estimated.
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
    """What is tracked, its events, the start that explains the first ones best, and settings.

    A `start` that is given is taken.

    Raises:
        InputError: a run that is too long for its states, or one that `planned` refuses.
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
        found: Motion = _row(rows.motion, 0)
        return found

    first: Any = _row(plan.events.held, 0)
    begins = starts(tracked, first, unknown, model.prepare(run).initial, motion)
    return tracked, plan, chosen(tracked, plan, begins, settings), settings


def watched_parameters(tracked: TrackedArm, unknown: Unknown) -> Array | None:
    """The estimated parameters, each as uncertain as at the start; None where there are none."""
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
    """Track a recorded run: its states with their deviations, filtered and smoothed.

    Arguments:
        model: the arm, or a fit of it, whose errors are then considered.
        run: with commands and measurements.
        unknown: what is unknown beside the motion; by default what the fit leaves open.
        latency: after its stamp a measurement is there, s, beside the delay of its clock.
        gate: deviations; a measurement that is farther off does not count for the state.
        channels: that are used; all that are measured by default.
        progress: called with a line now and then.

    Raises:
        InputError: a run of another model, without noise, or driven by something else.

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
            f"the latency is {latency:g} s and the gate {gate:g}: give a latency of 0 to 60 s and "
            "a positive gate"
        )
    noise = noise_of(run, names, result)
    say("estimating the initial state ...")
    # Where nobody says how much torque is unmodelled, a model that lacks more may have more of it:
    # what is followed can be judged.
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
            f"more unmodelled torque than {float(tracked.torque):.2g} (--torque), or compare model "
            "and wind with the run first (giajax fit)"
        )
    if not np.any(found.used):
        raise InputError(
            f"no measurement of '{run.name}' is accepted, because each deviates by more than "
            f"{gate:g} standard deviations: "
            "compare the model with the run first (giajax fit), or allow more (--gate)"
        )
    say("smoothing ...")
    every = settings._replace(estimated=jnp.ones_like(settings.estimated))
    if len(unknown.considered) or course.changes:
        # By the whole run, what is considered on the way is estimated.
        _, found = followed_through(tracked, begun, course.events, every)
    smooth, _ = linearised_again(tracked, begun, _moving_at_some_time(course.events), every, found)
    after = as_states(tracked, smooth)
    if not np.all(np.isfinite(after.mean)):
        raise InputError(
            f"the smoothed state of '{run.name}' is not finite: allow more unmodelled torque, or "
            "compare the model with the run first (giajax fit)"
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
    """Noise with a memory that a run states, as a bias that changes; each channel has its own."""
    found = []
    for name in names:
        stated = run.correlated_noise(name)
        if stated is not None and stated[0] > 0:
            found.append(Bias((name,), stated[0], stated[1]))
    return found


def chosen(
    tracked: TrackedArm, plan: Plan, begins: Sequence[Gaussian], settings: Settings
) -> Gaussian:
    """The start that explains the first measurements best."""
    events = _first(plan.events, _DECIDES)
    best, most = begins[0], -np.inf
    for start in begins if len(begins) > 1 else ():
        _, found = followed_through(tracked, start, events, settings)
        likely = log_likelihood_of(found)
        if likely > most:
            best, most = start, likely
    return best


def begun_with(system: System, start: Gaussian, watch: Watch | None = None) -> Followed:
    """A filter that begins."""
    return Followed(start, jnp.zeros(system.noise.shape[0], int), watch)


def _calls(count: int) -> list[tuple[int, int]]:
    """Where each call for so many rows begins, and how many of them it has."""
    return [(begin, min(_CHUNK, count - begin)) for begin in range(0, count, _CHUNK)]


def _some(rows: Any, begin: int, size: int) -> Any:
    """As many rows as of each call; after `size` of them the last one is repeated."""
    at = np.minimum(np.arange(begin, begin + _CHUNK), begin + size - 1)
    return jax.tree.map(lambda leaf: leaf[at], rows)


def _first(rows: Any, size: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[:size], rows)


def _row(rows: Any, index: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], rows)


def _joined(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


LATELY, FEW = 10.0, 4
"""Time (s) and number of values before a measurement that decide whether the arm moves."""
_MOVES = 2.0  # times the noise, by which an arm that moves is seen to


def moving(times: np.ndarray, values: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Whether a channel has moved by more than its noise lately, at each time.

    Where none has, a parameter shows by products of errors only, which a linearised filter takes
    for more than they are. The middle one of three values counts, so that an outlier is not taken
    for motion.

    Arguments:
        times: s, in their order, shape (event,).
        values: SI, NaN of what was not measured, shape (event, channel).
        noise: standard deviations, SI, shape (channel,).
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
        # Of what is seldom measured, the last few.
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
    """The filter over some events."""
    if settings.watch is not None and about is None:
        # So that it is one program.
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
    """The filter after all events, and after each, whether or not something has changed."""
    followed = start if isinstance(start, Followed) else begun_with(system, start, settings.watch)
    parts = []
    for begin, size in _calls(len(events.values)):
        followed, found = _one_call(system, followed, events, settings, begin, size, about)
        parts.append(_first(found, size))
    rows: Filtered = _joined(parts)
    return followed, rows


class Course(NamedTuple):
    """What `watched_through` finds: a row for each event, s for each, changes, and events in which
    they are allowed for."""

    rows: Filtered
    seconds: float
    changes: tuple[Change, ...]
    events: Events


def watched_through(tracked: TrackedArm, start: Gaussian, plan: Plan, settings: Settings) -> Course:
    """The filter over all events; where a parameter has changed, it goes back to when it did.

    From that time on it follows the arm once more with a parameter that is as uncertain as at the
    start. States from then to when that was found stay as they were known.
    """
    times, events, count = plan.times, plan.events, len(plan.times)
    parts: list[Filtered] = []
    # The same as it is known by now, from where the filter goes back.
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
        seconds.append((clock.perf_counter() - begun) / _CHUNK)
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
        known = _row(before, -1)
        again = Followed(known.state, known.left_out, watch)
        between = jax.tree.map(lambda leaf, a=since + 1, b=end + 1: leaf[a:b], events)
        followed, after = followed_through(tracked, again, between, settings)
        latest, begin = [before, after], end + 1
    return Course(_joined(parts), min(seconds), tuple(changes), events)


def since_when(times: Sequence[float] | np.ndarray, now: float, age: float) -> int:
    """The event that was so long (s) before, which is not the last one."""
    place = bisect.bisect_right(times, now - age + 1e-9) - 1
    return min(max(place, 0), len(times) - 2)


def smoothed_through(rows: Filtered) -> Gaussian:
    """The smoother over all events."""
    after: Any = _row(rows.state, -1)
    parts: list[Gaussian] = [jax.tree.map(lambda leaf: leaf[None], after)]
    given = (_first(rows.state, -1), jax.tree.map(lambda leaf: leaf[1:], rows.motion))
    for begin, size in reversed(_calls(len(rows.state.mean) - 1)):
        states, motions = _some(given, begin, size)
        found = smoothed_states(after, states, motions, jnp.arange(_CHUNK) < size)
        after = _row(found, 0)
        parts.append(_first(found, size))
    whole: Gaussian = _joined(parts[::-1])
    return whole


def _moving_at_some_time(events: Events) -> Events:
    """Events of which all show parameters, if one does.

    The filter has to be told when nothing moves, as it is linearised about what it knows by then;
    about smoothed states what rests is as right as what moves.
    """
    learning = events.learning
    if learning is None:
        return events
    moves = jnp.broadcast_to(jnp.any(learning.moves), learning.moves.shape)
    return events._replace(learning=learning._replace(moves=moves))


def linearised_again(
    system: System, start: Gaussian | Followed, events: Events, settings: Settings, rows: Filtered
) -> tuple[Gaussian, Filtered]:
    """Smoothed and filtered states, linearised about the smoothed ones until parameters stay.

    A first round may go too far, and make the measurements less likely; the one after it then comes
    back. What counts is the last round in which they are about as likely as in any before.
    """
    smooth = smoothed_through(rows)
    if settings.watch is None:
        return smooth, rows
    kept, most = (smooth, rows), log_likelihood_of(rows)
    directions = settings.watch.directions
    for _ in range(_ROUNDS):
        mean = smooth.mean
        # Before the first interval there is no smoothed state.
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
    """Of all measurements together."""
    return float(jnp.sum(rows.innovation.log_likelihood))


def _of_each(function: Callable[..., Any], tracked: TrackedArm, rows: Any) -> Any:
    calls = _calls(len(jax.tree.leaves(rows)[0]))
    return _joined([_first(function(tracked, *_some(rows, *call)), call[1]) for call in calls])


def _ahead(tracked: TrackedArm, plan: Plan, states: Gaussian, late: float) -> Gaussian:
    """Each state so much later."""
    count = max(int(np.ceil(late / _AHEAD - 1e-9)), 1)
    edges = plan.times[:, None] + np.linspace(0.0, late, count + 1)[None]
    found: Gaussian = _of_each(predicted, tracked, (states, plan.held(edges[:, :-1], edges[:, 1:])))
    return found
