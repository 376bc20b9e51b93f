"""Coverage: how often the truth is within the 95 % interval of a fit.

A model makes runs that differ in their noise alone, which is white and normal and stated; every
run is fitted from the same start, away from the truth. An interval is the value and 1.96 standard
errors on both sides. A pull is the error over the standard error: if the errors are honest, pulls
have mean 0 and deviation 1, and 95 % of the intervals hold the truth.
"""

import itertools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ._study import Figures, Study

if TYPE_CHECKING:
    from giajax import AbstractModel, Run

WIDTH = 1.96
# Of a disagreement by chance, for each of the few dozen comparisons.
PROBABILITY = 1e-4

ARM = {
    "air.drag_coefficient": (1.1, 0.9),
    "joints.pitch_stiffness": (2.5, 3.0),
    "joints.yaw_stiffness": (4.0, 5.0),
    "joints.damping": (0.1, 0.07),
}
LOOPS = {
    "elastic": (0.52, 0.9),
    "weights[0]": (0.19, 0.1),
    "weights[1]": (0.25, 0.1),
    "offset": (0.03, 0.06),
}

Recorder = Callable[[int], "Run"]


def short_arm(truth: Mapping[str, float]) -> "tuple[AbstractModel, Recorder]":
    """An arm of four links whose first two joints are driven for 4 s; noise 0.01 m."""
    import giajax

    model = giajax.ArmModel(giajax.replace(giajax.chain(4), truth))
    times = np.linspace(0.0, 4.0, 41)
    ramp = np.clip(times / 0.5, 0, 1)
    commands = {"joint01_command": 0.6 * ramp, "joint02_command": -0.5 * ramp}
    channels = ["link02_y", "link04_y", "link04_z"]

    def record(seed: int) -> "Run":
        return giajax.synthesise(
            model, times, commands, channels, noise={"position": 0.01}, seed=seed
        )

    return giajax.ArmModel(giajax.chain(4)), record


def play_operator(truth: Mapping[str, float]) -> "tuple[AbstractModel, Recorder]":
    """Loops within loops of a Prandtl-Ishlinskii operator of two plays; noise 0.3 deg."""
    import giajax

    section = {"operator": "prandtl_ishlinskii", "thresholds": [0.2, 0.5]}
    definition = {"hysteresis": {**section, "input_range": [-1.0, 1.0]}}
    turns = np.deg2rad([0, 55, -55, 40, -30, 50, -10, 20, -45, 0])
    ways = [np.linspace(a, b, 12)[1:] for a, b in itertools.pairwise(turns)]
    command = np.concatenate([[0.0], *ways])
    model = giajax.build_model("hysteresis", definition, truth)

    def record(seed: int) -> "Run":
        return giajax.synthesise(
            model,
            np.arange(len(command), dtype=float),
            {"command": command},
            ["angle"],
            noise={"angle": np.deg2rad(0.3)},
            seed=seed,
        )

    return giajax.build_model("hysteresis", definition, {}), record


CASES = {
    "an arm of 4 links": (short_arm, ARM),
    "plays of a joint": (play_operator, LOOPS),
}


def run(size: int, seed: int) -> Figures:
    """Figures of `size` fits of each case."""
    import jax

    jax.config.update("jax_enable_x64", True)
    figures: Figures = {}
    for index, (name, (case, values)) in enumerate(CASES.items()):
        truth = {path: true for path, (true, _) in values.items()}
        start = {path: first for path, (_, first) in values.items()}
        seeds = np.random.SeedSequence([seed, index]).generate_state(size, np.uint64)
        figures[name] = _refit(*case(truth), truth, start, [int(each) for each in seeds])
    return figures


