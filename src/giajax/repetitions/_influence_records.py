"""What each part of the data does to a fit, as data: `influence.json` gives each record back."""

import dataclasses
import json
from typing import Self

from .._errors import InputError

SCHEMA_VERSION = 1


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """A fit without a part of its data, by parameter.

    Attributes:
        kind: of the part: "run", "marker", "channel" or "span".
        name: of the part.
        cells: how many it has.
        steps: shift of each parameter to first order, in its standard errors; None of what the
            rest does not determine. What a run that is left out has for itself is not there.
        widening: standard error without the part over that with it, likewise.
        exact: shift by a fit; None where none was asked for, or where it did not converge. A
            parameter that the rest does not determine is None.
        exact_widening: likewise; where the noise is scaled by the residuals, with their scale.
        reason: what ended a fit that did not converge (`FitResult.reason`).
    """

    kind: str
    name: str
    cells: int
    steps: dict[str, float | None]
    widening: dict[str, float | None]
    exact: dict[str, float | None] | None = None
    exact_widening: dict[str, float | None] | None = None
    reason: str = ""

    @property
    def shifts(self) -> dict[str, float | None]:
        """By a fit where there was one, else to first order."""
        return self.steps if self.exact is None else self.exact

    @property
    def largest(self) -> float:
        """The largest shift of a parameter, in standard errors; infinite where one is lost."""
        return max(
            (float("inf") if shift is None else abs(shift) for shift in self.shifts.values()),
            default=0.0,
        )

    @property
    def surprise(self) -> float | None:
        """The largest shift over that to expect; None where nothing is to be expected.

        Of a right model, a part moves an estimate by a random amount, whose variance is that
        without the part less that with it (Hausman 1978): beyond 3 it is no chance.
        """
        ratios = []
        for path, shift in self.shifts.items():
            wider = self.widening[path]
            if shift is not None and wider is not None and wider**2 > 1 + 1e-9:
                ratios.append(abs(shift) / (wider**2 - 1) ** 0.5)
        return max(ratios, default=None)


@dataclasses.dataclass(frozen=True)
class Influence:
    """What each part of the data does to the parameters of a fit.

    Attributes:
        parameters: standard error of each that the data determine, SI.
        parts: without which the fit was asked, the largest shift first.
        notes: sentences on what the numbers leave out.
        fitted: values of the free parameters of the result, by which a reader knows whose it is.
    """

    parameters: dict[str, float]
    parts: tuple[LeftOut, ...]
    notes: tuple[str, ...]
    fitted: dict[str, float]

    def of_kind(self, kind: str) -> tuple[LeftOut, ...]:
        """The parts of a kind: "run", "marker", "channel" or "span"."""
        return tuple(part for part in self.parts if part.kind == kind)

    def to_json(self) -> str:
        """The text of `influence.json`."""
        record = {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(self)}
        return json.dumps(record, indent=1, allow_nan=False) + "\n"

    @classmethod
    def of_json(cls, text: str | bytes) -> Self:
        """The record that a text of `to_json` holds.

        Raises:
            InputError: it is of none, or of a later version.
        """
        try:
            record = json.loads(text)
            if record.pop("schema_version") != SCHEMA_VERSION:
                raise ValueError
            parts = tuple(LeftOut(**part) for part in record.pop("parts"))
            return cls(parts=parts, **{**record, "notes": tuple(record["notes"])})
        except (ValueError, LookupError, TypeError, AttributeError):
            raise InputError(
                "this is no influence.json of this version of giajax: ask for it again"
            ) from None
