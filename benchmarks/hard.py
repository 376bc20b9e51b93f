"""Difficult fits: a real pendulum from distant initial guesses, and data that no arm can produce.

The pendulum swings for 120 s with Coulomb friction and aerodynamic drag, but without damping. Its
angle is measured with a noise of 0.05 degrees and with clock errors of 1 ms. Friction, C_D, length,
centre of mass, damping and the initial state of each window of 3 s are free. The initial guesses
are all corners of a box around the true values. Each fit must reach the optimum within 25
iterations, with a linear and with a robust loss. In the second part, the data are those of a driven
arm with the y and z axes swapped, a random walk, or a constant. These fits must end within 60 s and
give a reason.

    python -m benchmarks.hard [--quick] [--out FILE]
"""

import itertools
import sys
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from benchmarks.measuring import RESULTS, command_line, store
from giajax import FitResult, Run, fit, model_for, predict
from giajax.recordings import windows

MOST_ITERATIONS, MOST_SECONDS = 25, 60.0

# Path, true value, and the factor by which the initial guess is too large or too small.
PENDULUM = {
    "joints.friction": (5e-4, 3.0),
    "air.drag_coefficient": (1.2, 3.0),
    "links.length": (1.0, 1.5),
    "links.centre_of_mass": (0.6, 1.5),
}
DAMPING = {"joints.damping": 0.01}
_KNOWN = {
    "links.mass": 0.3,
    "links.inertia_transverse": 0.025,
    "links.diameter": 0.05,
    "joints.friction_rate": 0.01,
}
_NOISE_DEG, _JITTER, _WINDOW, _RATE = 0.05, 1e-3, 3.0, 25

# A fit whose cost exceeds the lowest cost by more than this fraction has not reached the optimum.
_SAME = 1e-5


def swing(seconds: float) -> list[Run]:
    """Simulate a recording of the pendulum, split into windows, with the correct preset."""
    parameters = {**_KNOWN, **{path: true for path, (true, _) in PENDULUM.items()}}
    arm = {"preset": "pendulum", "links": 1, "parameters": parameters}
    random = np.random.default_rng(3)
    times = np.linspace(0.0, seconds, int(_RATE * seconds) + 1)
    seen = times + np.where(times > 0, random.normal(scale=_JITTER, size=len(times)), 0)
    released = {"arm": arm, "initial": {"angle_deg": [20.0], "rate_deg_per_s": [0.0]}}
    plan = Run.from_arrays(seen, {"joint01_angle": np.zeros_like(times)}, definition=released)
    angle = predict(model_for([plan]), plan)["joint01_angle"]
    noise = np.deg2rad(_NOISE_DEG) * random.normal(size=len(times))
    about = {
        "arm": arm,
        "initial": {"free": True, "first_row": True},
        "noise": {"angle_deg": _NOISE_DEG},
    }
    return windows(
        Run.from_arrays(times, {"joint01_angle": angle + noise}, definition=about), _WINDOW
    )


def corner(ups: Sequence[int]) -> dict[str, float]:
    """Return an initial guess that is too large (1) or too small (-1) by the full factor."""
    off = {
        path: true * by**up for (path, (true, by)), up in zip(PENDULUM.items(), ups, strict=True)
    }
    return {**off, **DAMPING}


def from_every_side(
    seconds: float, corners: Sequence[Sequence[int]], losses: Sequence[str], steps: int = 50
) -> dict[str, Any]:
    """Fit the pendulum from each corner, and return how the fits ended, by loss."""
    runs = swing(seconds)
    ends: dict[str, list[dict[str, Any]]] = {loss: [] for loss in losses}
    for ups, (loss, rows) in itertools.product(corners, ends.items()):
        result, taken = _timed(
            runs,
            free=[*PENDULUM, *DAMPING],
            start=corner(ups),
            loss=loss,
            noise_model="white",
            max_iterations=steps,
        )
        rows.append({"corner": list(ups), "cost": result.cost, **_end(result, taken)})
        print(f"{loss:6} {ups!s:16} {result.cost:12.4f} {_shown(rows[-1])}", flush=True)
    for rows in ends.values():
        least = min(row["cost"] for row in rows)
        for row in rows:
            row["optimum"] = row["status"] == "converged" and row["cost"] <= least * (1 + _SAME)
    return ends


