"""What a result says of what its model leaves out and holds: records of `result.json`."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, Self

SuspectKind = Literal["parameter", "factor", "group", "switch", "axes"]


@dataclasses.dataclass(frozen=True)
class Suspect:
    """One test of something that a fit held, switched off or left out.

    Attributes:
        path: of the parameter, such as `camera.delay` or `air.wind[2]`; of a group that of its
            elements; of a switch or of axes what is changed.
        kind: "parameter"; "factor", of an array whose elements change in proportion; "group",
            several elements together; "switch", a choice of the model; "axes", of the recording.
        unit: SI unit of the estimate; "" for a factor and for a switch, whose estimate is the
            share, from 0 to 1, of the change that it would make.
        value: what the fit held; a list for a group, None for axes.
        estimate: what one step from the fit leads to, within the bounds; likewise.
        estimate_error: its standard error; likewise, and None where it is not testable.
        chi_square_drop: by how much that would lower the sum of squared residuals, in units of
            the noise; None where it is not testable.
        degrees_of_freedom: of the test.
        p_value: of the test, corrected for how many were asked; None where it is not testable.
        testable: whether the data would show it, beside what the fit moved.
        alike: paths of other suspects that the data can hardly tell from this one.
        note: why it is not testable, or what a reader must know; may be empty.
    """

    path: str
    kind: SuspectKind
    unit: str
    value: float | list[float] | None
    estimate: float | list[float] | None
    estimate_error: float | list[float] | None
    chi_square_drop: float | None
    degrees_of_freedom: int
    p_value: float | None
    testable: bool
    alike: tuple[str, ...] = ()
    note: str = ""

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(**{**record, "alike": tuple(record["alike"])})


@dataclasses.dataclass(frozen=True)
class SystematicError:
    """What one held number does to the fitted ones.

    Attributes:
        path: of the held parameter.
        unit: its SI unit.
        value: what it is held at; a list where its elements differ.
        uncertainty: its standard deviation, as stated, or 1 % of it; of elements that differ, a
            fraction of each.
        stated: whether it was stated.
        shifts: what that does to each fitted parameter, SI, by path.
        decides: paths of the parameters that it moves by more than a standard error.
    """

    path: str
    unit: str
    value: float | list[float]
    uncertainty: float
    stated: bool
    shifts: dict[str, float]
    decides: tuple[str, ...] = ()

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(**{**record, "decides": tuple(record["decides"])})
