"""Posterior: compare draws with linear intervals, and check their calibration.

For well determined fits, intervals of `giajax.posterior` are compared with those from the Jacobian.
One fit is of growth recorded to its end, and one of loops of a play operator, which is linear in
its weights, so the linear intervals are exact. For poorly determined fits, true values are drawn
from the prior, recorded and fitted. The rank of a true value among independent draws is then
uniform (simulation-based calibration, Talts et al. 2018, arXiv:1804.06788), and a 95 % interval
contains 95 % of them. Growth is recorded for a short time only, which gives a curved valley, or its
rate is known to be between two bounds whose distance is similar to the width of the posterior.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ._study import PROBABILITY, Figures, Study, shares_differ

# Number of draws, thinning of the draws, and number of bins of ranks.
DRAWS, EVERY, BINS = 126, 2, 8


class Case(NamedTuple):
    """The prior of the true values, and the recording.

    Attributes:
        duration: duration of a recording, s.
        noise: standard deviation of the noise, m.
        amplitude: mean and standard deviation of the prior.
        rate: bounds of the rate, whose prior is uniform.
    """

    duration: float
    noise: float
    amplitude: tuple[float, float]
    rate: tuple[float, float]


CASES = {
    "a bent valley": Case(0.8, 0.04, (2.0, 0.5), (0.4, 3.0)),
    "two near bounds": Case(3.0, 0.15, (2.0, 0.05), (0.95, 1.05)),
}


def run(size: int, seed: int) -> Figures:
    """Return the figures of two long posteriors, and of `size` short ones of each case."""
    import jax

    jax.config.update("jax_enable_x64", True)
    return {
        "agreement": {"growth": _growth(seed), "play operator": _loops(seed)},
        "calibration": {
            name: _calibrated(case, size, [seed, index])
            for index, (name, case) in enumerate(CASES.items())
        },
    }


def _recorded(values: tuple[float, float], duration: float, noise: float, entropy: Any) -> Any:
    import giajax

    times = np.linspace(0.0, duration, 200)
    clean = -values[0] * np.expm1(-values[1] * times)
    rng = np.random.default_rng(entropy)
    return giajax.Run.from_arrays(
        times,
        {"tip_z": clean + noise * rng.normal(size=len(times))},
        noise={"position": noise},
        definition={"free_motion": True},
    )


def _growth(seed: int) -> Figures:
    import giajax

    from ._growth import Growth

    recorded = _recorded((2.0, 1.0), 4.0, 0.01, [seed, 1])
    settings: dict[str, Any] = {"start": {"rate": 0.7}, "noise_model": "white", "check": False}
    result = giajax.fit(Growth(), recorded, free=["amplitude", "rate"], **settings)
    return _compared(giajax.posterior(result, recorded, draws=1800, warmup=300, seed=seed))


def _loops(seed: int) -> Figures:
    import giajax

    from ._experiments import play_operator

    experiment = play_operator()
    recorded = experiment.recorded(
        experiment.stating("all", 0.0), 0.0, np.random.default_rng([seed, 2])
    )
    settings: dict[str, Any] = {"start": experiment.start, "noise_model": "white", "check": False}
    result = giajax.fit(experiment.model, recorded, free=list(experiment.truth), **settings)
    return _compared(giajax.posterior(result, recorded, draws=1800, warmup=300, seed=seed))


def _compared(found: Any) -> Figures:
    """Return the width and shift of each interval relative to the linear one."""
    parameters = {}
    for label, one in found.summary.parameters.items():
        width = one.linear[1] - one.linear[0]
        parameters[label] = {
            "width": round((one.interval[1] - one.interval[0]) / width, 4),
            "shift": round((one.mean - one.fitted) / width, 4),
            "r_hat": round(one.r_hat, 4),
            "ess_bulk": round(one.ess_bulk),
            "ess_tail": round(one.ess_tail),
        }
    return {"divergences": found.summary.divergences, "parameters": parameters}


def _calibrated(case: Case, size: int, entropy: list[int]) -> Figures:
    import giajax

    from ._growth import Growth

    paths = ("amplitude", "rate")
    counts = {path: [0] * BINS for path in paths}
    within = {path: {"posterior": 0, "linear": 0} for path in paths}
    divergences = 0
    prior = giajax.Prior(case.amplitude[0], deviation=case.amplitude[1])
    for number in range(size):
        rng = np.random.default_rng([*entropy, number])
        truth = rng.normal(*case.amplitude), rng.uniform(*case.rate)
        recorded = _recorded(truth, case.duration, case.noise, [*entropy, number, 1])
        result = giajax.fit(
            Growth(),
            recorded,
            free=list(paths),
            start={"amplitude": case.amplitude[0], "rate": float(np.mean(case.rate))},
            priors={"amplitude": prior},
            bounds={"rate": case.rate},
            noise_model="white",
            check=False,
        )
        seed = int(rng.integers(2**31))
        found = giajax.posterior(result, recorded, chains=1, draws=DRAWS, warmup=80, seed=seed)
        divergences += found.summary.divergences
        for path, true in zip(paths, truth, strict=True):
            draws = found.draws_of(path)[0]
            rank = int(np.sum(draws[::EVERY] < true))
            counts[path][rank * BINS // (DRAWS // EVERY + 1)] += 1
            one = found.summary.parameters[path]
            for name, ends in (("posterior", one.interval), ("linear", one.linear)):
                within[path][name] += bool(ends is not None and ends[0] <= true <= ends[1])
    return {
        "repetitions": size,
        "divergences": divergences,
        "parameters": {path: {"ranks": counts[path], **within[path]} for path in paths},
    }


def p_value(ranks: list[int]) -> float:
    """Return the p-value of the ranks if they are uniform (chi-square test)."""
    from scipy.stats import chisquare

    return float(chisquare(ranks).pvalue)


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report figures with a probability below `PROBABILITY`, or an error of more than 10 %."""
    from scipy.stats import chi2_contingency

    sentences = []
    for name, each in new["agreement"].items():
        for path, one in each["parameters"].items():
            before = stored["agreement"][name]["parameters"][path]
            if abs(one["width"] - before["width"]) > 0.1:
                sentences.append(
                    f"{name}, {path}: the interval is {one['width']} of the linear one, "
                    f"and was {before['width']}"
                )
    for name, each in new["calibration"].items():
        n, m = stored["calibration"][name]["repetitions"], each["repetitions"]
        for path, one in each["parameters"].items():
            before = stored["calibration"][name]["parameters"][path]
            both = np.array([one["ranks"], before["ranks"]])
            table = both[:, both.sum(axis=0) > 0]
            if chi2_contingency(table).pvalue < PROBABILITY:
                sentences.append(f"{name}, {path}: the ranks are {one['ranks']}, not as before")
            a, b = one["posterior"], before["posterior"]
            if shares_differ(a, m, b, n):
                sentences.append(f"{name}, {path}: {a} of {m} intervals hold the truth")
    return sentences


