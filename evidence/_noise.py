"""Intervals under correlated noise: coverage by method of estimation.

A linear model has four smooth columns, similar to the motion of a slow arm. Its noise is AR(1) with
a known correlation rho from one sample to the next (0.1 s), or white. Each replicate is estimated
by `giajax.noise`, as in a fit at its optimum. Alternatives for comparison are least squares with
1.96 standard errors of white noise estimated from the residuals, and for one evenly sampled channel
the two methods of statsmodels: `GLSAR` (iterated, AR(1) without white noise) and least squares with
`HAC` errors (Newey and West).
"""

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np

from ._draw import correlated_noise, correlation_time
from ._study import Figures, Study, shares_differ

STEP_S = 0.1
LEVEL = 0.95


class Case(NamedTuple):
    """A combination of the factors of the study."""

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
        """Duration of a record in correlation times; infinite if the noise is white."""
        return np.inf if self.rho == 0 else -self.samples * np.log(self.rho)


def cases() -> Iterator[Case]:
    """Yield all combinations, and long records for the longest correlation time."""
    for rho, samples in ((0.0, 250), (0.5, 250), (0.9, 250), (0.99, 250), (0.99, 2500)):
        for gaps in (False, True):
            for channels in (1, 2):
                for stated in (True, False):
                    yield Case(rho, samples, gaps, channels, stated)


def run(size: int, seed: int) -> Figures:
    """Return the figures of `size` replicates of each case, computed on all cores."""
    tasks = [(case, size, seed, index) for index, case in enumerate(cases())]
    # Start with the longest records, so all cores end at about the same time.
    order = sorted(tasks, key=lambda task: -task[0].samples)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        counts = {task: pool.submit(_counts, *task) for task in order}
        return _figures(size, {task[0]: counts[task].result() for task in tasks})


def part(size: int, seed: int) -> Figures:
    """Return the figures of every fifth case, with all correlation times, in one process."""
    some = list(enumerate(cases()))[2::5]
    return _figures(size, {case: _counts(case, size, seed, index) for index, case in some})


def _figures(size: int, counts: dict[Case, Counter[str]]) -> Figures:
    return {
        case.name: {
            "correlation_times": None if case.rho == 0 else round(float(case.lengths), 1),
            "records": size,
            "intervals": 4 * size,
            **{key: each[key] for key in _ways(case)},
            "seen_as_short": each["seen_as_short"],
        }
        for case, each in counts.items()
    }


def _counts(case: Case, size: int, seed: int, index: int) -> Counter[str]:
    counts: Counter[str] = Counter()
    for number in range(size):
        counts.update(_replicate(case, np.random.default_rng([seed, index, number])))
    return counts


def _ways(case: Case) -> tuple[str, ...]:
    """Return the methods of estimation that apply to a case."""
    ours = ("within", "within_if_white")
    return ours if case.gaps or case.channels > 1 else (*ours, "within_glsar", "within_hac")


def _replicate(case: Case, rng: np.random.Generator) -> dict[str, int]:
    """Count the intervals that contain the truth, by method, and a detected short record."""
    times = np.arange(case.samples) * STEP_S
    if case.gaps:
        times = times[(rng.random(case.samples) > 0.2) & ((times % 6) < 5)]
    u = times / (case.samples * STEP_S)
    smooth = np.stack([np.exp(-3 * u), np.sin(3 * u), u, np.cos(7 * u)], axis=1)
    columns = [smooth @ _mixing(channel) for channel in range(case.channels)]
    time_s = correlation_time(case.rho, STEP_S)
    values = [correlated_noise(times, time_s, rng) for _ in columns]
    counts = _ours(case, times, columns, values)
    counts["within_if_white"] = _if_white(np.concatenate(columns), np.concatenate(values))
    if "within_hac" in _ways(case):
        counts |= _peers(columns[0], values[0])
    return counts


