"""What repetitions of a fit say, as data: `bootstrap.json` gives each record back."""

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, Literal, Self

from .._errors import InputError

Method = Literal["parametric", "block"]

SCHEMA_VERSION = 1


@dataclasses.dataclass(frozen=True)
class Repeated:
    """One parameter, or what follows from the parameters, over the fits that came back.

    What needs two fits at least is None with fewer.

    Attributes:
        value: where the repetitions begin and what made their data, SI.
        standard_error: that the result states.
        unit: SI.
        bias: mean of the repetitions less the value, in standard errors.
        bias_error: Monte Carlo error of the bias: one standard deviation.
        spread: standard deviation of the repetitions, SI.
        ratio: spread over standard error.
        ratio_error: Monte Carlo error of the ratio: one standard deviation, of normal estimates.
        percentile: from the 2.5th to the 97.5th percentile of the repetitions.
        basic: the same, mirrored at the value: what the value may have come from.
        covered: of how many repetitions the 95 % interval holds the value that made their data;
            None where that is no truth (blocks), or of what has no interval.
        asked: how many have an interval.
        coverage: `covered` over `asked`.
        coverage_interval: where the coverage is by 95 % (Clopper and Pearson 1934).
        values: of the repetitions, SI.
    """

    value: float
    standard_error: float | None
    unit: str
    bias: float | None
    bias_error: float | None
    spread: float | None
    ratio: float | None
    ratio_error: float | None
    percentile: tuple[float, float] | None
    basic: tuple[float, float] | None
    covered: int | None
    asked: int
    coverage: float | None
    coverage_interval: tuple[float, float] | None
    values: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class Bootstrap:
    """What repetitions of a fit say of its standard errors and intervals.

    Attributes:
        method: "parametric": data of the fitted model with noise of the fitted noise model; or
            "block": with blocks of the residuals.
        seed: of all repetitions.
        size: repetitions that were done.
        asked: repetitions that were asked for; more than `size` where Ctrl-C or an error came.
        whole: whether each was fitted as the data were, noise and all; else with the noise as the
            result has it.
        came_back: fits that converged, of which the parameters tell.
        reasons: how often each other reason (`FitResult.reason`) ended one.
        failures: sentences of repetitions that could not be done, each once.
        at_bounds: how often each parameter ended at a bound, of the fits that came back.
        parameters: by name: those that the data determine, then what follows from them.
        block_lengths: by run, in samples; empty without blocks.
        noise_factor: by what the noise of the model was multiplied: 1 unless the residuals exceed
            the stated noise, whose standard errors are scaled alike.
        notes: sentences on what the repetitions leave out.
        fitted: values of the free parameters of the result, by which a reader knows whose it is.
    """

    method: Method
    seed: int
    size: int
    asked: int
    whole: bool
    came_back: int
    reasons: dict[str, int]
    failures: tuple[str, ...]
    at_bounds: dict[str, int]
    parameters: dict[str, Repeated]
    block_lengths: dict[str, int]
    noise_factor: float
    notes: tuple[str, ...]
    fitted: dict[str, float]

    def to_json(self) -> str:
        """The text of `bootstrap.json`."""
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
            repeated = {path: _repeated(item) for path, item in record["parameters"].items()}
            tuples = {key: tuple(record[key]) for key in ("failures", "notes")}
            return cls(**{**record, **tuples, "parameters": repeated})
        except (ValueError, LookupError, TypeError, AttributeError):
            raise InputError(
                "this is no bootstrap.json of this version of giajax: repeat the fit again"
            ) from None


def _repeated(record: Mapping[str, Any]) -> Repeated:
    pairs = ("percentile", "basic", "coverage_interval", "values")
    tuples = {key: None if record[key] is None else tuple(record[key]) for key in pairs}
    return Repeated(**{**record, **tuples})
