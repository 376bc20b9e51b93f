"""Records of a posterior; `posterior.json` contains its summary."""

import dataclasses
import importlib
import math
import warnings
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.special import ndtri

from ..fitting import FitResult, Optimum, student_reach
from ..recordings import Run
from ..runtime.arrays import Float
from ..runtime.records import finite_or_none
from ..runtime.text import InputError, install_command
from ._refit import StudyRecord

# Convergence of the chains: R-hat and effective sample sizes.
#
# Rank-normalised and split, after Vehtari, Gelman, Simpson, Carpenter and Buerkner,
# "Rank-normalization, folding, and localization", Bayesian Analysis 16 (2021), doi
# 10.1214/20-BA1221.

Draws = Float[np.ndarray, "chain draw"]

# Minimum number of draws in half a chain for these statistics.
_LEAST = 4
_TAILS = (0.05, 0.95)


class Mixing(NamedTuple):
    """Convergence statistics of chains; NaN if all draws are equal or there are too few.

    Attributes:
        r_hat: R-hat: 1 if the chains and their halves agree, larger otherwise.
        ess_bulk: effective sample size for the mean.
        ess_tail: effective sample size for the ends of an interval: the smaller of the two.
    """

    r_hat: float
    ess_bulk: float
    ess_tail: float


def mixing(draws: Draws) -> Mixing:
    """Return the convergence statistics of the chains of one parameter."""
    half = draws.shape[1] // 2
    halves = np.concatenate([draws[:, :half], draws[:, draws.shape[1] - half :]])
    if halves.shape[1] < _LEAST or np.all(halves == halves[0, 0]):
        return Mixing(np.nan, np.nan, np.nan)
    folded = np.abs(halves - np.median(halves))
    ends = np.quantile(draws, _TAILS)
    tails = [effective_size((halves <= end).astype(float)) for end in ends]
    return Mixing(
        r_hat=max(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(folded))),
        ess_bulk=effective_size(_normal_scores(halves)),
        ess_tail=min(tails),
    )


def _normal_scores(draws: Draws) -> Draws:
    # Imported here because it is slow to import and only posteriors need it.
    from scipy.stats import rankdata

    ranks = rankdata(draws, method="average").reshape(draws.shape)
    return np.asarray(ndtri((ranks - 3 / 8) / (draws.size + 1 / 4)))


def _r_hat(draws: Draws) -> float:
    count = draws.shape[1]
    within = np.mean(np.var(draws, axis=1, ddof=1))
    if within == 0:
        return float("nan")
    between = count * np.var(np.mean(draws, axis=1), ddof=1)
    return float(np.sqrt((between / within + count - 1) / count))


def effective_size(draws: Draws) -> float:
    """Return the effective sample size for the mean of correlated draws (equations 10 to 13).

    Autocorrelations are summed in pairs until a pair is negative. No pair counts more than the pair
    before it (Geyer's initial monotone sequence).
    """
    chains, count = draws.shape
    centred = draws - np.mean(draws, axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, 2 * count, axis=1)) ** 2
    # Autocovariance of each chain at each lag.
    covariance = np.fft.irfft(power, axis=1)[:, :count] / count
    within = np.mean(covariance[:, 0]) * count / (count - 1)
    pooled = within * (count - 1) / count
    if chains > 1:
        pooled += np.var(np.mean(draws, axis=1), ddof=1)
    if pooled == 0:
        return float("nan")
    correlation = 1 - (within - np.mean(covariance, axis=0) * count / (count - 1)) / pooled
    correlation[0] = 1.0
    even = count - count % 2
    pairs = correlation[:even:2] + correlation[1:even:2]
    positive = int(np.argmax(pairs < 0)) if np.any(pairs < 0) else len(pairs)
    kept = np.minimum.accumulate(pairs[:positive])
    time = -1 + 2 * np.sum(kept)
    if positive < len(pairs):
        # The even term of the first omitted pair is added if it is positive.
        time += max(correlation[2 * positive], 0.0)
    size = chains * count
    # Anticorrelated draws may have a larger effective size than independent draws, at most by a
    # factor of the logarithm of their number.
    return float(size / max(time, 1 / np.log10(size)))


