"""Bootstrap: repeat a fit with resampled data."""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Self, Unpack, get_args

import numpy as np
from scipy.special import betaincinv

from ..fitting import FitResult, Optimum, Recorded, Statistics, student_reach
from ..models import capabilities
from ..noise import ChannelNoise, drawn
from ..recordings import Run
from ..runtime.arrays import Float
from ..runtime.execution import Execution
from ..runtime.text import InputError, keywords_listed
from ..schema.parameters import get
from ._refit import Fitted, StudyRecord, end_values, optimum_of, refit

Method = Literal["parametric", "block"]


@dataclasses.dataclass(frozen=True)
class Repeated:
    """Statistics of one parameter, or one derived quantity, over the repetitions that converged.

    Statistics that require at least two fits are None with fewer.

    Attributes:
        value: value from which the data of the repetitions were generated and at which each
            repetition starts, SI.
        standard_error: standard error stated by the result, SI.
        unit: SI unit.
        bias: mean of the repetitions minus the value, in units of the standard error.
        bias_error: Monte Carlo error of the bias (one standard deviation).
        spread: standard deviation of the repetitions, SI.
        ratio: spread divided by the standard error.
        ratio_error: Monte Carlo error of the ratio (one standard deviation), for normally
            distributed estimates.
        percentile: interval from the 2.5th to the 97.5th percentile of the repetitions.
        basic: basic bootstrap interval: the percentile interval mirrored at the value.
        covered: number of repetitions whose 95 % interval contains the value from which their data
            were generated; None if that value is not the truth (blocks), or if there are no
            intervals.
        asked: number of repetitions that have an interval.
        coverage: `covered` divided by `asked`.
        coverage_interval: 95 % confidence interval of the coverage (Clopper and Pearson 1934).
        values: values of the repetitions, SI.
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
class Bootstrap(
    StudyRecord,
    file="bootstrap.json",
    head={"schema_version": 1},
    remedy="run 'giajax bootstrap' again",
):
    """Check of the standard errors and intervals of a fit by repetitions.

    Attributes:
        method: "parametric": data simulated with the fitted model and the fitted noise model; or
            "block": predictions plus resampled blocks of the residuals.
        seed: seed of all repetitions.
        size: number of repetitions that were completed.
        asked: number of repetitions that were requested; more than `size` after Ctrl-C or an error.
        whole: whether each repetition was a complete fit, including the noise; otherwise the noise
            is fixed at its value in the result.
        came_back: number of repetitions that converged; the statistics of the parameters are based
            on these.
        reasons: number of repetitions that ended for each other reason (`FitResult.reason`).
        failures: error messages of repetitions that failed, without duplicates.
        at_bounds: number of converged repetitions in which each parameter ended at a bound.
        parameters: statistics by name: first the parameters that the data determine, then the
            derived quantities.
        block_lengths: block length of each run, in samples; empty for the parametric method.
        noise_factor: factor on the noise of the model: 1 unless the residuals exceed the stated
            noise; the standard errors are then scaled by the same factor.
        notes: sentences on the limitations of the repetitions.
        fitted: values of the free parameters of the result, which identify the result.
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


LEVEL = 0.95


def repeated(
    value: float,
    standard_error: float | None,
    unit: str,
    values: Sequence[float],
    reaches: Sequence[float | None] | None,
) -> Repeated:
    """Return the statistics of a parameter over the repetitions.

    `reaches` contains half the width of the 95 % interval of each repetition, or None for a
    repetition without one. It is None if the coverage is not evaluated.
    """
    found = np.asarray(values, dtype=float)
    count = len(found)
    bias = bias_error = spread = ratio = ratio_error = percentile = basic = None
    if count > 1:
        spread = float(np.std(found, ddof=1))
        low, high = map(float, np.quantile(found, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]))
        percentile, basic = (low, high), (2 * value - high, 2 * value - low)
    if spread is not None and standard_error:
        bias = (float(np.mean(found)) - value) / standard_error
        bias_error = float(spread / np.sqrt(count) / standard_error)
        ratio = spread / standard_error
        ratio_error = ratio / float(np.sqrt(2 * (count - 1)))
    covered = coverage = interval = None
    known = [None] * count if reaches is None else reaches
    pairs = [(there, r) for there, r in zip(values, known, strict=True) if r is not None]
    if pairs:
        covered = sum(bool(abs(there - value) <= reach) for there, reach in pairs)
        coverage = covered / len(pairs)
        interval = binomial_interval(covered, len(pairs))
    return Repeated(
        value=value,
        standard_error=standard_error,
        unit=unit,
        bias=bias,
        bias_error=bias_error,
        spread=spread,
        ratio=ratio,
        ratio_error=ratio_error,
        percentile=percentile,
        basic=basic,
        covered=covered,
        asked=len(pairs),
        coverage=coverage,
        coverage_interval=interval,
        values=tuple(found.tolist()),
    )


