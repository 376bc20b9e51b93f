"""A filter whose measurements come late, one after the other, and out of their order."""

import bisect
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np

from ...fitting import FitResult, arm_model_of
from ...models import AbstractModel
from ...recordings import Channel
from ...runtime.arrays import Array
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
    """The state as it was after an event."""

    time: float
    event: Events
    followed: Followed


_WINDOW = 60.0  # s, in which a parameter that is estimated may have changed
_BEFORE = 20  # rows before those that are looked at, of which some are of every channel
_FIRST_PAUSE = 10.0  # s, before what is kept is linearised once more; then twice as long


class DelayedFilter(Generic[Kept]):
    """Clones of past states, of which a late measurement updates the one of its time.

    A measurement that is older than the last one goes to where it belongs: the state of that time
    is updated by it, and what was measured since then once more. So the state is what it would be
    had all measurements come in the order of their times.

    Where states are watched, a change of one is looked for, too; from when it happened the filter
    goes on with that state as uncertain as at the start. And what is kept is linearised once more,
    about the smoothed states, after 10 s, 30 s, 70 s and so on.

    Arguments:
        system: what is tracked.
        time: of the start, s.
        start: what is known then.
        interval: gives what is known of an interval by its beginning and end, s.
        longest: interval of the filter, s.
        history: how long states are kept, s; what comes later than that is lost.
        gate: deviations; a measurement that is farther off does not count.
        estimated: which states measurements change; all by default.
        corners: gives the times within an interval at which what is known of it bends; none by
            default.
        watched: directions of the states that may change, each as long as the deviation of such a
            change, shape (change, state); None: none does.
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
        # All rows that are kept, in the order of their times.
        self._times: list[float] = []
        self._rows: list[np.ndarray] = []
        self._pause = _FIRST_PAUSE
        self._again = time + self._pause
        self._last: Filtered | None = None
        begun = begun_with(system, start, None if watched is None else watching(watched))
        self._clones = [_Clone(time, self._event(time, time + longest, self._nothing), begun)]

    @property
    def time(self) -> float:
        """Of the last measurement, s."""
        return self._clones[-1].time

    @property
    def state(self) -> Gaussian:
        """At that time."""
        return self._clones[-1].followed.state

    def measure(self, time: float, values: Any) -> Filtered | None:
        """Take measurements of one time (s), SI, NaN of what was not measured.

        Returns:
            What they were beside, by what was measured before; None of what is older than the
            history, which is lost.

        Raises:
            InputError: a number of values that is not that of the channels, or a time that is not
                a number.
        """
        if not np.isfinite(time):
            raise InputError(f"the time of the measurements is {time} s: give a finite number")
        values = np.asarray(values, float)
        if values.shape != self._nothing.shape:
            raise InputError(
                f"a row of {values.size} measurements is given for {self._nothing.size} channels: "
                "give one for each channel, NaN where nothing was measured"
            )
        place = bisect.bisect_right(self._clones, time, key=_time)
        # Two measurements of one time are one event after the other, without an interval.
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
        """What is expected of a later time (s), by all that was measured; nothing is kept.

        Raises:
            InputError: a time before the last measurement.
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
        """Whether what is tracked has moved lately, of a time at which something was measured."""
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
        """What was measured then, once more; the first of these has another interval."""
        for clone in clones[:1]:
            there = np.asarray(clone.event.there)
            self._go_on(clone.time, np.where(there, clone.event.values, np.nan))
        for clone in clones[1:]:
            self._follow(clone.time, clone.event)

    def _follow(self, time: float, event: Events) -> None:
        followed, self._last = self._after(self._clones[-1].followed, event)
        self._clones.append(_Clone(time, event, followed))

    def _look(self, watched: Array) -> None:
        """Whether a state has changed, and whether it is time to linearise once more."""
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
        """What is kept once more, about its smoothed states."""
        kept = self._clones[1:]
        if len(kept) < 2:
            return
        begun = self._clones[0].followed
        events: Events = _stacked([clone.event for clone in kept])
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
        # Of NumPy: a hundred times in a second small arrays are slow in JAX.
        seen: Any = np.where(there, values, 0.0)
        return Events(self._interval(begin, end), seen, cast("Any", there), learning)

    def _loosened(self, begin: float, end: float) -> np.ndarray:
        """By what has changed at the beginning of an interval, or in it."""
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
        # Of these the oldest events ask whether anything moved before.
        gone = bisect.bisect_left(self._times, self._clones[0].time - LATELY) - _BEFORE
        del self._times[: max(gone, 0)], self._rows[: max(gone, 0)]