SHOWN = {"a bent valley": "curved valley", "two near bounds": "two close bounds"}
"""Stored names of models -> names on the page."""


def table(figures: Figures) -> list[str]:
    """Return two tables: agreement, and calibration."""
    rows = [
        "| well determined model | parameter | ratio of 95 % intervals, posterior to linear | "
        "shift of the mean relative to the interval | R-hat | ESS bulk | ESS tail |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures["agreement"].items():
        for path, one in each["parameters"].items():
            rows.append(
                f"| {name} | `{path}` | {one['width']:.3f} | {one['shift']:+.3f} | "
                f"{one['r_hat']:.3f} | {one['ess_bulk']} | {one['ess_tail']} |"
            )
    rows += [
        "",
        "| nonlinear model | parameter | coverage, posterior | coverage, linear interval | true "
        "values in each eighth of the ranks | p of uniform ranks | divergent draws |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures["calibration"].items():
        for path, one in each["parameters"].items():
            rows.append(_row(SHOWN[name], path, one, each))
    return rows


def _row(name: str, path: str, one: Mapping[str, Any], case: Mapping[str, Any]) -> str:
    count = case["repetitions"]
    diverged = f"{case['divergences']} of {count * DRAWS}"
    shares = (f"{100 * one[key] / count:.1f} %" for key in ("posterior", "linear"))
    ranks = ", ".join(map(str, one["ranks"]))
    cells = (name, f"`{path}`", *shares, ranks, f"{p_value(one['ranks']):.2f}", diverged)
    return f"| {' | '.join(cells)} |"


POSTERIOR = Study(
    name="posterior",
    meaning=(
        "Where the linear approximation is accurate, draws of `giajax posterior` are compared "
        "with the linear interval of the fit. For nonlinear models, true values are drawn from the "
        "prior, and synthetic recordings with these values are fitted. The posterior interval "
        "should contain 95 % of the true values, and their ranks among independent draws should "
        "be uniform (simulation-based calibration, [Talts et al. "
        "2018](https://arxiv.org/abs/1804.06788))."
    ),
    size=60,
    seed=3,
    run=run,
    disagreements=disagreements,
    table=table,
)
