"""Leaks: detection delay and false alarms of a tracker during flight, and its estimate of C_D.

The stiffness of arms in still air is sampled, and the base joint moves to another angle every ten
seconds. A camera records the tip with a delay of half a second and 20 mm of noise. The tracker
starts with the nominal stiffness. Some short arms fly in gusts, which the tracker estimates.
"""

import dataclasses
from typing import Any

import numpy as np

from ._study import Figures, Study
from ._tracking import INTENSITY, LENGTH_SCALE, MEAN, SETTLED, wind_at_links

LINKS, SHORT = 20, 6
STIFFNESS, YAW, DRAG = "joints.pitch_stiffness", "joints.yaw_stiffness", "air.drag_coefficient"
SPREAD = 0.05  # standard deviation of the logarithm of the stiffness
DRAWN, PRIOR = 0.15, 0.3  # relative standard deviation of C_D: of its true value, in the tracker
NOISE, DELAY, INTERVAL = 0.02, 0.5, 0.1  # m, s, s
LEFT = 0.8  # fraction of the stiffness after a leak
EVERY = 10.0  # s, interval between commands
FLIES, HOURS, PART = 120.0, 2.0, 0.25  # s; h of arms without a leak, and duration of each run
GUSTY = 4  # number of arms in gusts
# Requirements.
WITHIN, OFTEN, FALSE = 30.0, 0.9, 1.0  # s, fraction of arms, false alarms in 20 h
OFF, WIDER = 2.0, 1.2  # error of C_D in standard errors; standard error relative to that of a fit
ALIKE = 0.1  # difference from a fit in standard errors, for a tracker with the same assumptions


def run(size: int, seed: int, links: int = LINKS, hours: float = HOURS) -> Figures:
    """Return the figures of `size` arms: C_D, a leak, and `hours` of flight without a leak."""
    import jax

    jax.config.update("jax_enable_x64", True)
    rows = [_arm(np.random.default_rng([seed, k]), links, hours) for k in range(size)]
    gusty = [_in_gusts(np.random.default_rng([seed, k, 1])) for k in range(min(size, GUSTY))]
    return {"links": links, "hours": size * hours, "arms": rows, "in_gusts": gusty}


def part(size: int, seed: int) -> Figures:
    """Return the figures of short arms."""
    return run(size, seed, SHORT, PART)


def _arm(rng: np.random.Generator, links: int, hours: float) -> dict[str, Any]:
    from giajax import ArmModel, fit, replace, takeichi_20m, track
    from giajax.apps.tracking import Unknown

    arm = takeichi_20m(links)
    late = replace(ArmModel(arm), {"camera.delay": DELAY})
    drag = float(arm.air.drag_coefficient)
    true = drag * float(np.exp(DRAWN * rng.normal()))
    flown = recorded(replace(arm, {DRAG: true}), rng, FLIES)
    fitted = fit(late, flown, free=[DRAG], nuisances=False).parameters[DRAG]
    unknown = Unknown(estimated={DRAG: PRIOR * drag})
    found = track(late, flown, unknown=unknown).filtered
    # The same assumptions as in the fit: exact initial state and exact equation of motion.
    unknown = dataclasses.replace(unknown, torque=1e-9, at_start=(1e-7, 1e-7))
    alike = track(late, flown, unknown=unknown).smoothed
    value, error = found.parameters[DRAG][-1], found.parameter_deviations[DRAG][-1]
    facts: dict[str, Any] = {
        "drag_off_in_errors": float((value - true) / error),
        "drag_error_over_fit": float(error / fitted.standard_error),
        "drag_from_fit_in_errors": float((value - fitted.value) / fitted.standard_error),
        "alike_error_over_fit": float(alike.parameter_deviations[DRAG][-1] / fitted.standard_error),
        "alike_from_fit_in_errors": float(
            (alike.parameters[DRAG][-1] - fitted.value) / fitted.standard_error
        ),
    }

    stiffness = float(arm.joints.pitch_stiffness)
    own = float(np.exp(SPREAD * rng.normal()))
    drawn = replace(arm, {STIFFNESS: own * stiffness, YAW: own * stiffness})
    unknown = Unknown(estimated={STIFFNESS: 2 * SPREAD * stiffness}, ties={YAW: STIFFNESS})
    leaks = float(rng.uniform(40.0, 80.0))
    changes = track(late, recorded(drawn, rng, FLIES, leaks), unknown=unknown).changes
    seen = [change for change in changes if change.found >= leaks]
    facts["false_before_leak"] = len(changes) - len(seen)
    facts["found_after_s"] = seen[0].found - leaks if seen else None
    facts["time_off_s"] = seen[0].time - leaks if seen else None
    facts["size"] = seen[0].size / (own * stiffness) if seen else None

    short = takeichi_20m(SHORT)
    stiffness = float(short.joints.pitch_stiffness)
    unknown = Unknown(estimated={STIFFNESS: 2 * SPREAD * stiffness}, ties={YAW: STIFFNESS})
    drawn = replace(short, {STIFFNESS: own * stiffness, YAW: own * stiffness})
    late = replace(ArmModel(short), {"camera.delay": DELAY})
    false = 0
    for _ in range(round(hours / PART)):
        sound = recorded(drawn, rng, 3600.0 * PART)
        false += len(track(late, sound, unknown=unknown).changes)
    facts["false_alarms"] = false
    return facts


