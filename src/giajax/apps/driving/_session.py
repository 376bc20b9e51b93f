"""Drive of an arm: commands from an operator, steps in real time, and a record."""

import contextlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...mechanics.hysteresis import AbstractOperator
from ...models import ArmModel, Channels, recorded_channels
from ...recordings import Channel, Run, read_numbers, sidecar_path, write_files
from ...runtime.arrays import Array, Float
from ...runtime.limits import POSES, STEPS
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema.parameters import replace
from ...simulation import Moment, Stepper, Trajectory
from ..control import Compensator
from ..synthetic import (
    Drive,
    RecordingErrors,
    command_columns,
    driven_run,
    logged_motion,
    with_errors,
)
from ._operator import Operator, PadMapping


class Pose(NamedTuple):
    """Current pose of a driven arm.

    Attributes:
        time: time since the start of the drive, s.
        angles, command: angles and commanded angles of the joints, rad.
        wind: velocity of the air, m/s.
        stopped: reason why the command does not move, or None.
        lost: time by which the simulation has permanently fallen behind the clock, s.
    """

    time: float
    angles: Float[np.ndarray, " joint"]
    command: Float[np.ndarray, " joint"]
    wind: Float[np.ndarray, "3"]
    stopped: str | None
    lost: float


class Compensation:
    """Inverse of the hysteresis from commanded to measured angle, for each joint and sample."""

    def __init__(self, compensator: Compensator, joints: int) -> None:
        channels = [compensator.input_channel, compensator.output_channel]
        if any(channel is not None and channel.quantity != "angle" for channel in channels):
            raise InputError(
                f"the input of the compensation is {compensator.input_channel.column}, but the "
                "joints of an arm are driven by angles: give a fit with commanded and measured "
                "angles"
            )
        self._compensator = compensator
        self._first = self._state = jax.tree.map(
            lambda leaf: jnp.broadcast_to(jnp.asarray(leaf), (joints, *jnp.shape(leaf))),
            compensator.state,
        )

    def restart(self) -> None:
        """Reset the hysteresis to its state before the first command."""
        self._state = self._first

    def __call__(self, wanted: Float[np.ndarray, " joint"]) -> Float[np.ndarray, " joint"]:
        """Return commands for wanted angles, rad, shape (joint,), clipped to the reachable ones."""
        low, high = self._compensator.reachable
        values = jnp.asarray(np.clip(wanted, low, high) - self._compensator.offset)
        inputs, self._state = _step(self._compensator.operator, values, self._state)
        return np.asarray(inputs)


@eqx.filter_jit
def _step(operator: AbstractOperator, values: Array, state: Any) -> tuple[Array, Any]:
    def of_one(value: Array, memory: Any) -> tuple[Array, Any]:
        inputs, after = operator.history(value[None], memory)
        return inputs[0], after

    return jax.vmap(of_one)(values, state)


