"""A run: what was recorded and commanded in one experiment, and its sidecar, in SI units.

The file is longer than 200 lines because all that is asked of a run is asked here.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ..kinds import KINDS, Kind
from ._channels import Channel
from ._checks import check_content
from ._column_table import TEXTS
from ._definition import Definition
from ._model import decide_model
from ._noise import correlated_part_of, deviation_of, noise_section
from ._wording import Wording


@dataclass(frozen=True, eq=False)
class Run:
    """One experiment, in SI units.

    Made by `read_run` and `Run.from_arrays`, which both check the content. The arrays are
    read-only.

    Attributes:
        name: the file's stem, or a name of the caller's.
        model: name of its kind, one of `giajax.kinds.KINDS`.
        times: s, shape (sample,), strictly increasing; None for a static run.
        values: by channel name, SI, each of shape (sample,); NaN = not measured. A text channel
            (`side`, `phase`) is an object array of str or None. Time is not among them.
        channels: by the same names.
        definition: the sidecar, with the fit definition on top.
        path, sha256: the file and its checksum; None for a run made from arrays.
        observed: the channels that a fit compares; None for all that were measured.
    """

    name: str
    model: str
    times: npt.NDArray[np.float64] | None
    values: dict[str, npt.NDArray[Any]]
    channels: dict[str, Channel]
    definition: Definition = field(default_factory=Definition)
    path: Path | None = None
    sha256: str | None = None
    observed: tuple[str, ...] | None = None

    @classmethod
    def from_arrays(
        cls,
        times: npt.ArrayLike | None,
        values: Mapping[str, npt.ArrayLike],
        *,
        name: str = "run",
        noise: Mapping[str, float] | None = None,
        definition: Definition | Mapping[str, Any] | None = None,
    ) -> "Run":
        """A run from arrays, with the same checks as a file.

        Arguments:
            times: shape (sample,), s; None for a static run.
            values: by channel name without unit (`joint01_command`, `link06_z`), SI (rad, rad/s,
                m, m/s, N, N m, Pa), each of shape (sample,). NaN = not measured.
            name: of the run.
            noise: standard deviations, SI: by quantity (`position`, `angle`, `rate`) or by
                channel name.
            definition: what a sidecar would say.

        Raises:
            InputError: whatever keeps the arrays from being a run.

        Example:
            >>> import giajax
            >>> values = {"joint01_command": [0.0, 0.5, 0.5], "link20_z": [0.0, 0.4, 2.0]}
            >>> run = giajax.Run.from_arrays([0.0, 1.0, 2.0], values, noise={"position": 0.01})
        """
        if not isinstance(definition, Definition):
            definition = Definition.parse(definition or {}, f"{name}: definition")
        channels = {channel: Channel.named(channel) for channel in values}
        if "time" in channels:
            raise InputError(f"{name}: 'time' is among the values: give it as the first argument")
        if noise:
            section = {"noise": noise_section(noise, channels)}
            definition = definition.merged_with(Definition.parse(section, f"{name}: noise"))
        arrays = {
            channel: _text(item, f"{name}: {channel}")
            if channel in TEXTS
            else _numbers(item, f"{name}: {channel}")
            for channel, item in values.items()
        }
        return build_run(
            name=name,
            times=None if times is None else _numbers(times, f"{name}: times"),
            values=arrays,
            channels=channels,
            definition=definition,
            wording=Wording(name, "sample", 0, columns=False),
        )

    @property
    def kind(self) -> Kind:
        """What its kind of model declares."""
        return KINDS[self.model]

    @property
    def recording(self) -> str:
        """Name of the recording that it is, or is a window of."""
        return self.name if self.path is None else self.path.stem

    @property
    def drawn_over(self) -> str | None:
        """The input that its measured channels are drawn over; None: over time."""
        return self.kind.drawn_over(self)

    @property
    def commands(self) -> dict[str, npt.NDArray[Any]]:
        """The channels that drive the model, wind apart: name -> (T,), SI."""
        return self._of_rows(self.kind.inputs)

    @property
    def winds(self) -> dict[str, npt.NDArray[Any]]:
        """The recorded air velocity: `wind_x`, ... -> (T,), m/s."""
        return self._of_rows(self.kind.rows("surroundings"))

    @property
    def observations(self) -> dict[str, npt.NDArray[Any]]:
        """The channels that a fit compares with its prediction: name -> (T,), SI."""
        measured = self._of_rows(self.kind.outputs)
        if self.observed is None:
            return measured
        return {name: measured[name] for name in self.observed if name in measured}

    def noise(self, name: str) -> float | None:
        """Standard deviation of channel `name` in `[noise]`, SI; None if it is not there.

        The key of the column wins over that of its quantity.
        """
        return deviation_of(self.definition.noise, self.channels[name])

    def correlated_noise(self, name: str) -> tuple[float, float] | None:
        """The part of a channel's noise that has a memory, as `[noise]` states it.

        Its standard deviation, SI, and its correlation time, s; None where neither is stated.
        """
        return correlated_part_of(self.definition.noise, self.channels[name])

    def require_observations(self) -> None:
        """Raise `InputError` if the run holds nothing that a fit could compare."""
        if not self.observations:
            raise InputError(
                f"{self.path or self.name} holds no measured channel to fit: it must have at least "
                f"one, such as {self.kind.measured}, so add its column"
            )

    def _of_rows(self, rows: tuple[str, ...]) -> dict[str, npt.NDArray[Any]]:
        return {
            name: self.values[name]
            for name, channel in self.channels.items()
            if channel.kind in rows
        }


def build_run(
    *,
    name: str,
    times: npt.NDArray[np.float64] | None,
    values: dict[str, npt.NDArray[Any]],
    channels: dict[str, Channel],
    definition: Definition,
    wording: Wording,
    path: Path | None = None,
    sha256: str | None = None,
) -> Run:
    """Decide the model, check the content, freeze the arrays.

    Raises:
        InputError: the content is not a run.
    """
    if not channels:
        raise InputError(
            f"{wording.source} has only a time column: it must also have a channel, "
            "such as joint01_command_deg and link06_z_m"
        )
    model = decide_model(channels.values(), definition.model, wording.source)
    check_content(model, times, values, channels, definition, wording)
    for array in (*values.values(), *(() if times is None else (times,))):
        array.setflags(write=False)
    return Run(name, model, times, values, channels, definition, path, sha256)


def _numbers(values: npt.ArrayLike, what: str) -> npt.NDArray[np.float64]:
    # A copy: the run is frozen, and the caller's array stays the caller's.
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers: convert the values to float") from None
    if array.ndim != 1:
        raise InputError(
            f"{what} has the shape {array.shape}, but must have one dimension, the samples: "
            "give one array for each channel"
        )
    return array


def _text(values: npt.ArrayLike, what: str) -> npt.NDArray[Any]:
    array = np.array(values, dtype=object)
    if array.ndim != 1:
        raise InputError(f"{what} must be a list of text, one a sample: give it as such")
    return array