def binomial_interval(covered: int, asked: int) -> tuple[float, float]:
    """Return the 95 % interval of a binomial probability (Clopper and Pearson 1934).

    There were `covered` successes in `asked` trials.
    """
    tail = (1 - LEVEL) / 2
    low = 0.0 if covered == 0 else float(betaincinv(covered, asked - covered + 1, tail))
    high = 1.0 if covered == asked else float(betaincinv(covered + 1, asked - covered, 1 - tail))
    return low, high


# Data of the fitted model with blocks of the residuals instead of noise from a noise model.
#
# Circular moving blocks (Politis and Romano 1992): rows of residuals are taken in blocks that start
# at any row and wrap around from the last row to the first, so every row is equally likely. A row
# contains all channels at one time, so residuals of the same time stay together.

# Largest block length as a fraction of the run. Longer blocks would leave too few blocks to
# shuffle.
_LARGEST_SHARE = 1 / 3


@dataclasses.dataclass(frozen=True)
class Residuals:
    """Residuals of a run, prepared for resampling in blocks of `length` samples.

    The residuals are recorded minus predicted values, SI. They have mean 0 and are scaled to the
    size of the noise. They are NaN where nothing was measured.
    """

    channels: tuple[str, ...]
    predicted: Float[np.ndarray, "sample channel"]
    residuals: Float[np.ndarray, "sample channel"]
    length: int

    @classmethod
    def of(
        cls,
        run: Run,
        predicted: Mapping[str, np.ndarray],
        noise: Mapping[str, ChannelNoise],
        inflation: float,
    ) -> Self:
        """Prepare the residuals of a run.

        `inflation` scales the residuals up to the size of the noise, because the fitted parameters
        absorb part of it.
        """
        channels = tuple(run.observations)
        table = np.stack([predicted[name] for name in channels], axis=-1)
        recorded = np.stack([run.observations[name] for name in channels], axis=-1)
        rest = recorded - table
        measured = ~np.isnan(rest)
        count = np.maximum(measured.sum(axis=0), 1)
        # Without subtracting the mean, a model error of a channel would be counted twice.
        rest = (rest - np.nansum(rest, axis=0) / count) * inflation
        return cls(channels, table, rest, block_length(run, rest, [noise[c] for c in channels]))

    def again(self, random: np.random.Generator) -> dict[str, np.ndarray]:
        """Draw the values that a repeated experiment would have recorded, by channel, SI.

        The values are NaN where this recording has none. If a measured cell receives a row in which
        its channel was not measured, a random residual of that channel is used instead.
        """
        count = len(self.residuals)
        starts = random.integers(count, size=-(-count // self.length))
        rows = (starts[:, None] + np.arange(self.length)).ravel()[:count] % count
        taken = self.residuals[rows]
        for column, own in enumerate(self.residuals.T):
            missing = np.isnan(taken[:, column])
            known = own[~np.isnan(own)]
            if len(known):
                taken[missing, column] = random.choice(known, int(missing.sum()))
        taken[np.isnan(self.residuals)] = np.nan
        table = self.predicted + taken
        return {name: table[:, column] for column, name in enumerate(self.channels)}


def block_length(
    run: Run, residuals: Float[np.ndarray, "sample channel"], noises: Sequence[ChannelNoise]
) -> int:
    """Return the number of samples of a block: n^(1/3), or more if the residuals are correlated.

    For noise with autocovariances R(k) the optimal length is (3/2 (G/g)^2 n)^(1/3), where G is the
    sum of |k| R(k) and g the sum of R(k) (Politis and White 2004, "Automatic block-length
    selection", for circular blocks). The length for the channel with the longest correlation is
    used. Its correlation follows from its fitted noise model, or from an AR(1) model of its
    residuals if the fitted noise is white.
    """
    count = len(residuals)
    step = 1.0 if run.times is None else float(np.median(np.diff(run.times)))
    longest = 0.0
    for noise, column in zip(noises, residuals.T, strict=True):
        if noise.correlated and run.times is not None:
            rho = float(np.exp(-step / noise.time_s))
            power, white = noise.correlated**2, noise.white**2
        else:
            rho, power, white = _lag_one(column), 1.0, 0.0
        moment = 2 * power * rho / (1 - rho) ** 2
        whole = white + power * (1 + rho) / (1 - rho)
        longest = max(longest, moment / whole if whole else 0.0)
    best = max((1.5 * longest**2 * count) ** (1 / 3), count ** (1 / 3))
    return max(min(int(np.ceil(best)), int(count * _LARGEST_SHARE)), 1)


def _lag_one(values: Float[np.ndarray, " sample"]) -> float:
    """Return the correlation at lag one: 0 if consistent with white noise, and at most 0.99."""
    both = ~np.isnan(values[1:]) & ~np.isnan(values[:-1])
    power = np.nansum(values**2) / max(int(np.sum(~np.isnan(values))), 1)
    if both.sum() < 3 or power == 0:
        return 0.0
    rho = float(np.mean(values[1:][both] * values[:-1][both]) / power)
    return min(rho, 0.99) if rho > 2 / np.sqrt(both.sum()) else 0.0


def replicates(
    fitted: Fitted, first: int, count: int, method: Method, whole: bool, seed: int
) -> list[dict[str, Any]]:
    """Task: repeat a fit with resampled data.

    The random numbers depend only on the seed and the number of the repetition. Returns, for each
    repetition, `converged`, `reason`, `values` and `reach` (half the width of the 95 % interval;
    None without one) in the order of `Optimum.labels`, `derived` by name, and the labels of the
    parameters at their `bounds`.
    """
    optimum = fitted.optimum()
    sources = _sources(optimum) if method == "block" else []
    rows: list[dict[str, Any]] = []
    for number in range(first, first + count):
        random = np.random.default_rng([seed, number])
        recorded = [source.again(random) for source in sources] or noisy(optimum, random)
        if whole:
            others = [
                dataclasses.replace(run, values={**run.values, **values})
                for run, values in zip(fitted.runs, recorded, strict=True)
            ]
            anew = refit(fitted.result, others)
            there = optimum_of(anew, others)
            end = anew.status == "converged", anew.reason
            rows.append(_found(fitted.result, there, there.statistics, *end))
            continue
        again = optimum.refit(recorded=recorded, centres=known_again(optimum, random))
        end = again.converged, again.reason
        rows.append(
            _found(fitted.result, optimum, again.statistics, *end)
            if again.state.evaluated
            else {"converged": False, "reason": again.reason}
        )
    return rows


def noisy(optimum: Optimum, random: np.random.Generator) -> Recorded:
    """Simulate each run with the fitted model and noise drawn from the fitted noise model.

    The noise is larger than the noise model states if the standard errors are scaled because the
    residuals exceed the stated noise. Values in SI, by channel; NaN where nothing was measured.
    """
    state, factor = optimum.state, np.sqrt(optimum.statistics.scale)
    several = state.noise.weights or [None] * len(state.setup.runs)
    pairs = zip(state.setup.runs, optimum.predictions, state.noise.values, several, strict=True)
    recorded = []
    for run, predicted, noises, of_run in pairs:
        names = list(run.observations)
        ones = np.ones(len(predicted[names[0]]))
        weights = np.stack([of_run[n] if of_run is not None else ones for n in names], axis=-1)
        noise = factor * drawn([noises[name] for name in names], run.times, weights, random)
        recorded.append(
            {
                name: np.where(np.isnan(values), np.nan, predicted[name] + column)
                for (name, values), column in zip(run.observations.items(), noise.T, strict=True)
            }
        )
    return recorded


def known_again(
    optimum: Optimum, random: np.random.Generator
) -> Float[np.ndarray, " prior"] | None:
    """Draw new centres of the priors, because each prior represents a measurement.

    With the same centres in each repetition, all repetitions would be pulled towards the same
    values as the first fit.
    """
    priors = optimum.state.problem.priors
    if not len(priors.columns):
        return None
    values = optimum.values[list(priors.columns)]
    middle = np.where(priors.logarithmic, np.log(np.where(priors.logarithmic, values, 1)), values)
    return np.asarray(random.normal(middle, np.asarray(priors.spread)))


def _sources(optimum: Optimum) -> list[Residuals]:
    state = optimum.state
    cells = sum(
        int(np.sum(~np.isnan(row))) for run in state.setup.runs for row in run.observations.values()
    )
    freedom = max(cells - len(optimum.statistics.alive), 1)
    inflation = float(np.sqrt(max(cells, 1) / freedom))
    several = zip(state.setup.runs, optimum.predictions, state.noise.values, strict=True)
    return [Residuals.of(run, at, noise, inflation) for run, at, noise in several]


def _found(
    result: FitResult, optimum: Optimum, statistics: Statistics, converged: bool, reason: str
) -> dict[str, Any]:
    """Return how and where a repetition ended, and the quantities that a result would report."""
    values = statistics.values
    reach = [
        None
        if (error := statistics.standard_errors.get(place)) is None
        else student_reach(statistics.degrees_of_freedom[place]) * error
        for place in range(len(values))
    ]
    model = optimum.model(values)
    follows = capabilities.derived(model) if result.derived else {}
    derived = {
        name: float(np.mean(follows[name].value if name in follows else get(model, name)))
        for name in result.derived
    }
    return {
        "converged": converged,
        "reason": reason,
        "values": values.tolist(),
        "reach": reach,
        "derived": derived,
        "bounds": [statistics.labels[place] for place in statistics.bounds],
    }


# Repetitions per task. They share a compiled program. The chunks, and therefore the numbers, do not
# depend on the executor.
CHUNK = 16

_LARGEST = 1_000_000


@keywords_listed()
def bootstrap(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    size: int = 200,
    method: Method = "parametric",
    whole: bool = False,
    seed: int = 0,
    **how: Unpack[Execution],
) -> Bootstrap:
    """Repeat a fit with data that might have been recorded instead (Efron 1979).

    The standard errors of a result assume a linear model and the estimated noise. The repetitions
    do not make this assumption. They show the bias due to nonlinearity, the actual spread of the
    estimates, how often the 95 % interval contains the true value, and how many of the fits
    converge.

    - **parametric**: predictions of the fitted model plus noise drawn from the fitted noise model,
      white and correlated, at the times and in the cells that were measured. The truth is known
      here, but the model and the noise are assumed correct.
    - **block**: predictions plus resampled blocks of the residuals. The blocks preserve the
      correlation and the distribution of the actual residuals. The coverage of the intervals is not
      evaluated.

    The centres of priors are also drawn again, because each prior is treated as a further
    measurement.

    Each repetition starts at the optimum of the fit, so other optima are not sought (use
    `giajax.multi_start`). The noise and the weights of outliers are fixed at their fitted values
    unless `whole` is set, which takes about ten times as long.

    Arguments:
        result, runs: result of `giajax.fit` or `giajax.load_result`, and the fitted runs in the
            same order.
        size: number of repetitions, at least 2; after Ctrl-C the completed repetitions are used.
        method: "parametric" or "block".
        whole: repeat the complete fit each time, including the estimate of the noise.
        seed: seed of all repetitions; the random numbers of repetition n depend only on the seed
            and n.
        how: execution of the tasks, each of 16 repetitions, as for
            `giajax.runtime.execution.Execution`.

    Raises:
        InputError: the runs do not match the result; the result has not converged; the size or
            the method is invalid; `whole` is set for a fit with priors; or fewer than two
            repetitions could be completed.

    Example:
        >>> found = giajax.bootstrap(result, runs, size=400)  # doctest: +SKIP
        >>> found.parameters["air.drag_coefficient"].ratio  # doctest: +SKIP
        1.02
    """
    fitted = Fitted.of(result, runs, converged=True)
    if not 2 <= size <= _LARGEST:
        raise InputError(f"the number of repetitions is {size}: give at least 2")
    if method not in get_args(Method):
        raise InputError(f"unknown bootstrap method '{method}': use one of: parametric, block")
    if seed < 0:
        raise InputError(f"the seed is {seed}: give 0 or a positive number")
    if whole and result.config.get("priors"):
        raise InputError(
            "a fit with priors cannot be repeated as a whole, because the prior values are not "
            "resampled: omit whole=True (--whole), or fit without priors (--no-nuisances)"
        )
    optimum = fitted.optimum()
    common = {"method": method, "whole": whole, "seed": seed}
    firsts = range(0, size, CHUNK)
    chunks = [{**common, "first": at, "count": min(CHUNK, size - at)} for at in firsts]
    outcomes = fitted.study(replicates, chunks, **how)
    rows = [row for outcome in outcomes if outcome.status == "done" for row in outcome.value]
    failures = tuple(dict.fromkeys(each.message for each in outcomes if each.message))
    if len(rows) < 2:
        why = failures[0] if failures else "the bootstrap was stopped"
        raise InputError(f"fewer than two repetitions of the fit were completed: {why}")
    back = [row for row in rows if row["converged"]]
    scale = optimum.statistics.scale if method == "parametric" else 1.0
    names = [run.name for run in fitted.runs]
    sources = _sources(optimum) if method == "block" else []
    return Bootstrap(
        method=method,
        seed=seed,
        size=len(rows),
        asked=size,
        whole=whole,
        came_back=len(back),
        reasons=dict(Counter(row["reason"] for row in rows if not row["converged"])),
        failures=failures,
        at_bounds=dict(Counter(label for row in back for label in row["bounds"])),
        parameters=_parameters(result, optimum, back, judged=method == "parametric"),
        block_lengths={n: each.length for n, each in zip(names, sources, strict=False)},
        noise_factor=float(scale) ** 0.5,
        notes=_notes(result, method, whole=whole),
        fitted=end_values(result),
    )


def _parameters(
    result: FitResult, optimum: Optimum, back: Sequence[dict[str, Any]], *, judged: bool
) -> dict[str, Repeated]:
    """Return the statistics of the converged repetitions, by name."""
    known = optimum.statistics
    found = {}
    for place in known.determined:
        label = known.labels[place]
        estimate = result.parameters.get(label.partition(" of ")[0])
        found[label] = repeated(
            float(known.values[place]),
            known.standard_errors[place],
            "" if estimate is None else estimate.unit,
            [row["values"][place] for row in back],
            [row["reach"][place] for row in back] if judged else None,
        )
    for name, one in result.derived.items():
        values = [row["derived"][name] for row in back]
        found[name] = repeated(float(one.value), one.standard_error, one.unit, values, None)
    return found


def _notes(result: FitResult, method: Method, *, whole: bool) -> tuple[str, ...]:
    """Return sentences on the limitations of the repetitions."""
    notes = ["each repetition starts at the optimum of the fit, so other optima are not sought"]
    if not whole:
        notes.append(
            "the noise is fixed at its fitted value, so the uncertainty of the noise estimate is "
            "not included: whole=True (--whole) includes it"
        )
    if method == "parametric":
        notes.append(
            "the data are simulated with the fitted model and noise, which are assumed correct"
        )
        if not result.loss.is_linear:
            notes.append(
                "the simulated noise is normally distributed, with a larger variance in cells "
                "with a low weight, and the other cells contain no outliers"
            )
    else:
        notes.append(
            "the mean residual of each channel is subtracted, and residuals are not exchanged "
            "between runs"
        )
    return tuple(notes)
