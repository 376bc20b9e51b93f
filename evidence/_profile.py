"""Profiles: compare profile-likelihood intervals with standard errors, and check their coverage.

The first figures are the differences between the two intervals for a recording of an arm that
determines its parameters well. The others are coverage and width of both 95 % intervals for two
models in closed form, whose recordings differ only in their noise. In one model, the true value of
a parameter is its bound, so half of the estimates are at the bound. The other one has a curved
valley, because a slow decay is recorded for little more than its time constant.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._record import ROOT
from ._study import Figures, Study, shares_differ

BASE_STEP = ROOT / "fits" / "base_step.toml"
DETERMINED = ("joints.pitch_stiffness", "joints.damping", "air.drag_coefficient")

BEND = {"offset": 0.3, "slope": 0.2, "bend": 0.0}
DECAY = {"amplitude": 2.0, "rate": 0.5, "offset": 0.3}


def run(size: int, seed: int) -> Figures:
    """Return the figures of the recording, and of `size` fits of each model."""
    return {"base_step": _agreement(), **closed_forms(size, seed)}


def closed_forms(size: int, seed: int) -> Figures:
    """Return the figures of `size` fits of each model, without the arm."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from ._profile_models import Bend, Decay

    return {
        "a bound": _coverage(Bend(), BEND, ("slope", "bend"), 4.0, 0.05, [seed, 0], size),
        "a bent valley": _coverage(
            Decay(), DECAY, ("amplitude", "offset"), 2.4, 0.15, [seed, 1], size
        ),
    }


def _agreement() -> Figures:
    """Return the differences between the ends of the two intervals of the arm, in half widths."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import giajax

    task = giajax.FitTask.load(BASE_STEP)
    result = task.run()
    profiles = giajax.profile(result, task.prepare().runs, DETERMINED)
    figures = {}
    for path in DETERMINED:
        found = profiles[path]
        assert found.linear is not None
        half = (found.linear[1] - found.linear[0]) / 2
        off = [
            (by_profile - by_error) / half
            for by_profile, by_error in zip(found.interval, found.linear, strict=True)
            if by_profile is not None
        ]
        figures[path] = [round(float(each), 4) for each in off]
    return figures


def _coverage(
    model: Any,
    truth: Mapping[str, float],
    asked: Sequence[str],
    seconds: float,
    noise: float,
    entropy: list[int],
    size: int,
) -> Figures:
    """Return the coverage of both intervals of each parameter, and their widths."""
    import giajax

    times = np.linspace(0.0, seconds, 40)
    exact = np.asarray(model.height(times, **truth))
    within = {path: [0, 0] for path in asked}
    widths: dict[str, list[tuple[float, float]]] = {path: [] for path in asked}
    missing = dict.fromkeys(asked, 0)
    fits = 0
    for number in range(size):
        rng = np.random.default_rng([*entropy, number])
        recorded = giajax.Run.from_arrays(
            times,
            {"tip_z": exact + noise * rng.normal(size=len(times))},
            noise={"position": noise},
            definition={"free_motion": True},
        )
        result = giajax.fit(model, recorded, noise_model="white", check=False)
        if result.status != "converged":
            continue
        fits += 1
        for path, found in giajax.profile(result, recorded, asked).profiles.items():
            true = truth[path]
            if found.linear is not None:
                within[path][0] += found.linear[0] <= true <= found.linear[1]
            low, high = found.interval
            missing[path] += low is None or high is None
            # An end that the data do not determine counts as infinite.
            low, high = (-np.inf if low is None else low), (np.inf if high is None else high)
            within[path][1] += low <= true <= high
            if found.linear is not None and np.isfinite(high - low):
                widths[path].append((found.linear[1] - found.linear[0], high - low))
    return {
        path: {
            "truth": truth[path],
            "fits": fits,
            "by_error": within[path][0],
            "by_profile": within[path][1],
            "without_an_end": missing[path],
            "width": round(float(np.median([b / a for a, b in widths[path]])), 3),
        }
        for path in asked
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report coverages that differ by more than by chance, and changed intervals of the arm."""
    sentences = []
    for case, before in stored.items():
        if case not in new:
            continue
        for path, old in before.items():
            now, where = new[case][path], f"{case}, {path}"
            if case == "base_step":
                if not np.allclose(old, now, atol=0.01):
                    sentences.append(f"{where}: the ends differ by {now}, and did by {old}")
                continue
            for key in ("by_error", "by_profile"):
                if shares_differ(old[key], old["fits"], now[key], now["fits"]):
                    sentences.append(
                        f"{where}: {now[key]} of {now['fits']} {key.replace('_', ' ')}, and "
                        f"{old[key]} of {old['fits']} were within"
                    )
    return sentences


SHOWN = {"a bound": "parameter at a bound", "a bent valley": "curved valley"}
"""Stored names of models -> names on the page."""


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each parameter."""
    rows = [
        "| model | parameter | coverage, standard error | coverage, profile | median ratio of the "
        "widths, profile to standard error |",
        "| --- | --- | --- | --- | --- |",
    ]
    for case, each in figures.items():
        if case == "base_step":
            continue
        for path, one in each.items():
            shares = [f"{100 * one[key] / one['fits']:.1f} %" for key in ("by_error", "by_profile")]
            rows.append(f"| {SHOWN[case]} | `{path}` | {' | '.join(shares)} | {one['width']:.2f} |")
    rows += [
        "",
        "| parameter of the demonstration run | difference of the lower ends | difference of the "
        "upper ends |",
        "| --- | --- | --- |",
    ]
    for path, (low, high) in figures["base_step"].items():
        rows.append(f"| `{path}` | {100 * low:.1f} % | {100 * high:.1f} % |")
    return rows


PROFILE = Study(
    name="profile",
    meaning=(
        "Intervals from the standard error are compared with intervals from the profile "
        "likelihood. For two closed-form models, one with a parameter whose true value lies on "
        "its bound and one with a curved valley of the cost, the first table lists how often each "
        "95 % interval contains the truth. For the demonstration run, whose parameters are well "
        "determined, the second table lists the differences between the ends of the intervals, "
        "divided by half the width of the interval."
    ),
    size=200,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=closed_forms,
)
