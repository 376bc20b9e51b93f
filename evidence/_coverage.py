"""Coverage: how often the 95 % interval of a fit contains the truth.

Runs of three models differ only in their noise, which is white, or AR(1) with a correlation rho
from sample to sample, and stated in the sidecar or not. Every run is fitted from the same initial
guess, away from the truth. The interval is that of the result, from Student's t. A pull is the
error divided by the standard error.

The same fits show how often an adequate model is judged inadequate. If the noise is white, or its
correlation is stated, every such verdict is a false alarm. If it is correlated and not stated, the
verdict must report it.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ._experiments import EXPERIMENTS, Experiment, Stated
from ._study import PROBABILITY, Figures, Study, shares_differ

LEVEL = 0.95


class Case(NamedTuple):
    """An experiment and its noise.

    Attributes:
        experiment: name of the experiment in `EXPERIMENTS`.
        rho: correlation of the noise from sample to sample; 0 if it is white.
        stated: what the sidecar states about the noise.
    """

    experiment: str
    rho: float
    stated: Stated

    @property
    def name(self) -> str:
        noise = f"rho {self.rho:g}" if self.rho else "white"
        said = {"nothing": "not stated", "size": "its size stated", "all": "stated"}
        return f"{self.experiment}, {noise}, {said[self.stated]}"

    @property
    def adequate(self) -> bool:
        """Whether the noise is white, or the sidecar states it completely."""
        return not self.rho or self.stated == "all"


def cases() -> Iterator[Case]:
    """Yield four kinds of noise for each experiment."""
    for experiment in EXPERIMENTS:
        # A sidecar cannot state a correlated part of the noise of a force.
        forces = experiment == "a muscle"
        yield Case(experiment, 0.0, "nothing" if forces else "all")
        yield Case(experiment, 0.5, "nothing")
        yield Case(experiment, 0.9, "nothing")
        yield Case(experiment, 0.9, "size" if forces else "all")


def run(size: int, seed: int) -> Figures:
    """Return the figures of `size` fits of each case, each with its own random numbers."""
    import jax

    jax.config.update("jax_enable_x64", True)
    experiments = {name: build() for name, build in EXPERIMENTS.items()}
    return {
        case.name: _refit(case, experiments[case.experiment], [seed, index], size)
        for index, case in enumerate(cases())
    }


def _refit(case: Case, experiment: Experiment, entropy: list[int], size: int) -> Figures:
    import giajax

    truth, start = experiment.truth, experiment.start
    definition = experiment.stating(case.stated, case.rho)
    converged = inadequate = 0
    within = dict.fromkeys(truth, 0)
    pulls: dict[str, list[float]] = {path: [] for path in truth}
    for number in range(size):
        rng = np.random.default_rng([*entropy, number])
        run = experiment.recorded(definition, case.rho, rng)
        result = giajax.fit(experiment.model, run, free=list(truth), start=start, check=False)
        converged += result.status == "converged"
        inadequate += result.verdict.status == "inadequate"
        for path, true in truth.items():
            estimate = result.parameters[path]
            # A missing interval counts as not containing the truth, and gives no pull.
            if estimate.interval is not None and estimate.standard_error is not None:
                low, high = estimate.interval
                within[path] += low <= true <= high
                pulls[path].append((estimate.value - true) / estimate.standard_error)
    long = np.ptp(experiment.times) / experiment.time_of(case.rho) if case.rho else None
    return {
        "correlation_times": None if long is None else round(float(long), 1),
        "adequate": case.adequate,
        "fits": size,
        "converged": converged,
        "inadequate": inadequate,
        "parameters": {
            path: {
                "truth": truth[path],
                "intervals": len(each),
                "within": within[path],
                "mean_pull": round(float(np.mean(each)), 4),
                "deviation_of_pulls": round(float(np.std(each, ddof=1)), 4),
            }
            for path, each in pulls.items()
        },
    }


def p_value(figures: Mapping[str, Any]) -> float:
    """Return the p-value of the coverage of a case if the true coverage is 95 %.

    It is that of a binomial test for each parameter, with a Bonferroni correction. The intervals of
    one fit are correlated, so their sum does not have a binomial distribution.
    """
    from scipy.stats import binomtest

    each = figures["parameters"].values()
    least = min(binomtest(one["within"], figures["fits"], LEVEL).pvalue for one in each)
    return float(min(len(each) * least, 1.0))


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report differences with a probability below `PROBABILITY`, by classical tests."""
    if list(stored) != list(new):
        return [f"the cases are {list(new)}, the stored cases {list(stored)}: run the study again"]
    sentences = []
    for case, before in stored.items():
        after = new[case]
        n, m = before["fits"], after["fits"]
        for key, what in (("converged", "converged"), ("inadequate", "were judged inadequate")):
            if shares_differ(before[key], n, after[key], m):
                sentences.append(
                    f"{case}: {after[key]} of {m} fits {what}; stored: {before[key]} of {n}"
                )
        for path, old in before["parameters"].items():
            where, now = f"{case}, {path}", after["parameters"][path]
            if old["truth"] != now["truth"]:
                sentences.append(f"{where}: the truth is {now['truth']}; stored: {old['truth']}")
            if shares_differ(old["within"], n, now["within"], m):
                sentences.append(
                    f"{where}: {now['within']} of {m} intervals contain the truth; "
                    f"stored: {old['within']} of {n}"
                )
            sentences += [f"{where}: {sentence}" for sentence in _unlike_pulls(old, now)]
    return sentences


