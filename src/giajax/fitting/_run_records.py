"""What a result says of single runs: fitted, held out, or predicted. JSON gives each record back.

As `_records`, field by field they are the objects of `result.json`.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, TypeVar

Channel = TypeVar("Channel")


@dataclasses.dataclass(frozen=True)
class OwnEstimate:
    """What one run has for itself, such as an initial angle, or with its group: as `Estimate`."""

    value: float
    standard_error: float | None
    remark: str = ""


@dataclasses.dataclass(frozen=True)
class ChannelFit:
    """How well one channel of a fitted run is described, in the unit of the recording.

    Attributes:
        unit: of the recording.
        rmse: root mean square of recorded minus predicted; None where that is not finite.
        n: number of measured values.
        noise: standard deviation of a cell that the values were weighted with.
        correlated: standard deviation of the part of it that has a memory.
        correlation_time_s: of that part, s; 0 where there is none.
        innovation: deviation of what the cells before do not foretell, their geometric mean;
            None from a file without it.
    """

    unit: str
    rmse: float | None
    n: int
    noise: float
    correlated: float = 0.0
    correlation_time_s: float = 0.0
    innovation: float | None = None


@dataclasses.dataclass(frozen=True)
class RunFit:
    """One fitted run.

    Attributes:
        name: of the run.
        path: of its file; None for a run that was made in memory.
        sha256: checksum of the file.
        channels: by name.
        parameters: what was free in this run alone, or in its group of runs, by path.
    """

    name: str
    path: str | None
    sha256: str | None
    channels: dict[str, ChannelFit]
    parameters: dict[str, OwnEstimate] = dataclasses.field(default_factory=dict)

    @property
    def recording(self) -> str:
        """Name of the recording that it is, or is a window of."""
        return self.name if self.path is None else Path(self.path).stem

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(
            name=record["name"],
            path=record["path"],
            sha256=record["sha256"],
            channels=_channels(ChannelFit, record),
            parameters={
                path: OwnEstimate(**item) for path, item in record.get("parameters", {}).items()
            },
        )


@dataclasses.dataclass(frozen=True)
class ChannelErrors:
    """Errors of prediction of one channel, in the unit of the recording.

    Attributes:
        unit: of the recording.
        rmse: root mean square error; infinite (None from a file) where the simulation failed.
        largest: largest absolute error; likewise.
        n: number of measured values.
    """

    unit: str
    rmse: float | None
    largest: float | None
    n: int


@dataclasses.dataclass(frozen=True)
class PredictionErrors:
    """How far a prediction is from what a run recorded.

    Attributes:
        name: of the run.
        path: of its file; None for a run that was made in memory.
        channels: by name.
    """

    name: str
    path: str | None
    channels: dict[str, ChannelErrors]

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(record["name"], record["path"], _channels(ChannelErrors, record))


@dataclasses.dataclass(frozen=True)
class HeldChannel:
    """How well what was held out of one channel is predicted, in the unit of the recording.

    What these cells alone know, such as the free initial state of a run of which nothing was
    fitted, is fitted to them.

    Attributes:
        unit: of the recording.
        rmse: root mean square error of the held-out cells; infinite (None from a file) where the
            simulation failed; None where Ctrl-C came before.
        n: number of these cells.
        size: how many times as far off they are as noise and the uncertainty of the parameters
            allow, in the root mean square; infinite likewise. None where there is nothing to judge,
            because as many parameters are known from these cells alone.
    """

    unit: str
    rmse: float | None
    n: int
    size: float | None


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """What was held out of one run, and is predicted.

    Attributes:
        name: of the run.
        path: of its file; None for a run that was made in memory.
        sha256: checksum of the file.
        channels: those of which cells were held out, by name.
    """

    name: str
    path: str | None
    sha256: str | None
    channels: dict[str, HeldChannel]

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        channels = _channels(HeldChannel, record)
        return cls(record["name"], record["path"], record["sha256"], channels)


def _channels(kind: type[Channel], record: Mapping[str, Any]) -> dict[str, Channel]:
    """The records of the channels that an object of `result.json` holds."""
    return {name: kind(**item) for name, item in record["channels"].items()}
