"""What a result says of a run: small frozen records, each of which JSON gives back.

Field by field they are objects of `result.json`, as those of `_records.py`.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Self


@dataclasses.dataclass(frozen=True)
class OwnEstimate:
    """A parameter of one run alone, such as an initial angle: its value and standard error, SI."""

    value: float
    standard_error: float | None


@dataclasses.dataclass(frozen=True)
class ChannelFit:
    """How well one channel of a fitted run is described, in the unit of the recording.

    Attributes:
        unit: of the recording.
        rmse: root mean square of recorded minus predicted; None where that is not finite.
        n: number of measured values.
        noise: standard deviation that the values were weighted with.
    """

    unit: str
    rmse: float | None
    n: int
    noise: float


@dataclasses.dataclass(frozen=True)
class RunFit:
    """One fitted run.

    Attributes:
        name: of the run.
        path: of its file; None for a run that was made in memory.
        sha256: checksum of the file.
        channels: by name.
        parameters: what was free in this run alone, by path.
    """

    name: str
    path: str | None
    sha256: str | None
    channels: dict[str, ChannelFit]
    parameters: dict[str, OwnEstimate] = dataclasses.field(default_factory=dict)

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(
            name=record["name"],
            path=record["path"],
            sha256=record["sha256"],
            channels={name: ChannelFit(**item) for name, item in record["channels"].items()},
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
        channels = {name: ChannelErrors(**item) for name, item in record["channels"].items()}
        return cls(record["name"], record["path"], channels)
