"""A run: the checked recorded and commanded data of one experiment, in SI units."""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from ..runtime.limits import DURATION_S, GAP_S, STEP_S, TIME_S, VALUE
from ..runtime.plugins import registered
from ..runtime.text import InputError, ShownAsTable
from ..schema import KINDS, Kind
from ._channels import (
    Channel,
    Naming,
    column_table,
    decide_model,
    match_name,
    parse_column,
    parse_columns,
)
from ._definition import Definition
from ._fit_sections import correlated_part_of, deviation_of, noise_section

if TYPE_CHECKING:
    import polars as pl

Times = npt.NDArray[np.float64]

# Maximum ratio of consecutive time steps in equal units, for uneven clocks and rounded stamps.
_EVEN = 2.0


def check_times(times: Times, naming: Naming, *, integrated: bool) -> None:
    """Raise `InputError` unless times (s) are finite, strictly increasing, and in one unit.

    `integrated` means that a model is integrated from the first to the last time.
    """
    if (at := _first(~np.isfinite(times))) is not None:
        state = "infinite" if np.isinf(times[at]) else "empty"
        raise InputError(
            f"{naming.source}: time in {naming.at(at)} is {state}, but every sample must have a "
            "time: add the time, or remove the sample"
        )
    if (at := _first(np.abs(times) > TIME_S)) is not None:
        raise InputError(
            f"{naming.source}: time in {naming.at(at)} is {times[at]:.9g} s, but must be at most "
            f"{TIME_S:g} s: correct the time stamp, or its unit"
        )
    steps = np.diff(times)
    if (at := _first(steps <= 0)) is not None:
        least = np.median(np.abs(steps))
        if 1 < at < len(steps) - 1 and times[at + 1] <= times[0] + least and steps[at] < -least:
            raise InputError(
                f"{naming.source}: a second recording seems to begin in {naming.at(at + 1)}, where "
                f"time goes from {times[at]:.9g} s back to {times[at + 1]:.9g} s, but it must "
                "strictly increase: split the file there, and give both parts with --data"
            )
        raise InputError(
            f"{naming.source}: time goes from {times[at]:.9g} s to {times[at + 1]:.9g} s in "
            f"{naming.at(at + 1)}, but must strictly increase: sort the samples and remove "
            "repeated ones"
        )
    _check_unit(times, steps, naming)
    if (at := _first(steps < STEP_S)) is not None:
        raise InputError(
            f"{naming.source}: {naming.at(at + 1)} is {steps[at]:.3g} s after the previous one, "
            f"but must be at least {STEP_S:g} s after it: correct the time stamp"
        )
    if integrated and (at := _first(steps > GAP_S)) is not None:
        raise InputError(
            f"{naming.source}: {naming.at(at + 1)} is {steps[at]:.6g} s after the previous one, "
            f"but may be at most {GAP_S:g} s after it: correct the time stamp, or cut the run in "
            "two"
        )
    if integrated and times[-1] - times[0] > DURATION_S:
        raise InputError(
            f"{naming.source} lasts {times[-1] - times[0]:.6g} s, but may last at most "
            f"{DURATION_S:g} s: cut it into several runs"
        )


def _check_unit(times: Times, steps: Times, naming: Naming) -> None:
    """Refuse stamps that change to milliseconds: divided by 1000, they continue those before."""
    if len(steps) < 3:
        return
    before, leap, after = steps[:-2], times[2:-1] / 1000 - times[1:-2], steps[2:] / 1000
    ends = before / _EVEN, before * _EVEN
    follow = (leap > ends[0]) & (leap < ends[1]) & (after > ends[0]) & (after < ends[1])
    if (at := _first(follow)) is not None:
        raise InputError(
            f"{naming.source}: time goes from {times[at + 1]:.9g} s to {times[at + 2]:.9g} s in "
            f"{naming.at(at + 2)}, and continues as if in milliseconds, but all times must have "
            f"the same unit: convert the time stamps"
        )


Empty = Literal["none", "some", "all"]


def _first(wrong: npt.NDArray[np.bool_]) -> int | None:
    """Return the index of the first wrong sample, or None."""
    at = np.flatnonzero(wrong)
    return int(at[0]) if at.size else None