def _in_gusts(rng: np.random.Generator) -> dict[str, Any]:
    """Return the figures of a leak of a short arm in gusts."""
    from giajax import ArmModel, replace, takeichi_20m_full, track
    from giajax.apps.tracking import Air, Unknown, usual_places
    from giajax.apps.wind import first_guess

    arm = takeichi_20m_full(SHORT)
    late = replace(ArmModel(arm), {"camera.delay": DELAY})
    stiffness, own = float(arm.joints.pitch_stiffness), float(np.exp(SPREAD * rng.normal()))
    drawn = replace(arm, {STIFFNESS: own * stiffness, YAW: own * stiffness})
    wind = first_guess(MEAN, INTENSITY, LENGTH_SCALE, 12.0)
    unknown = Unknown(
        air=Air(wind, 0.1, places=usual_places(late)),
        estimated={STIFFNESS: 2 * SPREAD * stiffness},
        ties={YAW: STIFFNESS},
    )
    leaks = float(rng.uniform(40.0, 80.0))
    found = track(late, recorded(drawn, rng, FLIES, leaks, gusty=True), unknown=unknown)
    changes, states = found.changes, found.filtered
    seen = [change for change in changes if change.found >= leaks]
    before = int(np.searchsorted(found.times, leaks)) - 1
    return {
        "false_before_leak": len(changes) - len(seen),
        "found_after_s": seen[0].found - leaks if seen else None,
        "watched_for_s": FLIES - leaks,
        "error_before": float(states.parameter_deviations[STIFFNESS][before] / stiffness),
    }


def recorded(
    arm: Any,
    rng: np.random.Generator,
    lasts: float,
    leaks: float | None = None,
    *,
    gusty: bool = False,
) -> Any:
    """Return a run of the arm, whose stiffness decreases at the time `leaks`."""
    from giajax import Run, replace, simulate
    from giajax.simulation import logged, ramps

    wind = logged(*wind_at_links(arm, rng, lasts)) if gusty else None
    stamps = INTERVAL * np.arange(round(lasts / INTERVAL) + 1)
    start = -SETTLED if gusty else -DELAY
    exposures = np.unique([start, *(stamps - DELAY)])
    begins = np.concatenate([[start, 0.0], np.arange(EVERY, lasts + EVERY, EVERY)])
    rows = np.zeros((len(begins), arm.count))
    rows[2:, 0] = np.deg2rad(rng.uniform(-25, 25, len(begins) - 2))
    command = ramps(begins, rows)
    until = exposures if leaks is None else np.append(exposures[exposures < leaks], leaks)
    motion = simulate(arm, command, until, wind=wind)
    tip = np.asarray(motion.tip)
    if leaks is not None:
        left = {path: LEFT * float(getattr(arm.joints, path[7:])) for path in (STIFFNESS, YAW)}
        after = np.append(leaks, exposures[exposures >= leaks])
        state = (motion.angles[-1], motion.rates[-1])
        rest = simulate(replace(arm, left), command, after, wind=wind, initial=state)
        tip = np.concatenate([tip[:-1], np.asarray(rest.tip)[1:]])
    tip = tip[-len(stamps) :]
    names = [f"tip_{axis}" for axis in "xyz"]
    values = dict(zip(names, (tip + NOISE * rng.normal(size=tip.shape)).T, strict=True))
    values["joint01_command"] = np.interp(stamps, begins, rows[:, 0])
    return Run.from_arrays(stamps, values, name="drawn", noise=dict.fromkeys(names, NOISE))


