"""A result with what its residuals ask for, and with what its held numbers decide."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from ..fitting import FitResult
from ..runs import Run
from ._suspects import suspects
from ._systematic import deciding_conditions, systematic_errors


def with_suspects(
    result: FitResult, runs: Run | Sequence[Run], *, each: Sequence[str] = ()
) -> FitResult:
    """The result with its suspects (`giajax.suspects`) and its systematic errors.

    Arguments:
        result, runs, each: as of `giajax.suspects`.

    Returns:
        The same result with `suspects`, `systematic` and further `conditions`.

    Raises:
        InputError: as `giajax.suspects`.
    """
    asked = dataclasses.replace(result, suspects=suspects(result, runs, each=each).rows)
    return with_systematic_errors(asked, runs)


def with_systematic_errors(
    result: FitResult,
    runs: Run | Sequence[Run],
    uncertainty: Mapping[str, Any] | None = None,
) -> FitResult:
    """The result with its systematic errors, and a condition for each held number that decides.

    Arguments:
        result, runs, uncertainty: as of `giajax.systematic_errors`; what is stated here is kept
            in `result.config`.

    Returns:
        The same result with `systematic` and further `conditions`.

    Raises:
        InputError: as `giajax.systematic_errors`.
    """
    errors = systematic_errors(result, runs, uncertainty)
    before = deciding_conditions(result.systematic)
    conditions = [condition for condition in result.conditions if condition not in before]
    stated = {} if uncertainty is None else {"uncertainty": dict(uncertainty)}
    return dataclasses.replace(
        result,
        systematic=errors,
        conditions=(*conditions, *deciding_conditions(errors)),
        config={**result.config, **stated},
    )