def as_arviz(
    posterior: Mapping[str, np.ndarray],
    statistics: Mapping[str, np.ndarray],
    package: ModuleType | None = None,
) -> Any:
    """Return draws as ArviZ 0 `InferenceData`, or as `DataTree` of ArviZ 1 or `arviz_base`."""
    if package is None:
        try:
            with warnings.catch_warnings():
                # ArviZ announces its next generation once a day.
                warnings.simplefilter("ignore")
                package = importlib.import_module("arviz")
        except ImportError:
            raise InputError(
                "reading the draws requires ArviZ, which is not installed: "
                f"{install_command('posterior')}"
            ) from None
    groups = {"posterior": dict(posterior), "sample_stats": dict(statistics)}
    if package.__name__ == "arviz" and package.__version__.startswith("0."):
        return package.from_dict(**groups)
    return package.from_dict(groups)


@dataclasses.dataclass(frozen=True)
class Marginal:
    """Marginal posterior of one parameter, SI.

    Attributes:
        unit: SI unit.
        fitted: estimate of the fit.
        mean: mean of the draws.
        deviation: standard deviation of the draws.
        interval: interval from the 2.5th to the 97.5th percentile of the draws.
        linear: linearised interval of the fit, from its Jacobian; None if it has none.
        r_hat: R-hat, 1 if the chains agree; None if all draws are equal.
        ess_bulk, ess_tail: effective sample sizes for the mean and for the ends of the interval;
            None if all draws are equal.
    """

    unit: str
    fitted: float
    mean: float
    deviation: float
    interval: tuple[float, float]
    linear: tuple[float, float] | None
    r_hat: float | None
    ess_bulk: float | None
    ess_tail: float | None

    def times(self, factor: float, unit: str) -> Self:
        """Return the marginal in another unit."""

        def scaled(ends: tuple[float, float]) -> tuple[float, float]:
            low, high = sorted(end * factor for end in ends)
            return low, high

        return dataclasses.replace(
            self,
            unit=unit,
            fitted=self.fitted * factor,
            mean=self.mean * factor,
            deviation=self.deviation * abs(factor),
            interval=scaled(self.interval),
            linear=None if self.linear is None else scaled(self.linear),
        )


def marginal(result: FitResult, optimum: Optimum, index: int, draws: np.ndarray) -> Marginal:
    """Return the marginal of the parameter at an index from its draws, shape (chain, draw)."""
    low, high = np.percentile(draws, (2.5, 97.5))
    path = optimum.labels[index].partition(" of ")[0]
    r_hat, ess_bulk, ess_tail = map(finite_or_none, mixing(draws))
    return Marginal(
        unit=result.parameters[path].unit if path in result.parameters else "",
        fitted=float(optimum.values[index]),
        mean=float(np.mean(draws)),
        deviation=float(np.std(draws, ddof=1)),
        interval=(float(low), float(high)),
        linear=_linear(optimum, index),
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
    )


def _linear(optimum: Optimum, index: int) -> tuple[float, float] | None:
    """Return the interval reported by the fit, from Student's t and within the bounds."""
    statistics = optimum.statistics
    error = finite_or_none(statistics.standard_errors.get(index))
    if error is None:
        return None
    reach = student_reach(statistics.degrees_of_freedom.get(index, np.inf)) * error
    value, lower, upper = optimum.values[index], *(each[index] for each in optimum.bounds)
    return float(max(value - reach, lower)), float(min(value + reach, upper))


# Limits on the draws for a reliable summary (Vehtari et al. 2021).
MOST_R_HAT, LEAST_ESS = 1.01, 400