def impossible(links: int, seconds: float) -> dict[str, Any]:
    """Fit data that no arm can produce, and return how the fits ended, by the defect."""
    times = np.linspace(0.0, seconds, int(10 * seconds) + 1)
    ramp = np.clip(times - 0.5, 0, 1)
    commands = {"joint01_command": 0.6 * ramp, "joint02_command": -0.4 * ramp}
    seen = [f"link{link:02d}_{axis}" for link in (links // 2, links) for axis in "yz"]
    about = {"arm": {"links": links}, "noise": {"position_m": 0.01}}

    def recorded(rows: dict[str, np.ndarray]) -> Run:
        return Run.from_arrays(times, {**commands, **rows}, definition=about)

    plan = recorded(dict.fromkeys(seen, np.zeros_like(times)))
    random = np.random.default_rng(5)
    noise = {name: 0.01 * random.normal(size=len(times)) for name in seen}
    moved = predict(model_for([plan]), plan)
    other = {name: name[:-1] + {"y": "z", "z": "y"}[name[-1]] for name in seen}
    data = {
        "y and z swapped": {name: moved[other[name]] + noise[name] for name in seen},
        "a random walk": {name: np.cumsum(5 * noise[name]) for name in seen},
        "a constant": {name: noise[name] for name in seen},
    }
    ends = {}
    for what, rows in data.items():
        result, taken = _timed([recorded(rows)])
        ends[what] = {**_end(result, taken), "verdict": result.verdict.status}
        print(f"{what:20} {_shown(ends[what])}; {result.headline}", flush=True)
    return ends


def _timed(runs: Sequence[Run], **options: Any) -> tuple[FitResult, float]:
    began = time.perf_counter()
    result = fit(model_for(runs), runs, check=False, **options)
    return result, time.perf_counter() - began


def _end(result: FitResult, seconds: float) -> dict[str, Any]:
    return {
        "status": result.status,
        "reason": result.reason,
        "iterations": result.iterations,
        "seconds": seconds,
    }


def _shown(end: dict[str, Any]) -> str:
    return f"{end['reason']:11} {end['iterations']:3} iterations {end['seconds']:6.1f} s"


def main() -> int:
    """Measure, print and store; return exit status 1 if a limit is exceeded."""
    jax.config.update("jax_enable_x64", True)
    options = command_line(__doc__, RESULTS / "hard.json")
    corners = list(itertools.product((1, -1), repeat=len(PENDULUM)))
    if options.quick:
        wrong = impossible(links=3, seconds=4.0)
        swings = from_every_side(6.0, corners[2:3], ["linear"], 4)
    else:
        wrong = impossible(links=12, seconds=25.0)
        swings = from_every_side(120.0, corners, ["linear", "huber"])
    store({"pendulum": swings, "impossible": wrong}, options.out)
    rows = [row for each in swings.values() for row in each]
    good = sum(row["optimum"] and row["iterations"] <= MOST_ITERATIONS for row in rows)
    most = max(row["iterations"] for row in rows)
    print(
        f"{good} of {len(rows)} fits of the pendulum are at the optimum within {MOST_ITERATIONS} "
        f"iterations; the longest took {most}"
    )
    slowest = max(each["seconds"] for each in wrong.values())
    print(f"data that no arm can make: at most {slowest:.0f} s, of {MOST_SECONDS:.0f} allowed")
    return int(good < len(rows) or slowest > MOST_SECONDS)


if __name__ == "__main__":
    sys.exit(main())
