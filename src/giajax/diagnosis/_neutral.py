"""Parts that change what a model predicts at the value at which they ought to change nothing.

A test of a part that is left out begins where it does nothing. Added mass of 0 is none in still
air; but in a recorded wind that changes, what is on has the pressure of the air that speeds up as
well, which acts on whatever displaces it.
"""

import contextlib
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Response
from ..parameters import left_out
from ..runs import Run
from ._ended import responses_of
from ._weights import white_noise

_REASON = (
    "also at its neutral value it changes what is predicted for these runs, so that no test can "
    "begin there: free it in a fit"
)

# Of the noise of a channel: what the steps of an integrator change is far less.
_NOTICED = 0.05


def is_disturbed(result: FitResult, runs: Sequence[Run], at: Sequence[Response]) -> bool:
    """Whether responses are not those of the fit, by the residuals that it had.

    Arguments:
        result: of the fit.
        runs: that were fitted.
        at: of the fitted model with all parts on, at their neutral values.
    """
    for run, record, response in zip(runs, result.runs, at, strict=True):
        rest = response.predicted - response.observed
        for place, name in enumerate(response.channels):
            known = record.channels.get(name)
            if known is None or known.rmse is None:
                continue
            root = run.channels[name].from_si(float(np.sqrt(np.nanmean(rest[:, place] ** 2))))
            if abs(root - known.rmse) > _NOTICED * known.noise:
                return True
    return False


def not_neutral(result: FitResult, runs: Sequence[Run]) -> dict[str, str]:
    """What of a disturbed model cannot be tested at its neutral value, with the reason, by path.

    Found by halving, because each set of parts is a program of its own.

    Arguments:
        result: of a fit.
        runs: that were fitted.
    """
    at = responses_of(result, runs, result.model)
    noise = white_noise(result, runs, at)
    parts = []
    for path, absent in left_out(result.model).items():
        with contextlib.suppress(InputError):  # It is not asked for.
            if not absent.declaration.has_states:
                absent.set(result.model, absent.declaration.neutral)
                parts.append(path)

    def changes(paths: Sequence[str]) -> bool:
        model = result.model
        for path in paths:
            absent = left_out(model)[path]
            model = absent.set(model, absent.declaration.neutral)
        return any(
            np.nanmax(np.abs(two.predicted - one.predicted) / [sigma[n] for n in one.channels])
            > _NOTICED
            for one, two, sigma in zip(at, responses_of(result, runs, model), noise, strict=True)
        )

    def within(paths: Sequence[str]) -> list[str]:
        """Those of some paths of which at least one ought to change something."""
        if len(paths) < 2:
            # If none does by itself, it is the integrator's steps that do.
            return [path for path in paths if changes([path])]
        first, second = paths[: len(paths) // 2], paths[len(paths) // 2 :]
        in_first = changes(first)
        in_second = changes(second) if in_first else True
        return (within(first) if in_first else []) + (within(second) if in_second else [])

    return dict.fromkeys(within(parts), _REASON)