def _check(content: "Run", naming: Naming, *, partial: bool) -> None:
    """Raise `InputError` for the first defect of a run that makes it unusable for any model."""
    kind = content.kind
    _check_lengths(content, naming, partial=partial)
    if content.times is not None:
        check_times(content.times, naming, integrated=kind.timed)
    measured = {name for name, channel in content.channels.items() if channel.kind in kind.outputs}
    for name, channel in content.channels.items():
        if channel.quantity == "text":
            _check_text(content.values[name], channel, naming)
        else:
            # The inputs of a model must be known at every sample. Only measurements may be missing.
            empty: Empty = "none"
            if name in measured:
                empty = "all" if partial else "some"
            _check_numbers(content.values[name], channel, naming, empty=empty)
    for column in content.definition.noise.columns:
        if parse_column(column).name not in measured:
            raise InputError(
                f"{naming.source}: noise is given for {column!r}, which must be a measured column "
                "of the run: correct or remove this key"
            )
    kind.check(content, naming)


def _check_lengths(content: "Run", naming: Naming, *, partial: bool) -> None:
    kind, times, values, channels = content.kind, content.times, content.values, content.channels
    if times is None and kind.timed:
        run = f"{'an' if kind.name[0] in 'aeiou' else 'a'} {kind.name} run"
        raise InputError(
            f"{naming.source} has no time column: {run} must have time_s or time_ms, "
            "so add this column, or rename one with --rename"
            if naming.columns
            else f"{naming.source} has no sample times: {run} must have them, so give them"
        )
    length = len(next(iter(values.values()))) if times is None else len(times)
    for name, array in values.items():
        if len(array) != length:
            raise InputError(
                f"{naming.source}: {naming.of(channels[name])} has {len(array)} samples, but must "
                f"have {length} like the others: give it at every sample, with NaN where it is "
                "missing"
            )
    least = 1 if times is None or partial else 2
    if length < least:
        raise InputError(
            f"{naming.source} has {length} sample{'s' * (length != 1)}, but must have at least "
            f"{least}: give a longer run"
        )


def _check_text(array: npt.NDArray[Any], channel: Channel, naming: Naming) -> None:
    allowed = column_table()[channel.kind].texts
    at = next((index for index, text in enumerate(array) if text not in allowed), None)
    if at is not None:
        raise InputError(
            f"{naming.source}: {naming.of(channel)} is {array[at]!r} in {naming.at(at)}, but must "
            f"be {' or '.join(allowed)} everywhere: correct this value"
        )


def _check_numbers(
    array: npt.NDArray[Any], channel: Channel, naming: Naming, *, empty: Empty
) -> None:
    missing, called = np.isnan(array), f"{naming.source}: {naming.of(channel)}"
    if missing.all() and empty != "all":
        raise InputError(
            f"{called} has no value at all: it must have at least one, so fill or remove it"
        )
    if (at := _first(np.isinf(array))) is not None:
        raise InputError(
            f"{called} is infinite in {naming.at(at)}, but must be a finite number or empty: "
            "correct this value"
        )
    if (at := _first(np.abs(array) > VALUE)) is not None:
        raise InputError(
            f"{called} is {channel.from_si(array[at]):.3g} in {naming.at(at)}, but no recorded "
            "value may be so large: correct or empty it"
        )
    if empty == "none" and (at := _first(missing)) is not None:
        raise InputError(
            f"{called} is empty in {naming.at(at)}, but the inputs of the model must be known at "
            "every sample: fill the gap"
        )


