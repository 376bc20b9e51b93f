"""Certificates: calibration of predicted probabilities of success from a minute of rest.

Arms and winds are sampled as the file of the mission specifies, with a uniform wind speed over a
range in which most missions succeed at one end and few at the other. Each arm rests for a minute,
during which the position of the tip is recorded with an error of 5 mm, and then moves to the
opening. The certificate of each mission is computed from 200 others, as many as the command
simulates.
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
BETWEEN = (0.2, 0.9)  # success rates at a wind speed between which the outcome is uncertain


def run(size: int, seed: int) -> Figures:
    """Return the figures of `size` missions and their certificates."""
    rested, resting = _rested(size, seed)
    return {**_counts(rested), **_certified(rested, resting.channels, seed)}


def part(size: int, seed: int) -> Figures:
    """Return the figures of missions without certificates, for which there are too few."""
    return _counts(_rested(size, seed)[0])


def _rested(count: int, seed: int) -> tuple[Any, Any]:
    import jax

    jax.config.update("jax_enable_x64", True)
    from giajax.apps.mission import Mission, Resting, fly_rested
    from giajax.recordings import Definition

    definition = Definition.load(ROOT / "missions" / FILE)
    mission = Mission.from_definition(definition, controller=DRIVER)
    # Means over half a second, as computed from a recording.
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
    # Hosmer and Lemeshow, for data that were not fitted: one degree of freedom per group.
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
    """Return the success rate at the true wind speed, from a logistic regression."""
    from scipy.optimize import minimize
    from scipy.special import expit

    table = np.stack([np.ones_like(winds), winds - winds.mean()])

    def cost(weights: np.ndarray) -> float:
        logits = weights @ table
        return float(np.sum(np.logaddexp(0, logits) - inside * logits))

    return np.asarray(expit(minimize(cost, np.zeros(2)).x @ table))


def _skill(chance: np.ndarray, inside: np.ndarray) -> float:
    """Return the Brier skill score relative to a constant prediction of the success rate."""
    plain = np.mean((inside - inside.mean()) ** 2)
    return round(float(1 - np.mean((inside - chance) ** 2) / plain), 4)


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report a success rate that differs by more than expected by chance (Fisher's exact test)."""
    shares = stored["inside"], stored["cases"], new["inside"], new["cases"]
    found = f"{new['inside']} of {new['cases']} came in, {stored['inside']} of {stored['cases']}"
    return [found] if shares_differ(*shares) else []


def table(figures: Figures) -> list[str]:
    """Return a table of predicted probabilities and outcomes, and sentences on their skill."""
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
        f"{figures['skill']:.2f}. The skill score of a prediction from the true air speed is "
        f"{figures['skill_of_the_true_air']:.2f}. For the {middling['cases']} missions at air "
        f"speeds of {low:.2f} to {high:.2f} m/s, where 20 to 90 % succeed, these scores are "
        f"{middling['skill']:.2f} and {middling['skill_of_the_true_air']:.2f}. The range of air "
        "speeds of the most similar tenth of the missions contains the true air speed in "
        f"{figures['air_holds']} missions. The number of recordings that are reported as outliers "
        f"is {figures['unlike']}.",
    ]


CERTIFICATE = Study(
    name="certificate",
    meaning=(
        "From a one-minute recording of the resting arm, `giajax mission --from-recording` "
        "predicts the probability that a mission succeeds. The table compares this prediction "
        "with the outcome of the missions."
    ),
    size=1000,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
