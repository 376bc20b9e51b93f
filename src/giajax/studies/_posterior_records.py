"""What a posterior is made of, as data; `posterior.json` is its summary."""

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

# Whether chains have mixed: R-hat and effective sample sizes.
#
# Rank-normalised and split, after Vehtari, Gelman, Simpson, Carpenter and Buerkner, "Rank-
# normalization, folding, and localization", Bayesian Analysis 16 (2021), doi 10.1214/20-BA1221.

Draws = Float[np.ndarray, "chain draw"]

_LEAST = 4  # fewer draws of a half of a chain than this say nothing
_TAILS = (0.05, 0.95)


class Mixing(NamedTuple):
    """How well chains have mixed; NaN where all draws are equal or there are too few.

    Attributes:
        r_hat: 1 where chains agree with each other, and their halves too; above where not.
        ess_bulk: how many independent draws the mean is worth.
        ess_tail: how many the ends of an interval are worth: the less of both.
    """

    r_hat: float
    ess_bulk: float
    ess_tail: float


def mixing(draws: Draws) -> Mixing:
    """How well the chains of one parameter have mixed."""
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
    # Slow to import, and asked for by posteriors alone.
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
    """How many independent draws the mean of correlated ones is worth (equations 10 to 13).

    Autocorrelations are added up in pairs as long as these are positive, and none counts more than
    the one before it (Geyer's initial monotone sequence).
    """
    chains, count = draws.shape
    centred = draws - np.mean(draws, axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, 2 * count, axis=1)) ** 2
    # Of each chain at each lag.
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
        # Of the first pair that is left out, its even part, where that is positive.
        time += max(correlation[2 * positive], 0.0)
    size = chains * count
    # Draws that are worth more than independent ones: at most by the logarithm of their number.
    return float(size / max(time, 1 / np.log10(size)))


def as_arviz(
    posterior: Mapping[str, np.ndarray],
    statistics: Mapping[str, np.ndarray],
    package: ModuleType | None = None,
) -> Any:
    """Draws as `InferenceData` of ArviZ 0, or as `DataTree` of ArviZ 1 and of `arviz_base`."""
    if package is None:
        try:
            with warnings.catch_warnings():
                # Once a day it announces its next generation.
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
    """What is known of one parameter, SI.

    Attributes:
        unit: SI unit.
        fitted: where the fit ended.
        mean: of the draws.
        deviation: of the draws.
        interval: from 2.5 to 97.5 % of them.
        linear: the interval of the fit, from its Jacobian alone; None where it has none.
        r_hat: 1 where the chains agree; None where all draws are equal.
        ess_bulk, ess_tail: how many independent draws the mean and the ends are worth; likewise.
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
        """The same in another unit."""

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
    """What draws, shape (chain, draw), say of the parameter of an index."""
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
    """The interval that the fit reports, by Student's t and within the bounds."""
    statistics = optimum.statistics
    error = finite_or_none(statistics.standard_errors.get(index))
    if error is None:
        return None
    reach = student_reach(statistics.degrees_of_freedom.get(index, np.inf)) * error
    value, lower, upper = optimum.values[index], *(each[index] for each in optimum.bounds)
    return float(max(value - reach, lower)), float(min(value + reach, upper))


# What draws must reach to be taken for what they are meant to be (Vehtari et al. 2021).
MOST_R_HAT, LEAST_ESS = 1.01, 400