class Record:
    """Record of the commands and the motion of an arm, row by row.

    Attributes:
        model: model of the arm, with the sensors that observe the motion.
        lost: time by which the simulation has permanently fallen behind the clock, s.
    """

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        self.lost = 0.0
        self._rows: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._rows)

    def add(self, time: float, command: np.ndarray, state: np.ndarray, wind: np.ndarray) -> None:
        """Add one row: the time, s, with commands and states of all joints, and the wind.

        Arguments:
            time: time since the start of the drive, s.
            command: commanded angles, rad, shape (joint,).
            state: angles, rad, and rates, rad/s, of the joints, shape (2, joint).
            wind: velocity of the air, m/s, shape (3,).
        """
        self._rows.append((time, command, state, wind))

    def rows(self, first: int = 0) -> list[list[float]]:
        """Return time, commands, angles, rates and wind of each row from `first` on, SI units."""
        return [
            [float(time), *command.tolist(), *state.ravel().tolist(), *wind.tolist()]
            for time, command, state, wind in self._rows[first:]
        ]

    def _column(self, at: int) -> np.ndarray:
        return np.asarray([row[at] for row in self._rows])

    @property
    def times(self) -> Float[np.ndarray, " row"]:
        """Times of the rows, s."""
        return self._column(0)

    @property
    def commands(self) -> Float[np.ndarray, "row joint"]:
        """Commanded angles, rad."""
        return self._column(1)

    @property
    def angles(self) -> Float[np.ndarray, "row joint"]:
        """Angles of the joints, rad."""
        return self._column(2)[:, 0]

    @property
    def winds(self) -> Float[np.ndarray, "row 3"]:
        """Velocities of the air, m/s."""
        return self._column(3)

    @property
    def duration(self) -> float:
        """Duration of the drive, s."""
        return float(self.times[-1]) if len(self) else 0.0

    @property
    def is_still(self) -> bool:
        """Whether nothing was driven, or no joint was moved: there is no run to save."""
        return len(self) < 2 or not command_columns(self.commands)

    def run(
        self,
        channels: Sequence[str],
        *,
        name: str = "drive",
        noise: Mapping[str, float] | None = None,
        every: int = 1,
        seed: int = 0,
        origin: str = "",
    ) -> Run:
        """Return the drive as a run with commands, wind and sensor readings.

        Every row has commands, because they are interpolated linearly between rows. The sensor
        readings are empty except in every `every`-th row.

        Arguments:
            channels: channels to record (`link06_z`, `tip_x`).
            name: name of the run.
            noise: standard deviations by the keys of `[noise]` (`position_m`).
            every: number of rows per sensor reading.
            seed: seed of the noise.
            origin: origin of the data, for the sidecar.

        Raises:
            InputError: the drive is too short, no joint was moved, or a channel is unknown.
        """
        if len(self) < 2:
            raise InputError("the drive has no duration: there is no run to save")
        if self.is_still:
            raise InputError("no joint was moved: there is no run to save")
        values = command_columns(self.commands)
        states = self._column(2)
        rows = (self.times, states[:, 0], states[:, 1], self.commands, self.winds)
        motion = logged_motion(self.model.arm, *rows)
        seen = _seen(self.model, motion, tuple(channels))
        hidden = np.arange(len(self)) % every != 0
        values |= {
            channel: np.where(hidden, np.nan, np.asarray(column))
            for channel, column in seen.items()
        }
        if np.any(self.winds):
            values |= dict(zip(_WIND, self.winds.T, strict=True))
        run = driven_run(self.model, self.times, values, name=name, noise=noise, origin=origin)
        if not noise:
            return run
        white = {channel: deviation for channel in seen if (deviation := run.noise(channel))}
        return with_errors(run, RecordingErrors(white=white), seed=seed)