@dataclass(frozen=True, eq=False)
class Run(ShownAsTable):
    """The data of one experiment, in SI units.

    Runs are made by `read_run`, `Run.from_frame` and `Run.from_arrays`, which check the data. The
    arrays are read-only.

    Attributes:
        name: stem of the file, or a name given by the caller.
        model: name of the kind of model, one of `giajax.schema.KINDS`.
        times: times, s, shape (sample,), strictly increasing; None for a static run.
        values: values by channel name, SI, each of shape (sample,); NaN means not measured. A text
            channel (`side`, `phase`) is an object array of str or None. Time is not included.
        channels: channels by the same names.
        definition: the sidecar, overridden by the fit definition.
        path, sha256: the file and its checksum; None for a run made from arrays.
        observed: names of the channels that a fit uses; None for all measured channels.
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
        """Make a run from arrays, with the same checks as for a file.

        Arguments:
            times: times, s, shape (sample,); None for a static run.
            values: values by channel name without unit (`joint01_command`, `link06_z`), SI (rad,
                rad/s, m, m/s, N, N m, Pa), each of shape (sample,). NaN means not measured.
            name: name of the run.
            noise: standard deviations, SI, by quantity (`position`, `angle`, `rate`) or by
                channel name.
            definition: contents of a sidecar.

        Raises:
            InputError: the arrays are not a valid run.

        Example:
            >>> import giajax
            >>> values = {"joint01_command": [0.0, 0.5, 0.5], "link20_z": [0.0, 0.4, 2.0]}
            >>> run = giajax.Run.from_arrays([0.0, 1.0, 2.0], values, noise={"position": 0.01})
        """
        # The definition is read first, because it may name a package that declares columns.
        stated = _definition(definition, name)
        channels = {channel: Channel.named(channel) for channel in values}
        if "time" in channels:
            raise InputError(f"{name}: 'time' is among the values: give it as the first argument")
        return cls._of(channels, times, values, name, noise, stated)

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        *,
        units: Mapping[str, str] | None = None,
        name: str = "run",
        noise: Mapping[str, float] | None = None,
        definition: Definition | Mapping[str, Any] | None = None,
    ) -> "Run":
        """Make a run from a table in memory, with the same checks as for a file.

        Arguments:
            frame: a pandas or Polars data frame, an xarray dataset, or arrays by name. Columns have
                the names of columns in files (`time_s`, `link06_z_m`), or lack the unit
                (`link06_z`) if it is given in `units` or in the xarray attribute `units`. An index
                or coordinate with such a name is treated as a column. NaN means not measured.
            units: suffix of the unit (`mm`, `deg`, `s`) by column name.
            name, noise, definition: as in `from_arrays`.

        Raises:
            InputError: the table is not a valid run.

        Example:
            >>> import giajax
            >>> frame = {"time_s": [0.0, 1.0], "joint01_command_deg": [0, 5], "tip_z": [0, 40]}
            >>> run = giajax.Run.from_frame(frame, units={"tip_z": "mm"})
            >>> float(run.values["tip_z"][1])
            0.04
        """
        described = _definition(definition, name)
        given, stated = _columns(frame)
        stated = {**stated, **(units or {})}
        if absent := [column for column in stated if column not in given]:
            raise InputError(
                f"{name}: units contains {absent[0]!r}, which is not a column, or is a column of "
                f"time stamps, which take no unit"
                ": remove it"
            )
        columns = {
            f"{column}_{stated[column]}" if column in stated else column: array
            for column, array in given.items()
        }
        try:
            named = parse_columns(columns)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        times = None
        values: dict[str, Any] = {}
        for (column, array), channel in zip(columns.items(), named.values(), strict=True):
            if channel.quantity != "text":
                array = channel.to_si(_numbers(array, f"{name}: {column}"))
            if channel.kind == "time":
                times = array
            else:
                values[channel.name] = array
        channels = {channel.name: channel for channel in named.values() if channel.name in values}
        return cls._of(channels, times, values, name, noise, described)

    @classmethod
    def _of(
        cls,
        channels: dict[str, Channel],
        times: npt.ArrayLike | None,
        values: Mapping[str, npt.ArrayLike],
        name: str,
        noise: Mapping[str, float] | None,
        definition: Definition,
    ) -> "Run":
        """Make a run from arrays in SI units and the contents of a sidecar."""
        if noise:
            section = {"noise": noise_section(noise, channels)}
            definition = definition.merged_with(Definition.parse(section, f"{name}: noise"))
        arrays = {
            channel: _text(item, f"{name}: {channel}")
            if channels[channel].quantity == "text"
            else _numbers(item, f"{name}: {channel}")
            for channel, item in values.items()
        }
        return build_run(
            name=name,
            times=None if times is None else _numbers(times, f"{name}: times"),
            values=arrays,
            channels=channels,
            definition=definition,
            naming=Naming(name, "sample", 0, columns=False),
        )

    def to_frame(self) -> "pl.DataFrame":
        """Return the run as a Polars data frame with the columns and units of its file.

        `pandas.DataFrame(run.to_frame().to_dict(as_series=False))` converts it to pandas.
        """
        import polars as pl

        columns: dict[str, Any] = {}
        if self.times is not None:
            columns["time_s"] = self.times
        for name, channel in self.channels.items():
            values = self.values[name]
            columns[channel.column] = (
                values.tolist() if channel.quantity == "text" else channel.from_si(values)
            )
        return pl.DataFrame(columns)

    @property
    def kind(self) -> Kind:
        """Declarations of the kind of model of the run."""
        if self.model not in KINDS:
            registered("model", self.model)  # a worker process imports the model of a package here
        return KINDS[self.model]

    @property
    def recording(self) -> str:
        """Name of the recording; a window has the name of the recording it was cut from."""
        return self.name if self.path is None else self.path.stem

    @property
    def drawn_over(self) -> str | None:
        """Input over which the measured channels are plotted; None means time."""
        return self.kind.drawn_over(self)

    @property
    def commands(self) -> dict[str, npt.NDArray[Any]]:
        """Channels that drive the model, except wind: name -> (T,), SI."""
        return self._of_rows(self.kind.inputs)

    @property
    def naming(self) -> Naming:
        """How messages name rows and columns: as in the file, or as samples of arrays."""
        if self.path is None:
            return Naming(self.name, "sample", 0, columns=False)
        first = 2 if self.path.suffix.lower() == ".csv" else 1
        return Naming(str(self.path), "row", first, columns=True)

    @property
    def winds(self) -> dict[str, npt.NDArray[Any]]:
        """Recorded air velocity: `wind_x`, ... -> (T,), m/s."""
        return self._of_rows(self.kind.rows("surroundings"))

    @property
    def observations(self) -> dict[str, npt.NDArray[Any]]:
        """Channels that a fit compares with the prediction: name -> (T,), SI."""
        measured = self._of_rows(self.kind.outputs)
        if self.observed is None:
            return measured
        return {name: measured[name] for name in self.observed if name in measured}

    def noise(self, name: str) -> float | None:
        """Return the standard deviation (SI) of a channel from `[noise]`, or None."""
        return deviation_of(self.definition.noise, self.channels[name])

    def correlated_noise(self, name: str) -> tuple[float, float] | None:
        """Return standard deviation (SI) and time (s) of the correlated noise, or None."""
        return correlated_part_of(self.definition.noise, self.channels[name])

    def part_of(self, name: str) -> str:
        """Return the role of a channel: "measured", or as an input, "command" or "wind"."""
        kind = self.channels[name].kind
        if kind in self.kind.outputs:
            return "measured"
        return "command" if kind in self.kind.inputs else "wind"

    def _table(self) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
        length = len(next(iter(self.values.values())))
        lasts = "" if self.times is None else f" over {np.ptp(self.times):.6g} s"
        rows = []
        for name, channel in self.channels.items():
            noise = self.noise(name)
            stated = "" if noise is None else f"{channel.from_si(noise):.3g}"
            rows.append((name, channel.unit, self.part_of(name), stated))
        title = f"{self.name}: {self.model} run, {length} samples{lasts}"
        return title, ("channel", "unit", "part", "noise"), rows

    def require_observations(self) -> None:
        """Raise `InputError` if the run has no measured channel that a fit could use."""
        if not self.observations:
            raise InputError(
                f"{self.path or self.name} holds no measured channel to fit: it must have at "
                f"least one, such as {self.kind.measured}, so add a column for it"
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
    naming: Naming,
    path: Path | None = None,
    sha256: str | None = None,
    partial: bool = False,
) -> Run:
    """Determine the model, check the data (`InputError`: not a valid run), freeze the arrays.

    `partial` means that the run continues: one sample suffices, and channels may be empty.
    """
    if not channels:
        raise InputError(
            f"{naming.source} has only a time column: it must also have a channel, such as "
            "joint01_command_deg or link06_z_m"
        )
    model = decide_model(channels.values(), definition.model, naming.source)
    run = Run(name, model, times, values, channels, definition, path, sha256)
    _check(run, naming, partial=partial)
    for array in (*values.values(), *(() if times is None else (times,))):
        array.setflags(write=False)
    return run


def _definition(said: Definition | Mapping[str, Any] | None, name: str) -> Definition:
    return (
        said
        if isinstance(said, Definition)
        else Definition.parse(said or {}, f"{name}: definition")
    )


def _columns(frame: Any) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the columns of a table, and the units that it gives separately from the names."""
    stated = {}
    if hasattr(frame, "data_vars"):
        known = {
            str(name): each
            for name, each in frame.variables.items()
            if name in frame.data_vars or match_name(str(name)) is not None
        }
        columns = {name: each.values for name, each in known.items()}
        units = {name: each.attrs.get("units") for name, each in known.items()}
        stated = {name: unit for name, unit in units.items() if unit and _lacks_unit(name)}
    elif isinstance(frame, Mapping):
        columns = {str(name): values for name, values in frame.items()}
    elif hasattr(frame, "columns"):
        columns = {str(name): _values(frame[name]) for name in frame.columns}
        index = getattr(frame, "index", None)
        if index is not None:
            array, has_time = _values(index), {"time", "time_s"} & columns.keys()
            if index.name is None and array.dtype.kind in "mM" and not has_time:
                columns["time"] = array
            elif index.name is not None and match_name(str(index.name)) is not None:
                columns = {str(index.name): array, **columns}
    else:
        raise InputError(
            f"a run cannot be made from an object of type {type(frame).__name__}: give a pandas "
            "or Polars data frame, an xarray dataset, or arrays by name"
        )
    for name in {"time", "time_s"} & columns.keys():
        stamps = np.asarray(columns[name])
        if stamps.dtype.kind in "mM":
            # Convert dates to times since the first one. Neither kind of stamps needs a unit.
            since = stamps - stamps[:1] if stamps.dtype.kind == "M" else stamps
            columns.pop(name)
            stated.pop(name, None)
            columns["time_s"] = since / np.timedelta64(1, "s")
    return columns, stated