def _time(clone: _Clone) -> float:
    return clone.time


def _stacked(rows: list[Any]) -> Any:
    # By numpy: hundreds of small arrays are slow in JAX.
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *rows)


class _Initial(NamedTuple):
    angle: np.ndarray
    rate: np.ndarray


class Tracker:
    """Where an arm is, by rows of commands and measurements that come one after the other.

    The delays of its sensors (`camera.delay`, `encoder.delay`) say how much earlier than its stamp
    a row shows the arm. Rows may be late and out of order.

    Arguments:
        model: the arm, or a fit of it, whose errors are then considered.
        noise: standard deviation of each channel that is measured, SI, by name.
        unknown: what is unknown beside the motion.
        time: of the start, s.
        command: commanded angles then, rad, shape (joint,); 0 by default.
        angles, rates: of the joints then, rad and rad/s; without angles the arm has come to rest
            in its wind.
        wind: that is known and stays, m/s, shape (3,), beside that of the arm; still air by
            default.
        held: whether a command stays until the next one; it moves there on a line by default.
        history: how late a row may be, s; 60 at least where parameters are estimated.
        gate: deviations; a measurement that is farther off does not count.

    Raises:
        InputError: a model that is not that of an arm, a channel that it does not have, or a wind
            that is both known and tracked.

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
                "channel: give noise={'tip_x': 0.02} or the like"
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
        """Take a row of commands and measurements, and say where the arm was at the last of them.

        Commands of a row that is older than the last one do not count.

        Arguments:
            row: `time`, the stamp (s); commanded angles of joints by name (`joint01_command`, rad),
                of which those that are left out stay; measured channels, SI, NaN or left out where
                there is none.

        Raises:
            InputError: no time, or a name that is neither a command nor a measured channel.
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
        """What is expected of a time (s) after the last measurement, by the last command.

        Raises:
            InputError: a time before the last measurement.
        """
        ahead = max(self._knots[-1], self.filter.time) if time is None else float(time)
        return self._states(self.filter.ahead(ahead))

    @property
    def changes(self) -> tuple[Change, ...]:
        """Estimated parameters that have changed."""
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
        """What the last row measured beside what was expected, shape (channel,).

        As independent numbers of deviation 1; 0 of what was not measured, was lost, or is an
        outlier.
        """
        none = np.zeros(len(self.arm.channels))
        return none + sum(np.asarray(each.innovation.whitened) for each in self._found)

    @property
    def used(self) -> np.ndarray:
        """Which channels of the last row counted, shape (channel,)."""
        none = np.zeros(len(self.arm.channels), bool)
        return none | np.any([none, *(np.asarray(each.used) for each in self._found)], axis=0)

    def _states(self, state: Gaussian) -> States:
        return as_states(self.arm, Gaussian(state.mean[None], state.root[None]))

    def _held(self, begin: float, end: float) -> Held:
        command = [self._command(begin), self._command(begin if self._stays else end)]
        wind = np.tile(self._wind, (2, 1))
        # Of two measurements of one time the second has no interval, by which slopes are divided.
        known: Any = (begin, max(end - begin, SHORT), np.stack(command), wind)
        given: Any = [np.asarray(each, float) for each in known]
        return Held(*given)

    def _corners(self, begin: float, end: float) -> list[float]:
        """Knots within an interval at which the command jumps, or bends."""
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
        """That of a time, between two knots on a line or held; beyond them the nearest."""
        place = bisect.bisect_right(self._knots, time)
        if place in (0, len(self._knots)):
            return self._commands[min(place, len(self._knots) - 1)]
        before, after = self._knots[place - 1 : place + 1]
        share = 0.0 if self._stays else (time - before) / (after - before)
        return (1 - share) * self._commands[place - 1] + share * self._commands[place]


_APART = 1e-6  # s, of two times that are not one


def _row(name: str, values: Any, count: int) -> np.ndarray:
    row = np.asarray(values, float)
    if row.shape != (count,):
        raise InputError(f"the {name} have shape {row.shape}: give {count} numbers in one row")
    return row
