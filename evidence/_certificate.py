"""Certificates: chances of missions by a minute of the resting arm, and what came of them.

Arms and air are drawn as the file of the mission says, the speed of the air evenly from a range in
which most missions succeed at one end and few at the other. Each rests for a minute, of which the
place of the tip is recorded with an error of 5 mm, and goes on to the opening. Each is certified by
200 others, as many as the command flies.
"""

from typing import Any

import numpy as np

from ._record import ROOT
from ._study import Figures, Study, shares_differ

FILE, DRIVER = "naraha.toml", "operator"
SPEEDS = (0.1, 0.6)  # m/s
CHANNELS, NOISE, RATE = ("tip_x", "tip_y", "tip_z"), 0.005, 10.0
SECONDS, OTHERS = 60.0, 200
CLASSES = ((0.0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 1.0))
BETWEEN = (0.2, 0.9)  # share of success at a speed of the air: there missions go either way


def run(size: int, seed: int) -> Figures:
    """Figures of so many missions and certificates."""
    rested, resting = _rested(size, seed)
    return {**_counts(rested), **_certified(rested, resting.channels, seed)}


def part(size: int, seed: int) -> Figures:
    """Missions without certificates, for which they are too few."""
    return _counts(_rested(size, seed)[0])


def _rested(count: int, seed: int) -> tuple[Any, Any]:
    import jax

    jax.config.update("jax_enable_x64", True)
    from giajax.apps.mission import Mission, Resting, fly_rested
    from giajax.recordings import Definition

    definition = Definition.load(ROOT / "missions" / FILE)
    mission = Mission.from_definition(definition, controller=DRIVER)
    # Means over half a second, as a recording has them.
    bins, noise = np.zeros((round(2 * SECONDS), 3)), NOISE / np.sqrt(RATE / 2)
    resting = Resting(CHANNELS, bins, np.full(3, noise))
    return fly_rested(mission, resting, SPEEDS, count, seed=1000 * seed), resting


def _counts(rested: Any) -> Figures:
    inside = sum(each.case.reached is not None for each in rested)
    return {"cases": len(rested), "inside": inside}


def _certified(rested: Any, channels: tuple[str, ...], seed: int) -> Figures:
    from scipy import stats

    from giajax.apps.mission import certificate

    random = np.random.default_rng(seed)
    found = []
    for place, each in enumerate(rested):
        others = np.delete(np.arange(len(rested)), place)
        some = random.choice(others, min(OTHERS, len(others)), replace=False)
        found.append(certificate(channels, each.shown, [rested[k] for k in some]))
    chance = np.array([each.chance for each in found])
    inside = np.array([each.case.reached is not None for each in rested], float)
    winds = np.array([each.case.wind for each in rested])
    # Spiegelhalter, Statistics in Medicine 5 (1986) 421.
    z = np.sum((inside - chance) * (1 - 2 * chance)) / np.sqrt(
        np.sum((1 - 2 * chance) ** 2 * chance * (1 - chance))
    )
    # Hosmer and Lemeshow, on others than those that were fitted: as many degrees as groups.
    groups = np.array_split(np.argsort(chance), 10)
    square = sum(
        np.sum(inside[k] - chance[k]) ** 2 / np.sum(chance[k] * (1 - chance[k])) for k in groups
    )
    by_air = _by_air(winds, inside)
    middling = (by_air > BETWEEN[0]) & (by_air < BETWEEN[1])
    return {
        "spiegelhalter_p": round(float(2 * stats.norm.sf(abs(z))), 4),
        "hosmer_lemeshow_p": round(float(stats.chi2.sf(square, len(groups))), 4),
        "skill": _skill(chance, inside),
        "skill_of_the_true_air": _skill(by_air, inside),
        "middling": {
            "cases": int(middling.sum()),
            "air_m_per_s": [round(float(each), 3) for each in np.quantile(winds[middling], [0, 1])],
            "skill": _skill(chance[middling], inside[middling]),
            "skill_of_the_true_air": _skill(by_air[middling], inside[middling]),
        },
        "unlike": sum(each.unlike for each in found),
        "air_holds": sum(
            each.air[0] <= wind <= each.air[2] for each, wind in zip(found, winds, strict=True)
        ),
        "interval_width": round(
            float(np.mean([each.interval[1] - each.interval[0] for each in found])), 4
        ),
        "classes": [
            {
                "chance": [low, high],
                "cases": int(these.sum()),
                "mean_chance": round(float(chance[these].mean()), 4),
                "inside": int(inside[these].sum()),
            }
            for low, high in CLASSES
            if (these := (chance >= low) & (chance < high)).any()
        ],
    }


def _by_air(winds: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The share of success at the true speed of the air, by a logistic curve."""
    from scipy.optimize import minimize
    from scipy.special import expit

    table = np.stack([np.ones_like(winds), winds - winds.mean()])

    def cost(weights: np.ndarray) -> float:
        logits = weights @ table
        return float(np.sum(np.logaddexp(0, logits) - inside * logits))

    return np.asarray(expit(minimize(cost, np.zeros(2)).x @ table))


def _skill(chance: np.ndarray, inside: np.ndarray) -> float:
    """By how much less the Brier score is than that of the share of success."""
    plain = np.mean((inside - inside.mean()) ** 2)
    return round(float(1 - np.mean((inside - chance) ** 2) / plain), 4)


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Another share of success than chance lets it be (Fisher's exact test)."""
    shares = stored["inside"], stored["cases"], new["inside"], new["cases"]
    found = f"{new['inside']} of {new['cases']} came in, {stored['inside']} of {stored['cases']}"
    return [found] if shares_differ(*shares) else []


def table(figures: Figures) -> list[str]:
    """What chances came to, and how good they are."""
    rows = [
        "| predicted probability of success | missions | mean prediction | successful missions |",
        "| --- | --- | --- | --- |",
    ]
    for each in figures["classes"]:
        low, high = each["chance"]
        share = each["inside"] / each["cases"]
        rows.append(
            f"| {100 * low:.0f} to {100 * high:.0f} % | {each['cases']} | "
            f"{100 * each['mean_chance']:.1f} % | {each['inside']} ({100 * share:.1f} %) |"
        )
    middling = figures["middling"]
    low, high = middling["air_m_per_s"]
    return [
        *rows,
        "",
        f"{figures['inside']} of {figures['cases']} missions of the {DRIVER} succeed, at air "
        f"speeds of {SPEEDS[0]:g} to {SPEEDS[1]:g} m/s. Tests of the calibration give p = "
        f"{figures['spiegelhalter_p']:.2f} (Spiegelhalter) and {figures['hosmer_lemeshow_p']:.2f} "
        "(Hosmer and Lemeshow). The Brier skill score, relative to the overall rate of success, is "
        f"{figures['skill']:.2f}; that of a prediction from the true air speed is "
        f"{figures['skill_of_the_true_air']:.2f}. For the {middling['cases']} missions at air "
        f"speeds of {low:.2f} to {high:.2f} m/s, where 20 to 90 % succeed, these scores are "
        f"{middling['skill']:.2f} and {middling['skill_of_the_true_air']:.2f}. The range of air "
        "speeds of the most similar tenth of the missions contains the true air speed in "
        f"{figures['air_holds']} missions. Number of recordings that are reported as outliers: "
        f"{figures['unlike']}.",
    ]


CERTIFICATE = Study(
    name="certificate",
    meaning=(
        "The probability of success that `giajax mission --from-recording` predicts from a "
        "recording of the resting arm, one minute long, is compared with the outcome of the "
        "missions."
    ),
    size=1000,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