def _values(column: Any) -> npt.NDArray[Any]:
    """Return a pandas or Polars column as an array; stamps with a time zone become UTC."""
    if getattr(getattr(column, "dtype", None), "tz", None) is not None:
        column = getattr(column, "dt", column).tz_convert(None)
    array: npt.NDArray[Any] = column.to_numpy()
    return array


def _lacks_unit(name: str) -> bool:
    row = match_name(name)
    return row is not None and row.suffix is None


def _numbers(values: npt.ArrayLike, what: str) -> npt.NDArray[np.float64]:
    # Copy the array, because the run is frozen, but the caller's array must stay writable.
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers: convert the values to float") from None
    if array.ndim != 1:
        raise InputError(
            f"{what} has the shape {array.shape}, but must have one dimension, with one value for "
            "each sample: give one array for each channel"
        )
    return array


def _text(values: npt.ArrayLike, what: str) -> npt.NDArray[Any]:
    array = np.array(values, dtype=object)
    if array.ndim != 1:
        raise InputError(f"{what} must be a list of strings, one for each sample: give such a list")
    return array


# 50 characters of up to four bytes leave room for the rest of a file name.
_LONGEST = 50


def unique_names(runs: Sequence[Run]) -> list[str]:
    """Return a unique name for each run that is valid in any file system."""
    names: list[str] = []
    for run in runs:
        stem = re.sub(r"[^\w.-]+", "_", run.name).strip(".")[:_LONGEST] or "run"
        taken = {other.lower() for other in names}
        numbered = (f"{stem}_{number}" for number in itertools.count(2))
        names.append(next(n for n in itertools.chain([stem], numbered) if n.lower() not in taken))
    return names
