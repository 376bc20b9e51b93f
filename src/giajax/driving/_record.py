"""A drive as a run that `giajax fit` reads."""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._program import program
from .._typing import Array, Float
from ..models import ArmModel, Channels, recorded_channels
from ..runs import Definition, Run
from ..simulation import RESULTS, Trajectory, logged
from ..synthetic import RecordingErrors, with_errors


class Record:
    """What an arm was told and what it did, row by row.

    Arguments:
        model: of the arm, with its sensors.
    """

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        self._times: list[float] = []
        self._commands: list[np.ndarray] = []
        self._states: list[np.ndarray] = []
        self._winds: list[np.ndarray] = []

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._times)

    def add(self, time: float, command: np.ndarray, state: np.ndarray, wind: np.ndarray) -> None:
        """One row.

        Arguments:
            time: s.
            command: of all joints, rad, shape (joint,).
            state: angles (rad) and rates (rad/s), shape (2, joint).
            wind: velocity of the air, m/s, shape (3,).
        """
        self._times.append(time)
        self._commands.append(command)
        self._states.append(state)
        self._winds.append(wind)

    @property
    def times(self) -> Float[np.ndarray, " row"]:
        """Of the rows, s."""
        return np.asarray(self._times)

    @property
    def commands(self) -> Float[np.ndarray, "row joint"]:
        """Commanded angles, rad."""
        return np.asarray(self._commands)

    @property
    def angles(self) -> Float[np.ndarray, "row joint"]:
        """Angles of the joints, rad."""
        return np.asarray(self._states)[:, 0]

    @property
    def winds(self) -> Float[np.ndarray, "row 3"]:
        """Velocities of the air, m/s."""
        return np.asarray(self._winds)

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
        """The drive as a run: commands, wind, and what sensors saw.

        Commands have every row, because between rows they are linear; other cells are empty but
        in every so-manieth row.

        Arguments:
            channels: what is recorded (`link06_z`, `tip_x`).
            name: of the run.
            noise: standard deviations by the keys of `[noise]` (`position_m`).
            every: in which rows there is a recording.
            seed: of the noise.
            origin: where the run is from, for its sidecar.

        Raises:
            InputError: too short a drive, one in which no joint was moved, or an unknown channel.
        """
        if len(self) < 2:
            raise InputError("nothing was driven: there is no run to save")
        moved = np.flatnonzero(np.any(self.commands != 0, axis=0))
        if not moved.size:
            raise InputError("no joint was moved: there is no run to save")
        seen = _seen(self.model, self._trajectory(), tuple(channels))
        hidden = np.arange(len(self)) % every != 0
        values = {f"joint{joint + 1:02d}_command": self.commands[:, joint] for joint in moved} | {
            channel: np.where(hidden, np.nan, np.asarray(column))
            for channel, column in seen.items()
        }
        if np.any(self.winds):
            values |= dict(zip(("wind_x", "wind_y", "wind_z"), self.winds.T, strict=True))
        constants = self.model.definition()
        facts = {key: value for key, value in constants.items() if key in Definition.model_fields}
        facts |= {"model": self.model.kind, "command": {"interpolation": "linear"}}
        if np.any(self.winds):
            facts["wind"] = {"interpolation": "linear"}
        facts |= {"noise": dict(noise)} if noise else {}
        facts |= {"origin": origin} if origin else {}
        definition = Definition.parse(facts, name)
        run = Run.from_arrays(self.times, values, name=name, definition=definition)
        if not noise:
            return run
        white = {channel: deviation for channel in seen if (deviation := run.noise(channel))}
        return with_errors(run, RecordingErrors(white=white), seed=seed)

    def _trajectory(self) -> Trajectory:
        states = jnp.asarray(np.asarray(self._states))
        return Trajectory(
            times=jnp.asarray(self.times),
            angles=states[:, 0],
            rates=states[:, 1],
            memory=None,
            pressures=None,
            skin=None,
            arm=self.model.arm,
            command=logged(self.times, self.commands),
            wind=logged(self.times, self.winds),
            result=RESULTS.successful,  # type: ignore[arg-type]
            steps=jnp.zeros(2, dtype=int),
        )


@program
def _seen(model: ArmModel, motion: Trajectory, channels: tuple[str, ...]) -> Channels:
    def at(times: Array, end: Array) -> Trajectory:
        return motion

    return recorded_channels(model.arm, model.sensors, at, motion.times, channels)[0]
