"""Filter for measurements that arrive one after another, late and out of order."""

import bisect
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar, cast

import jax.numpy as jnp
import numpy as np

from ...fitting import FitResult, arm_model_of
from ...models import AbstractModel
from ...recordings import Channel
from ...runtime.arrays import Array
from ...runtime.parallel import stacked_items
from ...runtime.text import InputError
from ._arm import Held, TrackedArm, tracked_arm
from ._filter import Gaussian
from ._rounds import (
    GATE,
    Events,
    Filtered,
    Followed,
    Learning,
    Motion,
    Suspected,
    System,
    followed_by,
    watching,
)
from ._track import (
    CHANGED,
    LATELY,
    SHORT,
    Change,
    Settings,
    States,
    Unknown,
    as_states,
    begun_with,
    delays_of,
    estimated_states,
    followed_through,
    has_own_wind,
    linearised_again,
    moving,
    since_when,
    starts,
    usual_torque,
    watched_parameters,
    with_errors_of,
)

Kept = TypeVar("Kept", bound=System)


class _Clone(NamedTuple):
    """State of the filter after an event."""

    time: float
    event: Events
    followed: Followed


_WINDOW = 60.0  # duration within which a change of an estimated parameter can be detected, s
_BEFORE = 20  # additional earlier rows for the detection of motion, to include rarely measured ones
_FIRST_PAUSE = 10.0  # time before the first relinearisation, s; doubled each time