def _ours(
    case: Case, times: np.ndarray, columns: list[np.ndarray], values: list[np.ndarray]
) -> dict[str, int]:
    from giajax.noise import Cells, ChannelNoise, Restricted, Stated, estimate, small_sample

    start = np.linalg.lstsq(np.concatenate(columns), np.concatenate(values), rcond=None)[0]
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
    problem = estimate(Restricted.of(cells, first), stated, correlated=True)
    gram = np.sum([each.gram(problem.noise[each.key])[0] for each in cells], axis=0)
    covariance = np.linalg.inv(gram[:-1, :-1])
    off = np.abs(start + covariance @ gram[:-1, -1])
    spread = small_sample(problem, cells, covariance, stated)
    reach = _quantile(spread.degrees_of_freedom) * np.sqrt(np.diag(spread.covariance))
    longest = max(noise.time_s for noise in problem.noise.values())
    short = longest > 0 and np.ptp(times) < 20 * longest
    return {"within": int(np.sum(off < reach)), "seen_as_short": int(short)}


def _if_white(columns: np.ndarray, values: np.ndarray) -> int:
    off, (squares,) = np.linalg.lstsq(columns, values, rcond=None)[:2]
    covariance = squares / (len(values) - 4) * np.linalg.inv(columns.T @ columns)
    return int(np.sum(np.abs(off) < 1.96 * np.sqrt(np.diag(covariance))))


def _peers(columns: np.ndarray, values: np.ndarray) -> dict[str, int]:
    """Return the counts for statsmodels; its intervals use Student's t."""
    from statsmodels.regression.linear_model import GLSAR, OLS

    # Rule of thumb of Newey and West (1994).
    lags = int(np.ceil(4 * (len(values) / 100) ** (2 / 9)))
    glsar = GLSAR(values, columns, rho=1).iterative_fit(maxiter=8)
    hac = OLS(values, columns).fit(cov_type="HAC", cov_kwds={"maxlags": lags}, use_t=True)
    return {
        name: int(np.sum(np.prod(np.sign(each.conf_int(1 - LEVEL)), axis=1) < 0))
        for name, each in (("within_glsar", glsar), ("within_hac", hac))
    }


def _mixing(channel: int) -> np.ndarray:
    """Return a matrix that makes channels respond differently to the four parameters."""
    return np.eye(4) + 0.5 * np.roll(np.eye(4), channel, axis=1) * (channel > 0)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _quantile(freedom: np.ndarray) -> np.ndarray:
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, 1e9), 1 - (1 - LEVEL) / 2))


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report cases whose coverage differs, by Fisher's exact test on records.

    The four intervals of a record are correlated, so a record counts once.
    """
    if not stored.keys() >= new.keys():
        return ["the cases differ from the stored cases: run the study again"]
    sentences = []
    for case, after in new.items():
        before = stored[case]
        shares = [(round(each["within"] / 4), each["records"]) for each in (before, after)]
        if shares_differ(*shares[0], *shares[1]):
            sentences.append(
                f"{case}: {_share(after, 'within')} of the intervals contain the truth; "
                f"stored: {_share(before, 'within')}"
            )
    return sentences


def _share(figures: dict[str, Any], key: str) -> str:
    return f"{100 * figures[key] / figures['intervals']:.1f} %" if key in figures else "-"


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each case."""
    rows = [
        "| noise and record | length in correlation times | coverage, giajax | coverage, white "
        "noise assumed | coverage, GLSAR | coverage, HAC | records with the warning 'shorter than "
        "20 correlation times' |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for case, each in figures.items():
        lengths = each["correlation_times"]
        rows.append(
            f"| {case} | {'-' if lengths is None else lengths} | {_share(each, 'within')} | "
            f"{_share(each, 'within_if_white')} | "
            f"{_share(each, 'within_glsar')} | {_share(each, 'within_hac')} | "
            f"{100 * each['seen_as_short'] / each['records']:.0f} % |"
        )
    return rows


NOISE = Study(
    name="noise",
    meaning=(
        "A linear model with four smooth regressors is fitted to records with noise of known "
        "correlation. The table lists how often the 95 % intervals contain the truth, for giajax "
        "and for three other methods. In a record shorter than 20 correlation times, no estimate "
        "of the noise is reliable, and a fit prints a warning. The last column "
        "lists the rate of this warning."
    ),
    size=2000,
    seed=1,
    run=run,
    part=part,
    disagreements=disagreements,
    table=table,
)