def _refit(
    model: "AbstractModel",
    record: Recorder,
    truth: Mapping[str, float],
    start: Mapping[str, float],
    seeds: list[int],
) -> Figures:
    import giajax

    converged = 0
    pulls: dict[str, list[float]] = {path: [] for path in truth}
    for seed in seeds:
        result = giajax.fit(model, record(seed), free=list(truth), start=start, check=False)
        converged += result.status == "converged"
        for path, true in truth.items():
            estimate = result.parameters[path]
            # Without an interval the truth is not in it; and it would say nothing of the pulls.
            if estimate.standard_error is not None:
                pulls[path].append((estimate.value - true) / estimate.standard_error)
    return {
        "fits": len(seeds),
        "converged": converged,
        "parameters": {
            path: {
                "truth": truth[path],
                "intervals": len(each),
                "within": int(np.sum(np.abs(each) <= WIDTH)),
                "mean_pull": round(float(np.mean(each)), 4),
                "deviation_of_pulls": round(float(np.std(each, ddof=1)), 4),
            }
            for path, each in pulls.items()
        },
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """What would happen by chance less often than `PROBABILITY`, by classical tests."""
    if list(stored) != list(new):
        return [f"the cases are {list(new)}, and {list(stored)} are stored: run the study again"]
    sentences = []
    for case, before in stored.items():
        after = new[case]
        n, m = before["fits"], after["fits"]
        if _unlike(before["converged"], n, after["converged"], m):
            sentences.append(
                f"{case}: {after['converged']} of {m} fits converged, "
                f"and {before['converged']} of {n} did"
            )
        for path, old in before["parameters"].items():
            where, now = f"{case}, {path}", after["parameters"][path]
            if old["truth"] != now["truth"]:
                sentences.append(
                    f"{where}: the truth is {now['truth']}, and {old['truth']} is stored"
                )
            if _unlike(old["within"], n, now["within"], m):
                sentences.append(
                    f"{where}: {now['within']} of {m} intervals hold the truth, "
                    f"and {old['within']} of {n} did"
                )
            sentences += [f"{where}: {sentence}" for sentence in _unlike_pulls(old, now)]
    return sentences


def _unlike(a: int, n: int, b: int, m: int) -> bool:
    """Whether a of n and b of m cannot have one probability (Fisher's exact test)."""
    from scipy.stats import fisher_exact

    return bool(fisher_exact([[a, n - a], [b, m - b]]).pvalue < PROBABILITY)


def _unlike_pulls(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Whether two samples of pulls differ in mean (Welch) or in deviation (an F test)."""
    from scipy import stats

    sentences = []
    (a, s, n), (b, t, m) = (
        (each["mean_pull"], each["deviation_of_pulls"], each["intervals"]) for each in (old, new)
    )
    if stats.ttest_ind_from_stats(a, s, n, b, t, m, equal_var=False).pvalue < PROBABILITY:
        sentences.append(f"the mean pull is {b:.2f}, and was {a:.2f}")
    ratio = stats.f(m - 1, n - 1)
    if min(ratio.cdf((t / s) ** 2), ratio.sf((t / s) ** 2)) < PROBABILITY / 2:
        sentences.append(f"the pulls deviate by {t:.2f}, and did by {s:.2f}")
    return sentences


def table(figures: Figures) -> list[str]:
    """A row for each parameter."""
    rows = [
        "| fitted | parameter | truth | within the interval | mean pull | deviation of pulls |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for case, each in figures.items():
        for path, one in each["parameters"].items():
            share = 100 * one["within"] / each["fits"]
            rows.append(
                f"| {case} | `{path}` | {one['truth']:g} | {one['within']} of {each['fits']} "
                f"({share:.1f} %) | {one['mean_pull']:+.3f} | {one['deviation_of_pulls']:.3f} |"
            )
    return rows


COVERAGE = Study(
    name="coverage",
    meaning=(
        "Runs with white noise of the stated size, made by a model and fitted from a start away "
        "from the truth: how often the truth lies within 1.96 standard errors, and mean and "
        "deviation of the errors over the standard errors."
    ),
    size=500,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)
