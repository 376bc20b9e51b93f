"""Whether a result reaches the figures that a fit definition asks for."""

import dataclasses

from .._text import format_estimate
from ..fitting import Estimate, FitResult
from ..models import AbstractModel
from ..parameters import find, switched_on
from ..runs import Definition, Figure


@dataclasses.dataclass(frozen=True)
class Reached:
    """One figure of a definition: whether the result reaches it, and a sentence that says so."""

    path: str
    reached: bool
    sentence: str


def check_figures(model: AbstractModel, definition: Definition) -> None:
    """Refuse `[figures]` of parameters that the model does not have, before anything is fitted.

    Arguments:
        model: the one that is to be fitted.
        definition: with its `[figures]`.

    Raises:
        InputError: naming the path and the nearest one.
    """
    asked = definition.fit
    model = switched_on(model, (*(asked.free or ()), *(asked.start or ()), *(asked.fix or ())))
    derived = model.derived()
    for path in definition.figures:
        if path not in derived:
            find(model, path)


def reached(result: FitResult, definition: Definition) -> list[Reached]:
    """Compare a result with the `[figures]` of a fit definition.

    Arguments:
        result: the result of the fit.
        definition: with its `[figures]`.

    Returns:
        One for each figure, in the order of the definition.
    """
    estimates = {**result.parameters, **result.derived}
    return [
        Reached(path, *_compare(estimates.get(path), figure))
        for path, figure in definition.figures.items()
    ]


def _compare(estimate: Estimate | None, figure: Figure) -> tuple[bool, str]:
    value, allowed, relative = figure.value, figure.standard_errors, figure.relative_error
    if estimate is None or not estimate.free:
        return False, "was not fitted"
    error = estimate.standard_error
    # An error beyond the value is what the result itself calls barely determined.
    determined = error is not None and error <= abs(estimate.value)
    if figure.determined is False:
        return not determined, "is not determined" if not determined else "is determined"
    if error is None or not error > 0:
        return False, "has no standard error"
    shown = " +- ".join(format_estimate(estimate.value, error))
    sentences, good = [], True
    if value is not None and allowed is not None:
        away = abs(estimate.value - value) / error
        good &= away <= allowed
        sentences.append(f"{away:.2g} standard errors from {value:g} (at most {allowed:g})")
    if value is not None and figure.within is not None:
        off = abs(estimate.value / value - 1) if value else abs(estimate.value)
        good &= off <= figure.within
        sentences.append(f"{off:.2%} from {value:g} (at most {figure.within:.2%})")
    if relative is not None:
        achieved = error / abs(estimate.value) if estimate.value else float("inf")
        good &= achieved <= relative
        sentences.append(f"standard error {achieved:.2%} (at most {relative:.2%})")
    return good, f"{shown}: {', '.join(sentences)}"