def doubts(
    marginals: Mapping[str, Marginal],
    divergences: int,
    samples: np.ndarray,
    failed: Sequence[str],
    asked: int,
) -> list[str]:
    """One sentence for each thing that is wrong with draws, shape (chain, draw, parameter).

    `failed` says why chains were not drawn, of as many as were `asked` for.
    """
    sentences = []
    chains = samples.shape[0]
    if chains < asked:
        why = f" ({failed[0]})" if failed else ""
        sentences.append(
            f"{asked - chains} of {asked} chains were not sampled{why}: run giajax posterior again"
        )
    known = {label: one for label, one in marginals.items() if one.r_hat is not None}
    if stuck := [label for label in marginals if label not in known]:
        sentences.append(
            f"the chains are stuck: within a chain, all draws of {' and '.join(stuck)} are equal; "
            "use a longer warm-up, and if that does not help, give priors or bounds that exclude "
            "values where the model fails"
        )
    hats = {label: one.r_hat or 0.0 for label, one in known.items()}
    worst = max(hats, key=lambda label: hats[label], default="")
    if worst and hats[worst] > MOST_R_HAT:
        sentences.append(
            f"the chains have not converged: R-hat of {worst} is {hats[worst]:.3f}, above "
            f"{MOST_R_HAT:g}; use more draws and a longer warm-up"
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
            "bounds that exclude values where the model fails"
        )
    return sentences


NORMAL = 1.959964  # where a normal variable is by 95 %, in deviations


@dataclasses.dataclass(frozen=True)
class Band:
    """Where a channel of a run is predicted to be, SI, each of shape (sample,).

    Attributes:
        median: of the predictions of draws.
        low, high: 2.5 and 97.5 % of them: what the parameters leave open.
        noise: standard deviation of a recorded cell, as the fit left it: more than is stated where
            residuals exceed that.
        within: share of the recorded cells that are where noise and parameters together put 95 %;
            None where nothing was recorded.
    """

    median: Float[np.ndarray, " sample"]
    low: Float[np.ndarray, " sample"]
    high: Float[np.ndarray, " sample"]
    noise: float
    within: float | None

    def with_noise(self) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, " sample"]]:
        """Where 95 % of recorded cells are to be: both as if they were normal."""
        reach = NORMAL * self.noise
        low = self.median - np.hypot(self.median - self.low, reach)
        return low, self.median + np.hypot(self.high - self.median, reach)


@dataclasses.dataclass(frozen=True)
class PosteriorSummary(
    StudyRecord,
    file="posterior.json",
    head={"giajax_posterior": 1},
    remedy="run giajax posterior again",
    indent=2,
):
    """What `posterior.json` says of a posterior.

    Attributes:
        parameters: by label, those of single runs with the run.
        chains, draws, warmup: how many chains there are, and transitions of each.
        asked: how many chains were asked for.
        seed: of the random numbers.
        divergences: draws at which the sampler lost the energy, or met where the model fails.
        scale: what the cost of the measured values was divided by.
        cost: of the fit that it is of.
        held: labels of what was free and is not drawn, because no channel responds to it.
        within: by run, each by another name, and channel, the share of the recorded cells within
            their 95 % band.
        warnings: sentences on what is wrong with the draws; empty where nothing is.
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
    """Draws from what is known of the free parameters of a fit; made by `giajax.posterior`.

    Attributes:
        summary: of each parameter, and of how the chains have mixed.
        samples: SI, shape (chain, draw, parameter), in the order of `summary.parameters`.
        energy: minus the logarithm of their density, up to a constant, shape (chain, draw).
        diverging, steps, acceptance: of each draw; the same shape.
        bands: of each run, by channel.
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
        """Names of the parameters."""
        return tuple(self.summary.parameters)

    def draws_of(self, label: str) -> Float[np.ndarray, "chain draw"]:
        """The draws of one parameter, SI."""
        if label not in self.labels:
            raise InputError(f"'{label}' was not free in this fit: use one of {self.labels}")
        return self.samples[..., self.labels.index(label)]

    def to_arviz(self) -> Any:
        """The draws as ArviZ takes them: `InferenceData` of ArviZ 0, `DataTree` of ArviZ 1."""
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


DRAWS = 200  # of 200 draws the ends of a 95 % interval are known to a tenth of its width
_ENDS = (2.5, 50.0, 97.5)


def bands(
    result: FitResult, runs: Sequence[Run], optimum: Optimum, draws: np.ndarray
) -> tuple[dict[str, Band], ...]:
    """Where each channel of each run is predicted to be, by the programs of the fit.

    The noise of the result is widened as its standard errors are. Of draws, shape (draw,
    parameter), `DRAWS` are predicted; those at which the model fails are left out.
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