def doubts(
    marginals: Mapping[str, Marginal],
    divergences: int,
    samples: np.ndarray,
    failed: Sequence[str],
    asked: int,
) -> list[str]:
    """Return a sentence for each problem of the draws, shape (chain, draw, parameter).

    `failed` contains the reasons why chains failed. `asked` is the number of requested chains.
    """
    sentences = []
    chains = samples.shape[0]
    if chains < asked:
        why = f" ({failed[0]})" if failed else ""
        sentences.append(
            f"{asked - chains} of {asked} chains were not sampled{why}: run 'giajax posterior' "
            "again"
        )
    known = {label: one for label, one in marginals.items() if one.r_hat is not None}
    if stuck := [label for label in marginals if label not in known]:
        sentences.append(
            f"the chains are stuck, because all draws of {' and '.join(stuck)} within a chain are "
            "equal: use a longer warm-up, and if that does not help, give priors or bounds that "
            "exclude values at which the model fails"
        )
    hats = {label: one.r_hat or 0.0 for label, one in known.items()}
    worst = max(hats, key=lambda label: hats[label], default="")
    if worst and hats[worst] > MOST_R_HAT:
        above = math.ceil(hats[worst] * 1e3) / 1e3
        sentences.append(
            f"the chains have not converged, because R-hat of {worst} is {above:.3f}, which "
            f"is above {MOST_R_HAT:g}: use more draws and a longer warm-up"
        )
    sizes = {name: min(one.ess_bulk or 0.0, one.ess_tail or 0.0) for name, one in known.items()}
    least = min(sizes, key=lambda label: sizes[label], default="")
    if least and sizes[least] < LEAST_ESS:
        sentences.append(
            f"the draws of {least} are equivalent to {sizes[least]:.0f} independent draws, but an "
            f"interval requires {LEAST_ESS}: use more draws"
        )
    if divergences:
        sentences.append(
            f"{divergences} of {chains * samples.shape[1]} draws diverged, so part of "
            "the posterior may not have been sampled: free fewer parameters, or give priors or "
            "bounds that exclude values at which the model fails"
        )
    return sentences


# Half the width of the 95 % interval of a normal variable, in standard deviations.
NORMAL = 1.959964


@dataclasses.dataclass(frozen=True)
class Band:
    """Predicted band of a channel of a run, SI; each array has the shape (sample,).

    Attributes:
        median: median of the predictions of the draws.
        low, high: 2.5th and 97.5th percentile of the predictions, which represent the uncertainty
            of the parameters.
        noise: standard deviation of a recorded cell, as estimated by the fit; larger than stated if
            the residuals exceed the stated noise.
        within: fraction of the recorded cells within the 95 % band of noise and parameter
            uncertainty together; None if nothing was recorded.
    """

    median: Float[np.ndarray, " sample"]
    low: Float[np.ndarray, " sample"]
    high: Float[np.ndarray, " sample"]
    noise: float
    within: float | None

    def with_noise(self) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, " sample"]]:
        """Return the 95 % band of recorded cells: both contributions are treated as normal."""
        reach = NORMAL * self.noise
        low = self.median - np.hypot(self.median - self.low, reach)
        return low, self.median + np.hypot(self.high - self.median, reach)


@dataclasses.dataclass(frozen=True)
class PosteriorSummary(
    StudyRecord,
    file="posterior.json",
    head={"giajax_posterior": 1},
    remedy="run 'giajax posterior' again",
    indent=2,
):
    """Contents of `posterior.json`.

    Attributes:
        parameters: marginals by label; labels of parameters of single runs include the run.
        chains, draws, warmup: number of chains, and of draws and warm-up transitions of each chain.
        asked: number of requested chains.
        seed: seed of the random numbers.
        divergences: number of draws at which the energy was not conserved or the model failed.
        scale: factor by which the cost of the measured values was divided.
        cost: cost of the fit.
        held: labels of free parameters that are not sampled, because no channel responds to them.
        within: fraction of the recorded cells within their 95 % band, by run (with unique names)
            and channel.
        warnings: sentences on problems of the draws; empty if there are none.
    """

    parameters: dict[str, Marginal]
    chains: int
    draws: int
    warmup: int
    asked: int
    seed: int
    divergences: int
    scale: float
    cost: float | None
    held: tuple[str, ...]
    within: dict[str, dict[str, float | None]]
    warnings: tuple[str, ...]


