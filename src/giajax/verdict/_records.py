"""The verdict on a fit, as data."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, Self

VerdictStatus = Literal["adequate", "inadequate", "not evaluated"]


@dataclasses.dataclass(frozen=True)
class Reason:
    """One way in which residuals are not what the noise alone would leave.

    Attributes:
        code: "noise", "correlation", "differences", "drift", "runs" or "prediction".
        sentence: what is seen, and where.
        p_value: chance of as much from the noise alone, corrected for how often was looked.
        size: how many times the noise the residuals are for this reason.
        channels: where it is seen most, by name.
    """

    code: str
    sentence: str
    p_value: float
    size: float
    channels: tuple[str, ...] = ()

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(**{**record, "channels": tuple(record.get("channels", ()))})


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether the model describes the data; apart from whether the fit converged.

    Attributes:
        status: "adequate", "inadequate", or "not evaluated".
        reasons: why it is inadequate, the surest first; or the one why it was not evaluated.
    """

    status: VerdictStatus
    reasons: tuple[Reason, ...] = ()

    @property
    def sentence(self) -> str:
        """Status and reasons in a line."""
        if not self.reasons:
            return self.status
        return f"{self.status}: {'; '.join(reason.sentence for reason in self.reasons)}"

    @classmethod
    def missing(cls) -> Self:
        """That of a result which was written without one."""
        return cls("not evaluated")

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(record["status"], tuple(Reason.of_json(item) for item in record["reasons"]))