class DelayedFilter(Generic[Kept]):
    """Kalman filter that keeps copies of past states to process late measurements.

    A measurement that is older than the last one updates the state of its time, and the later
    measurements are then processed again. The state is therefore the same as for measurements that
    arrive in order.

    If states are watched, the filter also detects changes of these states. After a detection, it
    returns to the time of the change and continues with the initial uncertainty of that state. In
    addition, all kept states are relinearised about the smoothed states after 10 s, 30 s, 70 s and
    so on.

    Arguments:
        system: system that is tracked.
        time: time of the start, s.
        start: initial estimate.
        interval: function that returns the known inputs of an interval from its beginning and
            end, s.
        longest: longest interval of the filter, s.
        history: duration for which states are kept, s; older measurements are lost.
        gate: innovation, in standard deviations, above which a measurement is not used.
        estimated: whether each state is estimated; defaults to all states.
        corners: function that returns the times within an interval at which the known inputs are
            not linear; by default there are none.
        watched: directions of the states that may change, each scaled by the standard deviation of
            such a change, shape (change, state); None for no detection.
    """

    def __init__(
        self,
        system: Kept,
        time: float,
        start: Gaussian,
        interval: Callable[[float, float], Any],
        *,
        longest: float = 0.1,
        history: float = 5.0,
        gate: float = GATE,
        estimated: Array | None = None,
        corners: Callable[[float, float], list[float]] | None = None,
        watched: Array | None = None,
    ) -> None:
        self.system = system
        self.lost = 0
        self.changes: list[tuple[float, float, Suspected]] = []
        self._interval = interval
        self._corners = corners or (lambda begin, end: [])
        self._longest, self._history = longest, history
        self._gate = jnp.asarray(gate, float)
        states = start.mean.shape[0]
        self._estimated = jnp.ones(states, bool) if estimated is None else estimated
        self._nothing = np.full(system.noise.shape[0], np.nan)
        self._noise = np.asarray(system.noise)
        self._watched = watched
        # All rows that are kept, in order of time.
        self._times: list[float] = []
        self._rows: list[np.ndarray] = []
        self._pause = _FIRST_PAUSE
        self._again = time + self._pause
        self._last: Filtered | None = None
        begun = begun_with(system, start, None if watched is None else watching(watched))
        self._clones = [_Clone(time, self._event(time, time + longest, self._nothing), begun)]

    @property
    def time(self) -> float:
        """Time of the last measurement, s."""
        return self._clones[-1].time

    @property
    def state(self) -> Gaussian:
        """Estimate at the time of the last measurement."""
        return self._clones[-1].followed.state

    def measure(self, time: float, values: Any) -> Filtered | None:
        """Process the measurements of one time.

        Arguments:
            time: time of exposure, s.
            values: value of each channel, SI units; NaN if it was not measured.

        Returns:
            The result of the filter for these measurements, or None if they are older than the
            history and therefore lost.

        Raises:
            InputError: the number of values is not the number of channels, or the time is not a
                finite number.
        """
        if not np.isfinite(time):
            raise InputError(f"the time of the measurements is {time} s: give a finite number")
        values = np.asarray(values, float)
        if values.shape != self._nothing.shape:
            raise InputError(
                f"a row of {values.size} measurements is given for {self._nothing.size} channels: "
                "give one for each channel, and NaN where nothing was measured"
            )
        place = bisect.bisect_right(self._clones, time, key=_time)
        # Two measurements of the same time are successive events without an interval.
        if place == 0:
            self.lost += 1
            return None
        row = bisect.bisect_right(self._times, time)
        self._times.insert(row, time)
        self._rows.insert(row, values)
        later = self._clones[place:]
        del self._clones[place:]
        self._go_on(time, values)
        found = self._last
        self._repeat(later)
        if self._watched is not None:
            self._look(self._watched)
        self._forget()
        return found

    def ahead(self, time: float) -> Gaussian:
        """Predict the state at a later time, s, from all measurements; the filter is not changed.

        Raises:
            InputError: the time is before the last measurement.
        """
        if not self.time <= time < np.inf:
            raise InputError(
                f"a state is requested at {time} s, before the last measurement at {self.time} s: "
                "give a time that is not earlier"
            )
        begin, followed = self.time, self._clones[-1].followed
        for end in self._ends(begin, time):
            followed, _ = self._after(followed, self._event(begin, end, self._nothing))
            begin = end
        return followed.state

    def _moves(self, time: float) -> bool:
        """Return whether the system has recently moved, at the time of a measurement."""
        end = bisect.bisect_right(self._times, time)
        begin = max(min(bisect.bisect_left(self._times, time - LATELY), end) - _BEFORE, 0)
        some = (np.array(self._times[begin:end]), np.array(self._rows[begin:end]))
        return bool(moving(*some, self._noise)[-1])

    def _go_on(self, time: float, values: np.ndarray) -> None:
        begin = self._clones[-1].time
        ends = self._ends(begin, time)
        for end in ends:
            event = self._event(begin, end, values if end == ends[-1] else self._nothing)
            self._follow(end, event)
            begin = end

    def _repeat(self, clones: list[_Clone]) -> None:
        """Process the events of clones again; the interval of the first one has changed."""
        for clone in clones[:1]:
            there = np.asarray(clone.event.there)
            self._go_on(clone.time, np.where(there, clone.event.values, np.nan))
        for clone in clones[1:]:
            self._follow(clone.time, clone.event)

    def _follow(self, time: float, event: Events) -> None:
        followed, self._last = self._after(self._clones[-1].followed, event)
        self._clones.append(_Clone(time, event, followed))

    def _look(self, watched: Array) -> None:
        """Handle a detected change of a state, and relinearise if it is time to."""
        suspected = None if self._last is None else self._last.suspected
        if suspected is not None and float(suspected.square) > CHANGED**2:
            times = [clone.time for clone in self._clones]
            since = since_when(times, self.time, float(suspected.age))
            self.changes.append((times[since], self.time, suspected))
            later = self._clones[since + 1 :]
            del self._clones[since + 1 :]
            self._repeat(later)
            self._pause = _FIRST_PAUSE
            self._again = self.time + self._pause
        elif self.time >= self._again:
            self._pause *= 2
            self._again = self.time + self._pause
            self._linearise()

    def _linearise(self) -> None:
        """Relinearise all kept states about the smoothed states."""
        kept = self._clones[1:]
        if len(kept) < 2:
            return
        begun = self._clones[0].followed
        events: Events = stacked_items([clone.event for clone in kept])
        settings = Settings(self._estimated, self._gate, jnp.asarray(False), begun.watch)
        _, rows = followed_through(self.system, begun, events, settings)
        _, rows = linearised_again(self.system, begun, events, settings, rows)
        mean, root = np.asarray(rows.state.mean), np.asarray(rows.state.root)
        left_out = np.asarray(rows.left_out)
        for index, clone in enumerate(kept):
            state: Any = Gaussian(mean[index], root[index])
            followed = clone.followed._replace(state=state, left_out=left_out[index])
            self._clones[index + 1] = clone._replace(followed=followed)

    def _ends(self, begin: float, end: float) -> list[float]:
        ends = []
        for corner in [*self._corners(begin, end), end]:
            count = max(int(np.ceil((corner - begin) / self._longest - 1e-9)), 1)
            ends += [*np.linspace(begin, corner, count + 1)[1:-1].tolist(), corner]
            begin = corner
        return ends

    def _event(self, begin: float, end: float, values: np.ndarray) -> Events:
        there = np.isfinite(values)
        learning = None
        if self._watched is not None:
            moves = bool(there.any()) and self._moves(end)
            given: Any = (np.asarray(end - begin), np.asarray(moves), self._loosened(begin, end))
            learning = Learning(*given)
        # Use NumPy, because creating small JAX arrays a hundred times per second is slow.
        seen: Any = np.where(there, values, 0.0)
        return Events(self._interval(begin, end), seen, cast("Any", there), learning)

    def _loosened(self, begin: float, end: float) -> np.ndarray:
        """Return the additional root of the covariance for changes in an interval."""
        assert self._watched is not None
        found = np.zeros(self._watched.shape[1])
        for time, _, suspected in self.changes:
            if begin <= time < end:
                found += np.asarray(self._watched[int(suspected.which)])
        return found

    def _after(self, before: Followed, event: Events) -> tuple[Followed, Filtered]:
        return followed_by(self.system, before, event, self._estimated, self._gate)

    def _forget(self) -> None:
        old = self.time - self._history
        del self._clones[: max(bisect.bisect_right(self._clones, old, key=_time) - 1, 0)]
        # Keep earlier rows too, for the detection of motion at the oldest events.
        gone = bisect.bisect_left(self._times, self._clones[0].time - LATELY) - _BEFORE
        del self._times[: max(gone, 0)], self._rows[: max(gone, 0)]