@dataclasses.dataclass(frozen=True, repr=False)
class Posterior:
    """Draws from the posterior of the free parameters of a fit; created by `giajax.posterior`.

    Attributes:
        summary: marginals of the parameters and convergence statistics.
        samples: draws, SI, shape (chain, draw, parameter), in the order of `summary.parameters`.
        energy: minus the logarithm of the density, up to a constant, shape (chain, draw).
        diverging, steps, acceptance: divergence flag, number of steps and acceptance rate of each
            draw, shape (chain, draw).
        bands: predicted bands of each run, by channel.
    """

    summary: PosteriorSummary
    samples: Float[np.ndarray, "chain draw parameter"]
    energy: Float[np.ndarray, "chain draw"]
    diverging: np.ndarray
    steps: np.ndarray
    acceptance: Float[np.ndarray, "chain draw"]
    bands: tuple[dict[str, Band], ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the parameters."""
        return tuple(self.summary.parameters)

    def draws_of(self, label: str) -> Float[np.ndarray, "chain draw"]:
        """Return the draws of one parameter, SI."""
        if label not in self.labels:
            raise InputError(f"'{label}' was not free in this fit: use one of {self.labels}")
        return self.samples[..., self.labels.index(label)]

    def to_arviz(self) -> Any:
        """Return the draws as ArviZ 0 `InferenceData` or ArviZ 1 `DataTree`."""
        posterior = {label: self.draws_of(label) for label in self.labels}
        statistics = {
            "lp": -self.energy,
            "diverging": self.diverging,
            "n_steps": self.steps,
            "acceptance_rate": self.acceptance,
        }
        return as_arviz(posterior, statistics)

    def __repr__(self) -> str:
        known = self.summary
        return f"<Posterior: {len(self.labels)} parameters, {known.chains} x {known.draws} draws>"


# With 200 draws, the ends of a 95 % interval are known to a tenth of its width.
DRAWS = 200
_ENDS = (2.5, 50.0, 97.5)


def bands(
    result: FitResult, runs: Sequence[Run], optimum: Optimum, draws: np.ndarray
) -> tuple[dict[str, Band], ...]:
    """Return the predicted band of each channel of each run, with the programs of the fit.

    The noise of the result is scaled like its standard errors. `DRAWS` of the draws, shape (draw,
    parameter), are predicted. Draws at which the model fails are omitted.
    """
    chosen = np.unique(np.linspace(0, len(draws) - 1, DRAWS).round().astype(int))
    points = (optimum.at(draws[index]) for index in chosen)
    widened = math.sqrt(optimum.statistics.scale)
    predicted = [point.predictions for point in points if np.isfinite(point.cost)]
    return tuple(
        {
            name: _band(
                np.stack([each[at][name] for each in predicted]),
                run.observations[name],
                widened * float(run.channels[name].to_si(record.channels[name].noise)),
            )
            for name in run.observations
        }
        for at, (run, record) in enumerate(zip(runs, result.runs, strict=True))
    )


def _band(predicted: np.ndarray, recorded: np.ndarray, noise: float) -> Band:
    low, median, high = np.percentile(predicted, _ENDS, axis=0)
    band = Band(median, low, high, noise, None)
    known = ~np.isnan(recorded)
    if not known.any():
        return band
    least, most = (ends[known] for ends in band.with_noise())
    inside = (least <= recorded[known]) & (recorded[known] <= most)
    return dataclasses.replace(band, within=float(np.mean(inside)))
