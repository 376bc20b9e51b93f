"""Intervals under correlated noise: how often they hold the truth, by the way of estimating it.

A linear model with four smooth columns, such as the motion of a slow arm has, and noise whose
memory is known: an AR(1) of correlation rho from one sample to the next of 0.1 s, or white. Each
replicate is estimated as a fit does at its optimum, by `giajax.noise`; "white" beside it is least
squares with 1.96 standard errors of white noise, whose size comes from the residuals.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ._study import Figures, Study

STEP_S = 0.1
LEVEL = 0.95
# Of a disagreement by chance, for each cell.
PROBABILITY = 1e-4


class Case(NamedTuple):
    """A cell of the factorial."""

    rho: float
    samples: int
    gaps: bool
    channels: int
    stated: bool

    @property
    def name(self) -> str:
        sampling = "gaps" if self.gaps else "even"
        channels = f"{self.channels} channel" + ("s" if self.channels > 1 else "")
        stated = "stated" if self.stated else "not stated"
        return f"rho {self.rho:g}, {self.samples} samples, {sampling}, {channels}, {stated}"

    @property
    def lengths(self) -> float:
        """Correlation times that a record has; infinite where noise is white."""
        return np.inf if self.rho == 0 else -self.samples * np.log(self.rho)


def cases() -> Iterator[Case]:
    """All combinations, and long records for the longest memory."""
    for rho, samples in ((0.0, 250), (0.5, 250), (0.9, 250), (0.99, 250), (0.99, 2500)):
        for gaps in (False, True):
            for channels in (1, 3):
                for stated in (True, False):
                    yield Case(rho, samples, gaps, channels, stated)


def run(size: int, seed: int) -> Figures:
    """Figures of `size` replicates of each case."""
    figures: Figures = {}
    for index, case in enumerate(cases()):
        rng = np.random.default_rng([seed, index])
        within = white = short = 0
        for _ in range(size):
            one, two, flagged = _replicate(case, rng)
            within, white, short = within + one, white + two, short + flagged
        figures[case.name] = {
            "correlation_times": None if case.rho == 0 else round(float(case.lengths), 1),
            "records": size,
            "intervals": 4 * size,
            "within": within,
            "within_if_white": white,
            "seen_as_short": short,
        }
    return figures


def _replicate(case: Case, rng: np.random.Generator) -> tuple[int, int, int]:
    """How many of four intervals hold the truth, by both ways; whether the record seems short."""
    from giajax.noise import Cells, ChannelNoise, Restricted, Stated, estimate, small_sample

    times = np.arange(case.samples) * STEP_S
    if case.gaps:
        times = times[(rng.random(case.samples) > 0.2) & ((times % 6) < 5)]
    u = times / (case.samples * STEP_S)
    smooth = np.stack([np.exp(-3 * u), np.sin(3 * u), u, np.cos(7 * u)], axis=1)
    columns = [smooth @ _mixing(channel) for channel in range(case.channels)]
    values = [_noise(times, case.rho, rng) for _ in columns]
    all_columns, all_values = np.concatenate(columns), np.concatenate(values)
    start = np.linalg.lstsq(all_columns, all_values, rcond=None)[0]
    cells = [
        Cells(
            key=f"channel{i}",
            run=0,
            times=times,
            weights=np.ones(len(times)),
            residual=value - column @ start,
            shared=column,
            own=np.zeros((len(times), 0)),
        )
        for i, (column, value) in enumerate(zip(columns, values, strict=True))
    ]
    stated = {each.key: Stated(1.0) if case.stated else Stated() for each in cells}
    first = {each.key: ChannelNoise(1.0 if case.stated else _rms(each.residual)) for each in cells}
    problem = estimate(Restricted.of(cells, first), stated, memory=True)
    gram = np.sum([each.gram(problem.noise[each.key])[0] for each in cells], axis=0)
    covariance = np.linalg.inv(gram[:-1, :-1])
    off = np.abs(start + covariance @ gram[:-1, -1])
    spread = small_sample(problem, cells, covariance, stated)
    reach = _quantile(spread.freedom) * np.sqrt(np.diag(spread.covariance))
    freedom = len(all_values) - 4
    variance = np.sum((all_values - all_columns @ start) ** 2) / freedom
    plain = 1.96 * np.sqrt(variance * np.diag(np.linalg.inv(all_columns.T @ all_columns)))
    longest = max(noise.time_s for noise in problem.noise.values())
    short = longest > 0 and np.ptp(times) < 20 * longest
    return int(np.sum(off < reach)), int(np.sum(np.abs(start) < plain)), int(short)


def _mixing(channel: int) -> np.ndarray:
    """Channels respond to the four parameters differently."""
    return np.eye(4) + 0.5 * np.roll(np.eye(4), channel, axis=1) * (channel > 0)


def _noise(times: np.ndarray, rho: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance."""
    values = rng.normal(size=len(times))
    if rho:
        decay = rho ** (np.diff(times) / STEP_S)
        for i in range(1, len(values)):
            values[i] = decay[i - 1] * values[i - 1] + np.sqrt(1 - decay[i - 1] ** 2) * values[i]
    return values


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _quantile(freedom: np.ndarray) -> np.ndarray:
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, 1e9), 1 - (1 - LEVEL) / 2))


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Cells whose share of intervals cannot be one, by Fisher's exact test on records.

    The four intervals of a record go together, so that a record counts once.
    """
    from scipy.stats import fisher_exact

    if list(stored) != list(new):
        return ["the cases are others than those that are stored: run the study again"]
    sentences = []
    for case, before in stored.items():
        after = new[case]
        table = [
            [round(each["within"] / 4), each["records"] - round(each["within"] / 4)]
            for each in (before, after)
        ]
        if fisher_exact(table).pvalue < PROBABILITY:
            sentences.append(
                f"{case}: {_share(after, 'within')} of the intervals hold the truth, "
                f"and {_share(before, 'within')} did"
            )
    return sentences


def _share(figures: dict[str, Any], key: str) -> str:
    return f"{100 * figures[key] / figures['intervals']:.1f} %"


def table(figures: Figures) -> list[str]:
    """A row for each case."""
    rows = [
        "| noise and record | correlation times | intervals with the truth | white noise assumed "
        "| seen as shorter than 20 |",
        "| --- | --- | --- | --- | --- |",
    ]
    for case, each in figures.items():
        lengths = each["correlation_times"]
        rows.append(
            f"| {case} | {'-' if lengths is None else lengths} | {_share(each, 'within')} | "
            f"{_share(each, 'within_if_white')} | "
            f"{100 * each['seen_as_short'] / each['records']:.0f} % |"
        )
    return rows


NOISE = Study(
    name="noise",
    meaning=(
        "Records of a linear model with four smooth columns and noise of known memory: how often "
        "95 % intervals hold the truth. Shorter than 20 correlation times is what no estimate of "
        "the noise can be trusted for; a fit says so."
    ),
    size=100,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)