class Unfinished:
    """Backup file of a drive in progress, as a run, which remains if the process is killed.

    The columns are the commands, angles and rates of all joints, and the wind. The sidecar
    describes the arm. Only `remove` deletes the files.

    Arguments:
        record: record of the drive, which already has its first row.
        path: path of the file, which ends in `.csv` and is overwritten.
        origin: origin of the data, for the sidecar.
        complain: function that is called with a message if rows cannot be written. They are written
            together with the next rows.

    Raises:
        InputError: the files cannot be written.
    """

    def __init__(
        self,
        record: Record,
        path: Path,
        *,
        origin: str = "",
        complain: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self.record, self.path, self.complain = record, path, complain
        self._rows, self._failed = 0, False
        joints = [f"joint{joint:02d}" for joint in range(1, record.model.arm.count + 1)]
        names = [f"{joint}_{what}" for what in ("command", "angle", "rate") for joint in joints]
        columns = [Channel.named(name).column for name in (*names, *_WIND)]
        values = dict.fromkeys((*names, *_WIND), np.zeros(2))
        definition = driven_run(
            record.model, np.arange(2.0), values, name=path.stem, origin=origin
        ).definition
        header = ",".join(["time_s", *columns]) + "\n"
        contents = {path: header, sidecar_path(path): definition.to_toml()}
        write_files({where: text.encode() for where, text in contents.items()}, force=True)
        self._size = len(header.encode())

    def add(self) -> None:
        """Append the new rows to the file; only complete rows are written.

        If this fails, the rows are written by the next call.
        """
        rows = self.record.rows(self._rows)
        data = "".join(",".join(map(repr, row)) + "\n" for row in rows).encode()
        try:
            with self.path.open("r+b", buffering=0) as file:
                file.seek(self._size)
                try:
                    left = memoryview(data)
                    while left:  # a call may write only a part
                        left = left[file.write(left) :]
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(self._size)
                    raise
        except OSError as error:
            if not self._failed:
                self.complain(
                    f"giajax: {self.path} cannot be written ({error.strerror}): the drive would be "
                    "lost if the process were killed now"
                )
            self._failed = True
            return
        self._failed = False
        self._rows, self._size = self._rows + len(rows), self._size + len(data)

    def remove(self) -> None:
        """Remove the files after the drive has been saved."""
        for path in (self.path, sidecar_path(self.path)):
            with contextlib.suppress(OSError):
                path.unlink()


@program
def _seen(model: ArmModel, motion: Trajectory, channels: tuple[str, ...]) -> Channels:
    given = (model.sensors, lambda times, end: motion, motion.times, channels)
    return recorded_channels(*given)[0]


RATE = 30.0
"""Default number of poses per second."""

_BEHIND = 1.0  # largest delay that the simulation catches up with, s; a larger one counts as lost
_WIND = ("wind_x", "wind_y", "wind_z")


class Session:
    """Drive of an arm that starts straight and at rest.

    The caller provides the clock: `tick` takes the current time and advances the arm by the
    intervals that have passed. A message takes effect in the next interval.

    Arguments:
        model: model of the arm, with the sensors that observe the recorded motion.
        mapping: mapping of the pad; defaults to `PadMapping.usual`.
        rate: poses per second.
        steps: steps of the integrator per pose.
        gusts: wind velocity versus time, equal along the arm and repeated at its end; None for
            still air.
        compensation: compensation of the hysteresis of the joints, if any.
        memory: simulate the hysteresis of the joints; if False, it is left out.

    Raises:
        InputError: the rate or the number of steps is out of bounds, the gusts differ between
            links, or the arm has no hysteresis to leave out.
    """

    def __init__(
        self,
        model: ArmModel,
        mapping: PadMapping | None = None,
        *,
        rate: float = RATE,
        steps: int = 1,
        gusts: Drive | None = None,
        compensation: Compensation | None = None,
        memory: bool = True,
    ) -> None:
        if not 1 <= rate <= 1000:
            raise InputError(f"the rate is {rate:g} poses per second: give a rate from 1 to 1000")
        if not 1 <= steps <= STEPS:
            raise InputError(
                f"the number of steps per pose is {steps:,}: give a number from 1 to {STEPS:,}"
            )
        if gusts is not None and set(gusts.values) != set(_WIND):
            raise InputError(
                "the gusts of a drive are the same for the whole arm: give only the components x, "
                "y and z of one wind"
            )
        arm = model.arm
        if not memory:
            hysteresis = arm.joints.hysteresis
            strengths = {"memory": hysteresis.memory.rows, "stops": hysteresis.stops.rows}
            left_out = {f"joints.{name}.strength": 0.0 for name, rows in strengths.items() if rows}
            if not left_out:
                raise InputError(
                    "this arm has neither joints.memory nor joints.stops: there is nothing to "
                    "disable"
                )
            arm = replace(arm, left_out)
        self.model = model
        self.mapping = PadMapping.usual(arm.count) if mapping is None else mapping
        self.operator = Operator(self.mapping, arm.count)
        self.interval = 1.0 / rate
        self.gusty = gusts is not None
        self.compensated = compensation is not None
        self.record = Record(ArmModel(arm, sensors=model.sensors))
        self.can_gust = self.gusty
        self.can_compensate = self.compensated
        self._gusts = gusts
        self._compensation = compensation
        self._stepper = Stepper(arm, jnp.asarray(self.interval), steps)
        self._begin()
        # Compile before the clock starts.
        self._stepper.advance(self.moment, self.moment.command, jnp.asarray(self._wind))

    def _begin(self) -> None:
        self._count = 0
        self._began: float | None = None
        self._wind = self._wind_at(0.0)
        self.moment: Moment = self._stepper.start(wind=self._wind)
        self._add()

    @property
    def lost(self) -> float:
        """Time by which the simulation fell behind the clock for good in this drive, s."""
        return self.record.lost

    def restart(self) -> Record:
        """Begin a new drive with the straight arm at rest; return the record of the last one."""
        driven = self.record
        self.record = Record(driven.model)
        self.operator = self.operator.restarted()
        if self._compensation is not None:
            self._compensation.restart()
        self._begin()
        return driven

    @property
    def time(self) -> float:
        """Time since the start of the drive, s."""
        return self._count * self.interval

    def receive(self, message: Mapping[str, Any], now: float) -> None:
        """Handle one message from a page, which arrived at a time of the clock, s.

        The message is a switch (`{"type": "gusts", "on": true}` or
        `{"type": "compensation", "on": true}`) or a message for `Operator.receive`.
        """
        kind = message.get("type")
        if kind == "gusts":
            self.gusty = bool(message.get("on")) and self.can_gust
        elif kind == "compensation":
            self.compensated = bool(message.get("on")) and self.can_compensate
        else:
            self.operator.receive(message, now)

    def tick(self, now: float, most: int | None = None) -> Pose:
        """Advance to the time of the clock, s, and return the pose of the arm.

        At most `most` intervals are simulated; by default, all that have passed.
        """
        if self._began is None:
            self._began = now - self.time
        behind = now - self._began - self.time
        if behind > _BEHIND + self.interval:
            # Discard the delay, so that the operator does not see the arm move faster than real
            # time.
            late = behind - self.interval
            self.record.lost += late
            self._began += late
        # The tolerance covers the rounding errors of accumulated times.
        missing = int((now - self._began - self.time) / self.interval + 1e-6)
        for _ in range(missing if most is None else min(missing, most)):
            # Pass the time of the clock, so that an arm that lags behind stops without delay.
            self.advance(now)
        return self.pose

    def advance(self, now: float) -> None:
        """Simulate one interval; `now` is the time of the clock, s, used for the timeout."""
        wanted = self.operator.advance(now, self.interval)
        command = wanted
        if self._compensation is not None:
            # The compensation keeps its state up to date while it is switched off.
            compensated = self._compensation(wanted)
            command = compensated if self.compensated else wanted
        self._count += 1
        self._wind = self._wind_at(self.time)
        given = jnp.asarray(command), jnp.asarray(self._wind)
        self.moment = self._stepper.advance(self.moment, *given)
        self._add()

    @property
    def pose(self) -> Pose:
        """Current pose of the arm."""
        angles, command = np.asarray(self.moment.angles), np.asarray(self.moment.command)
        return Pose(self.time, angles, command, self._wind, self.operator.stopped, self.lost)

    def _wind_at(self, time: float) -> Float[np.ndarray, "3"]:
        if self._gusts is None or not self.gusty:
            return np.zeros(3)
        first, last = self._gusts.times[[0, -1]]
        at = self._gusts.at(np.array([first + time % (last - first)]))
        return np.array([float(at[name][0]) for name in _WIND])

    def _add(self) -> None:
        state = np.asarray(self.moment.state[:2])
        if not np.all(np.isfinite(state)):
            raise InputError(
                f"the state of the arm became infinite or NaN at {self.time:.2f} s: check its "
                "parameters, or use more steps"
            )
        self.record.add(self.time, np.asarray(self.moment.command), state, self._wind)


# A drive without an operator takes the inputs of a pad from a file.

_ALIVE = 0.2  # interval of the simulated messages from a page between two rows of a file, s


def read_pad(path: str | Path) -> Mapping[str, Float[np.ndarray, " row"]]:
    """Read a table of pad inputs with the columns `time_s`, `axis0`, `axis1`, ..., `button0`, ...

    The limits on the size of a run apply.

    Raises:
        InputError: the file does not exist, or it is not such a table.
    """
    path = Path(path)
    columns = read_numbers(path)
    if "time_s" not in columns or not any(name.startswith("axis") for name in columns):
        raise InputError(f"{path} has no column for a pad axis: give the columns time_s and axis0")
    odd = [name for name in columns if name != "time_s" and _place(name) is None]
    if odd:
        raise InputError(
            f"{path} has the unknown column '{odd[0]}': use names such as axis0 or button0"
        )
    for name, column in columns.items():
        if not np.all(np.isfinite(column)):
            raise InputError(
                f"{path} has an empty or infinite cell in the column {name}: give a finite number"
            )
    if np.any(np.diff(columns["time_s"]) <= 0):
        raise InputError(f"the times of {path} do not increase: sort the rows by time")
    return columns


def check_length(seconds: float, interval: float) -> None:
    """Raise an `InputError` for a drive of a length, s, with too many intervals, s, for memory."""
    if not seconds <= POSES * interval:
        raise InputError(
            f"the drive lasts {seconds:g} s, but may last at most {POSES * interval:g} s at "
            f"{1 / interval:g} poses per second: shorten it, or reduce the rate"
        )


def replay(
    session: Session,
    pad: Mapping[str, Float[np.ndarray, " row"]],
    *,
    until: float | None = None,
    on_progress: Callable[[float, float], None] | None = None,
) -> None:
    """Drive an arm with recorded pad inputs, as fast as the simulation runs.

    Arguments:
        session: drive to advance.
        pad: table of pad inputs from `read_pad`; a row holds until the next one.
        until: end of the drive, s; defaults to the time of the last row.
        on_progress: function that is called in each interval with the simulated and the total
            time, s.

    Raises:
        InputError: the drive is too long.
    """
    times = pad["time_s"] - pad["time_s"][0]
    end = float(times[-1]) if until is None else until
    check_length(end, session.interval)
    if len(times) > POSES:
        raise InputError(f"the drive has {len(times):,} rows: give at most {POSES:,}")
    rows, heard = 0, -np.inf
    while session.time + 0.5 * session.interval < end:
        now = session.time
        # Send all rows until now: the latest one holds, but each may press a button.
        while rows < len(times) and times[rows] <= now + 1e-9:
            session.receive(_message(pad, rows), now)
            rows, heard = rows + 1, now
        if now - heard > _ALIVE:
            session.receive({"type": "alive"}, now)
            heard = now
        session.advance(now + session.interval)
        if on_progress is not None:
            on_progress(session.time, end)


def _message(pad: Mapping[str, Float[np.ndarray, " row"]], row: int) -> dict[str, Any]:
    message: dict[str, Any] = {"type": "pad"}
    for kind, name in (("axis", "axes"), ("button", "buttons")):
        places = [place for column in pad if (place := _place(column, kind)) is not None]
        values = [0.0] * (max(places, default=-1) + 1)
        for place in places:
            values[place] = float(pad[f"{kind}{place}"][row])
        message[name] = values
    return message


def _place(column: str, kind: str | None = None) -> int | None:
    """Return the index of the axis or button of a column, or None for other columns."""
    found = re.fullmatch(r"(axis|button)(0|[1-9][0-9]{0,2})", column)
    if found is None or kind not in (None, found[1]) or int(found[2]) > 255:
        return None
    return int(found[2])