def _unlike_pulls(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Report samples of pulls that differ in mean (Welch) or in standard deviation (F test)."""
    from scipy import stats

    sentences = []
    (a, s, n), (b, t, m) = (
        (each["mean_pull"], each["deviation_of_pulls"], each["intervals"]) for each in (old, new)
    )
    if stats.ttest_ind_from_stats(a, s, n, b, t, m, equal_var=False).pvalue < PROBABILITY:
        sentences.append(f"the mean pull is {b:.2f}; stored: {a:.2f}")
    ratio = stats.f(m - 1, n - 1)
    if min(ratio.cdf((t / s) ** 2), ratio.sf((t / s) ** 2)) < PROBABILITY / 2:
        sentences.append(f"the standard deviation of the pulls is {t:.2f}; stored: {s:.2f}")
    return sentences


def _shown(case: str) -> str:
    """Return the name of a stored case in the wording of the page."""
    case = case.replace("plays of a joint", "play operators of a joint")
    return case.replace("its size stated", "only its standard deviation stated")


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each case."""
    rows = [
        "| model and noise | length of the run in correlation times | share of intervals that "
        "contain the true value | p | verdict `inadequate` | is `inadequate` correct? |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for case, each in figures.items():
        fits, lengths = each["fits"], each["correlation_times"]
        shares = ", ".join(
            f"`{path}` {100 * one['within'] / fits:.1f} %"
            for path, one in each["parameters"].items()
        )
        rows.append(
            f"| {_shown(case)} | {'-' if lengths is None else lengths} | {shares} | "
            f"{p_value(each):.2g} | {100 * each['inadequate'] / fits:.1f} % | "
            f"{'no' if each['adequate'] else 'yes'} |"
        )
    return rows


COVERAGE = Study(
    name="coverage",
    meaning=(
        "Runs of three models with white or correlated noise are fitted from an initial guess "
        "that differs from the truth. The table lists the share of fits in which the 95 % "
        "interval of a parameter contains the truth, and the rate of the verdict `inadequate`. It "
        "also lists the probability p that, by chance, the shares deviate at least as much from "
        "95 % (binomial test, corrected for the four parameters). With white noise, or with a "
        "stated correlation, the nominal rate of `inadequate` is at most 2 %. With correlated "
        "noise that is not stated, `inadequate` is the correct verdict."
    ),
    size=500,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)