def _shares(figures: Figures) -> tuple[float, float, int, int]:
    """Return detections in time, false alarms in 20 h, and correct and precise estimates."""
    arms = figures["arms"]
    soon = [a["found_after_s"] is not None and a["found_after_s"] <= WITHIN for a in arms]
    hours = figures["hours"] + len(arms) * FLIES / 7200
    false = sum(a["false_alarms"] + a["false_before_leak"] for a in arms) * 20 / hours
    right = sum(abs(a["drag_off_in_errors"]) < OFF for a in arms)
    sure = sum(a["drag_error_over_fit"] < WIDER for a in arms)
    return float(np.mean(soon)), false, right, sure


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report undetected leaks, false alarms, and estimates of C_D with large errors."""
    del stored  # the limits apply to every arm
    soon, false, _, _ = _shares(new)
    sentences = []
    if soon < OFTEN and len(new["arms"]) * (1 - soon) > 1:
        sentences.append(f"{soon:.0%} of the leaks are detected within {WITHIN:g} s")
    if false > FALSE and sum(arm["false_alarms"] for arm in new["arms"]) > 1:
        sentences.append(f"{false:.1f} false alarms in 20 h")
    wide = max(arm["drag_error_over_fit"] for arm in new["arms"])
    if wide > 2 * WIDER:
        sentences.append(f"a standard error of C_D is {wide:.1f} times that of a fit")
    off = max(abs(arm["alike_from_fit_in_errors"]) for arm in new["arms"])
    if off > ALIKE:
        sentences.append(f"a C_D differs by {off:.2f} standard errors from that of an equal fit")
    far = max(abs(arm["drag_off_in_errors"]) for arm in new["arms"])
    if far > 2 * OFF:
        sentences.append(f"a C_D deviates from the truth by {far:.1f} standard errors")
    return sentences


def table(figures: Figures) -> list[str]:
    """Return a table of the requirements and the figures."""
    arms = figures["arms"]
    soon, false, right, sure = _shares(figures)
    found = [arm["found_after_s"] for arm in arms if arm["found_after_s"] is not None]
    times = [abs(arm["time_off_s"]) for arm in arms if arm["time_off_s"] is not None]
    sizes = [arm["size"] for arm in arms if arm["size"] is not None]
    ratio = [arm["drag_error_over_fit"] for arm in arms]
    alike = [arm["alike_error_over_fit"] for arm in arms]
    off = max(abs(arm["alike_from_fit_in_errors"]) for arm in arms)
    gusty = figures["in_gusts"]
    called = sum(arm["found_after_s"] is not None for arm in gusty)
    watched = [arm["watched_for_s"] for arm in gusty]
    known = [arm["error_before"] for arm in gusty]
    rows = [
        (
            f"leaks of {1 - LEFT:.0%} detected within {WITHIN:g} s",
            f"{soon:.0%} (median {np.median(found):.1f} s, largest {max(found):.1f} s)",
        ),
        ("largest error of the estimated time at which the leak starts", f"{max(times):.1f} s"),
        ("estimated change of stiffness at detection", f"{min(sizes):.0%} to {max(sizes):.0%}"),
        (f"false alarms per 20 h, in {figures['hours']:g} h of flight", f"{false:.2g}"),
        (
            f"C_D after {FLIES:g} s within {OFF:g} standard errors of the truth",
            f"{right} of {len(arms)}",
        ),
        (
            f"standard error of C_D at most {WIDER:g} times that of a fit of these {FLIES:g} s",
            f"{sure} of {len(arms)} ({min(ratio):.2f} to {max(ratio):.2f})",
        ),
        (
            "the same ratio under the assumptions of the fit; deviation from the fit in standard "
            "errors",
            f"{min(alike):.3f} to {max(alike):.3f}; at most {off:.2f}",
        ),
        (
            f"leaks detected in gusts within {min(watched):.0f} to "
            f"{max(watched):.0f} s (arms of {SHORT} links)",
            f"{called} of {len(gusty)}; standard error of the stiffness before the leak: "
            f"{min(known):.1%} to {max(known):.1%}",
        ),
    ]
    return [
        "| quantity | result |",
        "| --- | --- |",
        *(f"| {name} | {cell} |" for name, cell in rows),
        "",
        f"Leaks and C_D are estimated on arms of {figures['links']} links. False alarms are "
        f"counted on arms of {SHORT} links. The arms move all the time, and the air is still "
        "except in the last row. A fit assumes that the initial state and the equation of motion "
        "are exact. The tracker assumes an uncertainty of 2 degrees in the initial angles, and "
        "its default unmodelled torque. Gusts have a standard deviation of "
        f"{INTENSITY * float(np.linalg.norm(MEAN)):.2g} m/s, and the tracker estimates them.",
    ]


LEAKS = Study(
    name="leaks",
    meaning=(
        "`giajax track --free` detects a leak while an arm flies, and estimates the drag "
        "coefficient. The leak reduces the stiffness of all joints by a fifth. The drag "
        "coefficient is compared with a fit of the same run."
    ),
    size=10,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
