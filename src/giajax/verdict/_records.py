"""The verdict on a fit, as data."""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal, Self

VerdictStatus = Literal["adequate", "inadequate", "not evaluated"]


@dataclasses.dataclass(frozen=True)
class Reason:
    """One way in which residuals are not what the noise alone would leave.

    Attributes:
        code: "noise", "correlation", "differences", "drift", "runs" or "prediction".
        sentence: what is seen, and where.
        p_value: chance of as much from the noise alone, corrected for how often was looked.
        size: how many times the noise the residuals are for this reason; infinite where the model
            cannot be evaluated.
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
        size = math.inf if record["size"] is None else record["size"]
        return cls(**{**record, "size": size, "channels": tuple(record.get("channels", ()))})


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether the model describes the data; apart from whether the fit converged.

    Attributes:
        status: "adequate", "inadequate", or "not evaluated".
        reasons: why it is inadequate, the surest first; or the one why it was not evaluated.
    """

    status: VerdictStatus
    reasons: tuple[Reason, ...] = ()

    @classmethod
    def inadequate(cls, reasons: Iterable[Reason]) -> Self:
        """That for some reasons."""
        surest = sorted(reasons, key=lambda reason: (reason.p_value, -reason.size))
        return cls("inadequate", tuple(surest))

    def with_reason(self, reason: Reason) -> Self:
        """With one more reason; what was not evaluated for want of cells is inadequate by it."""
        others = self.reasons if self.status == "inadequate" else ()
        return self.inadequate((*others, reason))

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
