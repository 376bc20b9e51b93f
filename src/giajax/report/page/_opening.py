"""What a reader must know before any number: whether to believe them, and what limits them.

The sentences say nothing that is not in the result; they say it in the order in which it matters.
"""

from typing import NamedTuple

from ..._text import format_estimate
from ...diagnosis import LEVEL, promising
from ...fitting import Estimate, FitResult, in_column_units
from .._text import WRONG_DERIVATIVES

# Correlations beyond this, errors beyond this part of a value, and predictions of what was held
# out that are off by so many times what they should be, are worth a sentence.
_CORRELATED, _VAGUE, _FAR_OFF = 0.9, 0.1, 1.5

# A shift of a held number, or of the tolerance, by this many standard errors is too.
_NOTABLE = 0.5

# Findings that the parameters' own sentences here say already.
_SAID = ("no_response", "correlated")


class Opening(NamedTuple):
    """What stands at the top of a page.

    Attributes:
        grade: "good", "doubtful" or "bad", which colours it.
        headline: one sentence.
        limits: sentences on what limits the numbers, the most important first.
    """

    grade: str
    headline: str
    limits: list[str]


def opening(result: FitResult) -> Opening:
    """The verdict in plain words."""
    limits = [
        *_of_the_model(result),
        *_undetermined(result),
        *_held_numbers(result),
        *_precision(result),
        *_prediction(result),
        *_computation(result),
    ]
    if result.status != "converged":
        return Opening(
            "bad",
            f"Do not use these numbers yet: {result.message}",
            limits,
        )
    if result.verdict.status == "inadequate":
        return Opening(
            "bad",
            "The fit has converged, but the model does not describe the data: the standard errors "
            "are those of a model that is not right, and the true errors may be larger",
            limits,
        )
    if result.verdict.status == "not evaluated":
        return Opening(
            "doubtful",
            "The fit has converged; whether the model describes the data was not judged",
            limits,
        )
    if _undetermined(result):
        return Opening(
            "doubtful",
            "The fit has converged and the model describes the data to within the noise, but not "
            "all parameters are determined by them",
            limits,
        )
    if _has_wrong_derivatives(result):
        return Opening(
            "doubtful",
            "The fit has converged and the model describes the data to within the noise, but the "
            "derivatives by which it got there are not right",
            limits,
        )
    return Opening(
        "good",
        "The fit has converged, and the model describes the data to within the noise",
        limits,
    )


def _of_the_model(result: FitResult) -> list[str]:
    reasons = result.verdict.reasons if result.status == "converged" else ()
    said = [reason.sentence for reason in reasons]
    asked = [row for row in promising(result.suspects) if (row.p_value or 0.0) < LEVEL]
    if asked:
        said.append(
            f"the residuals ask most for {asked[0].path}, which the model holds or leaves out"
        )
    return said


def _undetermined(result: FitResult) -> list[str]:
    without = [path for path, one in result.free.items() if one.standard_error is None]
    if not without:
        return []
    return [f"the data do not determine {', '.join(without)}: read no value of it"]


def _held_numbers(result: FitResult) -> list[str]:
    said = []
    for error in result.systematic:
        if error.decides:
            change = "its uncertainty" if error.stated else "1 % of it"
            said.append(
                f"{error.path} is held, and {change} moves {', '.join(error.decides)} by more than "
                "a standard error"
            )
    return said


def _precision(result: FitResult) -> list[str]:
    said = []
    known = {path: share for path, one in result.free.items() if (share := _share(one)) is not None}
    if known:
        worst = max(known, key=lambda path: known[path])
        if known[worst] > _VAGUE:
            one = in_column_units(result.free, result.model)[worst]
            value, error = format_estimate(one.value, one.standard_error)
            unit = f" {one.unit}" if one.unit else ""
            said.append(f"{worst} is known worst: {value} \N{PLUS-MINUS SIGN} {error}{unit}")
    pairs = [
        (abs(number), number, result.correlation.parameters[j], result.correlation.parameters[i])
        for i, row in enumerate(result.correlation.matrix)
        for j, number in enumerate(row[:i])
        if number is not None and abs(number) > _CORRELATED
    ]
    if pairs:
        _, correlation, one_path, other = max(pairs)
        said.append(
            f"{one_path} and {other} are told apart badly (correlation {correlation:+.3f}): do not "
            "read one without the other"
        )
    said += [one.sentence for one in result.findings if one.code not in _SAID]
    return said


def _share(one: Estimate) -> float | None:
    if one.standard_error is None or not isinstance(one.value, float) or not one.value:
        return None
    return abs(one.standard_error / one.value)


def _prediction(result: FitResult) -> list[str]:
    channels = [channel for record in result.held_out for channel in record.channels.values()]
    sizes = [channel.size for channel in channels if channel.size is not None]
    if not channels and not result.validation:
        return ["nothing was held out, so how well the model predicts is not tested"]
    if sizes and max(sizes) > _FAR_OFF:
        return [
            f"what was held out is predicted up to {max(sizes):.2g} times as far off as noise and "
            "the parameters allow"
        ]
    return []


def _computation(result: FitResult) -> list[str]:
    said = []
    if result.noise is not None and result.noise.estimated:
        said.append("the size of the noise was taken from the residuals, at least in part")
    effect = result.tolerance_effect
    largest = None if effect is None else effect.largest_in_standard_errors
    if largest is not None and largest > _NOTABLE:
        said.append(f"a finer tolerance of the solver would move a value by {largest:.2g} errors")
    if _has_wrong_derivatives(result):
        said.append("the derivatives disagree with differences, so the fit may have ended anywhere")
    return said


def _has_wrong_derivatives(result: FitResult) -> bool:
    check = result.gradient_check
    return check is not None and check.relative_difference > WRONG_DERIVATIVES
