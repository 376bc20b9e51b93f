"""What the data of a fit cannot tell, as codes with a sentence and advice.

`docs/findings.md` has a section for each code. The file is longer than 200 lines because the
sentences of all findings are read together.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self

import numpy as np

from .._text import one_of
from ._combinations import combinations
from ._curvature import Curvature
from ._state import FitState
from ._statistics import Statistics

# Correlations beyond this leave little more than a combination of the two.
_CORRELATED = 0.95

# Many pairs are one cause: the worst ones show it.
_MOST_PAIRS = 10

# A third of a standard error's square, or of its symmetry.
_BENT = 0.3

# Standard deviations of a prior that the data have moved a parameter by.
_AGAINST = 3.0

# A prior that says more than this of a parameter.
_MOSTLY = 0.5

# Normal quantile of a one-sided interval of 95 %.
_ONE_SIDED = 1.645

# Correlation times without which an estimate of the correlation, and all errors, are uncertain.
_LONG_ENOUGH = 20.0


@dataclasses.dataclass(frozen=True)
class Finding:
    """Something that the data of a fit cannot tell, or a reason to doubt an error.

    Attributes:
        code: what it is, the name of its section in `docs/findings.md`.
        paths: of the parameters that it is about; with the runs where these are not all.
        sentence: what there is.
        advice: what to do about it.
    """

    code: str
    paths: tuple[str, ...]
    sentence: str
    advice: str

    @property
    def page(self) -> str:
        """Where the documentation has it."""
        return f"docs/findings.md#{self.code}"

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The finding that an object of `result.json` holds."""
        return cls(**{**record, "paths": tuple(record["paths"])})


def findings(
    state: FitState,
    statistics: Statistics,
    curvatures: Mapping[int, Curvature],
    correlation_times: Sequence[tuple[str, float]] = (),
) -> tuple[Finding, ...]:
    """What the data cannot tell.

    Arguments:
        state: the last one.
        statistics: of the fit.
        curvatures: by position of a parameter, where they are known.
        correlation_times: names of records, and how many times the correlation time of its noise
            each is long.
    """
    return (
        *_without_response(state, statistics),
        *_together(state, statistics),
        *_correlated(state, statistics),
        *_at_bounds(state, statistics),
        *_priors(state, statistics),
        *_bent(statistics, curvatures),
        *_short(correlation_times),
    )


def _without_response(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    dead = np.setdiff1d(np.arange(state.problem.size), statistics.alive)
    names = tuple(statistics.labels[i] for i in dead)
    if names:
        yield Finding(
            "no_response",
            names,
            f"no channel responds to {', '.join(names)}",
            "leave it held, give it a prior, or record a motion that it acts on",
        )


def _together(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    lower = np.asarray(state.problem.bijector.lower)
    shared = zip(state.setup.parameters, state.problem.positions, strict=True)
    held = {place: p.declaration.frozen for p, places in shared for place in places}
    usual = [held.get(index, False) for index in range(len(lower))]
    for members, known in combinations(statistics, (lower >= 0).tolist(), usual):
        names = tuple(statistics.labels[i] for i in members)
        said = " and ".join(map(str, known)) or "nothing"
        yield Finding(
            "only_combinations",
            names,
            f"the data determine none of {', '.join(names)} alone, only {said}",
            f"state one of them with its deviation as a prior, or hold it ({one_of(names)}); "
            "the combinations do not depend on which",
        )


def _correlated(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    correlation, determined = statistics.correlation, statistics.determined
    pairs = [
        (abs(correlation[i, j]), i, j)
        for i in range(len(determined))
        for j in range(i)
        if determined[j] < state.problem.shared and abs(correlation[i, j]) > _CORRELATED
    ]
    for _, i, j in sorted(pairs, reverse=True)[:_MOST_PAIRS]:
        names = (statistics.labels[determined[j]], statistics.labels[determined[i]])
        yield Finding(
            "correlated",
            names,
            f"{names[0]} and {names[1]} have a correlation of {correlation[i, j]:+.3f}, so that a "
            "change of one is nearly undone by one of the other",
            "do not read one without the other; a prior on one, or a run in which they act at "
            "different times, tells them apart",
        )


def _at_bounds(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    bijector = state.problem.bijector
    residual = np.asarray(state.inner.residual, dtype=float)
    gradient = state.natural_jacobian().transposed_times(residual)
    for index, side in statistics.bounds.items():
        bound = (bijector.lower if side == "lower" else bijector.upper)[index]
        error = statistics.standard_errors[index]
        # The cost rises from the bound as g t + t^2 / (2 s^2), in units of the noise.
        push = abs(float(gradient[index])) / statistics.scale * error
        reach = error * (np.hypot(push, _ONE_SIDED) - push)
        most = (
            f"at most {bound + reach:.3g}" if side == "lower" else f"at least {bound - reach:.3g}"
        )
        name = statistics.labels[index]
        yield Finding(
            "at_a_bound",
            (name,),
            f"{name} is at its {side} bound {bound:g}, and {most} (one-sided, 95 %)",
            "read the one-sided interval in place of the error; ask whether the bound is right, or "
            "another part of the model wrong",
        )


def _priors(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    priors = state.problem.priors
    rows = np.asarray(state.inner.residual, dtype=float)[-len(priors) :] if len(priors) else ()
    for index, row in zip(priors.columns, rows, strict=True):
        name = statistics.labels[index]
        if abs(row) > _AGAINST:
            yield Finding(
                "against_its_prior",
                (name,),
                f"the data move {name} by {abs(row):.2g} standard deviations of its prior",
                "ask whether the prior is right, or the model wrong elsewhere",
            )
        elif statistics.prior_shares.get(index, 0.0) > _MOSTLY:
            share = statistics.prior_shares[index]
            yield Finding(
                "mostly_its_prior",
                (name,),
                f"{share:.0%} of what is known of {name} is its prior",
                "take its value as what was known before, not as a result",
            )


def _bent(statistics: Statistics, curvatures: Mapping[int, Curvature]) -> Iterator[Finding]:
    for index, bent in curvatures.items():
        name = statistics.labels[index]
        if max(abs(bent.left_out), abs(bent.skew)) > _BENT:
            yield Finding(
                "curved",
                (name,),
                f"the standard error of {name} does not say how far it may go, because within it "
                f"the second derivatives change the cost by {bent.left_out:+.0%}, and one side "
                f"against the other by {bent.skew:+.0%}",
                "see how far it may go by giajax profile, or record more",
            )


def _short(correlation_times: Sequence[tuple[str, float]]) -> Iterator[Finding]:
    for name, count in correlation_times:
        if count < _LONG_ENOUGH:
            yield Finding(
                "short_record",
                (),
                f"'{name}' is {count:.2g} correlation times of its noise long",
                f"record at least {_LONG_ENOUGH:g} of them, or state the noise: its correlation "
                "cannot be estimated from fewer",
            )