def _time(clone: _Clone) -> float:
    return clone.time


class _Initial(NamedTuple):
    angle: np.ndarray
    rate: np.ndarray


class Tracker:
    """Tracker of an arm, which processes rows of commands and measurements one after another.

    The delays of the sensors (`camera.delay`, `encoder.delay`) are the times between the exposure
    of a row and its time stamp. Rows may be late and out of order.

    Arguments:
        model: model of the arm, or a fit of it, whose parameters are then consider parameters.
        noise: name of each measured channel -> standard deviation of its noise, SI units.
        unknown: unknown quantities in addition to the motion.
        time: time of the start, s.
        command: commanded angles at the start, rad, shape (joint,); defaults to 0.
        angles, rates: angles and rates of the joints at the start, rad and rad/s; without angles,
            the arm is at rest in its wind.
        wind: known constant wind, m/s, shape (3,), in addition to that of the arm; defaults to
            still air.
        held: whether a command is held until the next one; by default it is interpolated linearly.
        history: largest delay of a row, s; at least 60 if parameters are estimated.
        gate: innovation, in standard deviations, above which a measurement is not used.

    Raises:
        InputError: the model is not that of an arm, a channel does not belong to it, or the wind is
            both known and tracked.

    Example:
        >>> import giajax
        >>> model = giajax.ArmModel(giajax.takeichi_20m_full(2))
        >>> tracker = giajax.Tracker(model, noise={"tip_z": 0.01})
        >>> for row in range(5):
        ...     _ = tracker.update({"time": 0.1 * row, "joint01_command": 0.01, "tip_z": 0.0})
        >>> tracker.now(0.6).tip.shape
        (1, 3)
    """

    def __init__(
        self,
        model: AbstractModel | FitResult,
        *,
        noise: Mapping[str, float],
        unknown: Unknown | None = None,
        time: float = 0.0,
        command: Any | None = None,
        angles: Any | None = None,
        rates: Any | None = None,
        wind: Any | None = None,
        held: bool = False,
        history: float = 5.0,
        gate: float = GATE,
    ) -> None:
        stated = arm_model_of(model)
        given = with_errors_of(model, Unknown() if unknown is None else unknown)
        if not noise or not all(size > 0 for size in noise.values()):
            raise InputError(
                "the noise of a tracker must be a positive number in SI units for at least one "
                "channel: give it, such as noise={'tip_x': 0.02}"
            )
        self.arm: TrackedArm = tracked_arm(
            stated,
            list(noise),
            noise,
            air=given.air,
            biases=given.biases,
            paths=(*given.considered, *given.estimated),
            torque=usual_torque(stated) if given.torque is None else given.torque,
            ties=given.ties,
        )
        self._delays = delays_of(stated, list(noise))
        count = self.arm.joints
        rest = np.zeros(count)
        first = rest if command is None else _row("command", command, count)
        self._free = tuple(given.estimated)
        self._knots = [float(time)]
        self._commands = [first]
        history = max(history, _WINDOW) if given.estimated else history
        self._history = history
        initial = _Initial(
            rest if angles is None else _row("angles", angles, count),
            rest if rates is None else _row("rates", rates, count),
        )
        if given.air is not None and (wind is not None or has_own_wind(stated)):
            raise InputError(
                "the wind of the arm is given: remove it, or do not track a wind (Unknown.air)"
            )
        known = np.zeros(0 if given.air is None else 3)
        self._wind = known if wind is None else _row("components of the wind", wind, 3)
        self._stays = held
        self._found: list[Filtered] = []
        estimated = estimated_states(self.arm, given)
        nothing = jnp.zeros(len(noise))
        watched = watched_parameters(self.arm, given)
        watch, learning = None, None
        if watched is not None:
            watch = watching(watched)
            never = (jnp.asarray(SHORT), jnp.asarray(False), jnp.zeros(self.arm.size))
            learning = Learning(*never)

        def motion(start: Gaussian, held: Held) -> Motion:
            event = Events(held, nothing, nothing > 0, learning)
            begun = begun_with(self.arm, start, watch)
            _, found = followed_by(self.arm, begun, event, estimated, jnp.asarray(gate, float))
            return found.motion

        start = (self.arm, self._held(time - SHORT, time), given, initial, motion)
        found = [] if angles is not None else starts(*start, rest=(True,))
        begun = (found or starts(*start, rest=(False,)))[0]
        self.filter: DelayedFilter[TrackedArm] = DelayedFilter(
            self.arm,
            time,
            begun,
            self._held,
            history=history,
            gate=gate,
            estimated=estimated,
            corners=self._corners,
            watched=watched,
        )

    def update(self, row: Mapping[str, float]) -> States:
        """Process a row, and return the estimate at the time of the last measurement.

        Commands of a row that is older than the last one are ignored.

        Arguments:
            row: `time`, the time stamp, s; commanded angles of joints by name (`joint01_command`,
                rad), where omitted ones stay the same; and measured channels, SI units, which can
                be NaN or omitted.

        Raises:
            InputError: the row has no time, or a name that is neither a command nor a measured
                channel.
        """
        if "time" not in row or not np.isfinite(row["time"]):
            raise InputError("a row has no time: give its time stamp in s")
        stamp = float(row["time"])
        command = self._commands[-1].copy()
        groups: dict[float, np.ndarray] = {}
        for name, value in row.items():
            if name == "time":
                continue
            channel = Channel.named(name)
            if channel.kind == "joint_command" and (channel.index or 0) <= self.arm.joints:
                if np.isfinite(value):
                    command[(channel.index or 1) - 1] = value
            elif name in self.arm.channels:
                late = self._delays[name]
                values = groups.setdefault(late, np.full(len(self.arm.channels), np.nan))
                values[self.arm.channels.index(name)] = value
            else:
                raise InputError(
                    f"'{name}' is neither a command of the arm nor a channel of the tracker: give "
                    "its noise, or omit it"
                )
        if stamp > self._knots[-1]:
            self._knots.append(stamp)
            self._commands.append(command)
        elif stamp == self._knots[-1]:
            self._commands[-1] = command
        self._found = []
        for late in sorted(groups, reverse=True):
            if np.any(np.isfinite(groups[late])):
                measured = self.filter.measure(stamp - late, groups[late])
                self._found += [] if measured is None else [measured]
        old = self.filter.time - 2 * self._history
        while len(self._knots) > 2 and self._knots[1] < old:
            del self._knots[0], self._commands[0]
        return self._states(self.filter.state)

    def now(self, time: float | None = None) -> States:
        """Predict the state at a time after the last measurement, s, with the last command.

        The time defaults to that of the last row.

        Raises:
            InputError: the time is before the last measurement.
        """
        ahead = max(self._knots[-1], self.filter.time) if time is None else float(time)
        return self._states(self.filter.ahead(ahead))

    @property
    def changes(self) -> tuple[Change, ...]:
        """Detected changes of estimated parameters."""
        return tuple(
            Change(
                self._free[int(found.which)],
                time,
                seen,
                float(found.size),
                float(found.deviation),
            )
            for time, seen, found in self.filter.changes
        )

    @property
    def innovation(self) -> np.ndarray:
        """Whitened innovations of the last row, with standard deviation 1, shape (channel,).

        A channel that was not measured, was lost, or is an outlier has the value 0.
        """
        none = np.zeros(len(self.arm.channels))
        return none + sum(np.asarray(each.innovation.whitened) for each in self._found)

    @property
    def used(self) -> np.ndarray:
        """Whether each channel of the last row was used, shape (channel,)."""
        none = np.zeros(len(self.arm.channels), bool)
        return none | np.any([none, *(np.asarray(each.used) for each in self._found)], axis=0)

    def _states(self, state: Gaussian) -> States:
        return as_states(self.arm, Gaussian(state.mean[None], state.root[None]))

    def _held(self, begin: float, end: float) -> Held:
        command = [self._command(begin), self._command(begin if self._stays else end)]
        wind = np.tile(self._wind, (2, 1))
        # Two measurements of the same time have an interval of 0, by which slopes must not be
        # divided.
        known: Any = (begin, max(end - begin, SHORT), np.stack(command), wind)
        given: Any = [np.asarray(each, float) for each in known]
        return Held(*given)

    def _corners(self, begin: float, end: float) -> list[float]:
        """Return the knots within an interval at which the command or its slope jumps."""
        first = bisect.bisect_right(self._knots, begin + _APART)
        last = bisect.bisect_left(self._knots, end - _APART)
        found = []
        for place in range(max(first, 1), last):
            rows, knots = self._commands[place - 1 : place + 2], self._knots[place - 1 : place + 2]
            slopes = np.diff(rows, axis=0) / np.diff(knots)[:, None]
            bends = slopes[0] if self._stays else slopes[-1] - slopes[0]
            if np.any(np.abs(bends) > 1e-9):
                found.append(knots[1])
        return found

    def _command(self, time: float) -> np.ndarray:
        """Return the command at a time, held or interpolated between knots; the nearest outside."""
        place = bisect.bisect_right(self._knots, time)
        if place in (0, len(self._knots)):
            return self._commands[min(place, len(self._knots) - 1)]
        before, after = self._knots[place - 1 : place + 1]
        share = 0.0 if self._stays else (time - before) / (after - before)
        return (1 - share) * self._commands[place - 1] + share * self._commands[place]


_APART = 1e-6  # smallest difference of two distinct times, s


def _row(name: str, values: Any, count: int) -> np.ndarray:
    row = np.asarray(values, float)
    if row.shape != (count,):
        raise InputError(f"the {name} have shape {row.shape}: give {count} numbers in one row")
    return row
