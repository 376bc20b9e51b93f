"""Time of a fit that estimates correlated noise, relative to a fit with white noise; limit 1.3.

Both fits use the same files and initial guesses, and take turns in one process, so nothing is
compiled during the measured calls. The least processor times are compared. If the noise is
correlated, the fit takes further steps with the new weights. Differences of less than a quarter of
a second are shown but ignored.

    python -m benchmarks.noise [--quick] [--out FILE]
"""

import sys
import time
from typing import Any

import jax

from benchmarks.measuring import RESULTS, command_line, store
from giajax import FitTask

MOST = 1.3
DEFINITIONS = (
    "joint_loops", "muscle", "base_step", "independent_base_step", "full_air", "pitch_yaw"
)  # fmt: skip
# Differences below this are ignored, s: a fit of a few hundred cells takes a tenth of a second.
UNNOTICED = 0.25


def taken(name: str, repeats: int) -> dict[str, Any]:
    """Measure the processor time, s, and the number of steps of a fit with each noise model."""
    ready = {
        model: FitTask.load(f"fits/{name}.toml").on_top(noise_model=model).prepare()
        for model in ("white", "correlated")
    }
    seconds: dict[str, list[float]] = {model: [] for model in ready}
    steps = {}
    for repeat in range(repeats + 1):
        for model, each in ready.items():
            began = time.process_time()
            steps[model] = each.run().iterations
            if repeat:
                seconds[model].append(time.process_time() - began)
    least = {model: min(each) for model, each in seconds.items()}
    ratio = least["correlated"] / least["white"]
    return {"seconds": least, "iterations": steps, "ratio": ratio}


def main() -> int:
    """Measure, print and store; return exit status 1 if the ratio exceeds the limit."""
    jax.config.update("jax_enable_x64", True)
    options = command_line(__doc__, RESULTS / "noise.json")
    names, repeats = (DEFINITIONS[:1], 1) if options.quick else (DEFINITIONS, 5)
    figures = {}
    for name in names:
        figures[name] = each = taken(name, repeats)
        print(
            f"{name:16} white {each['seconds']['white']:6.3f} s, {each['iterations']['white']} "
            f"steps; correlated {each['seconds']['correlated']:6.3f} s, "
            f"{each['iterations']['correlated']} steps; ratio {each['ratio']:.2f}"
        )
    store(figures, options.out)
    noticed = [
        each["ratio"]
        for each in figures.values()
        if each["seconds"]["correlated"] - each["seconds"]["white"] > UNNOTICED
    ]
    worst = max(noticed, default=1.0)
    print(f"largest ratio of those that take {UNNOTICED} s more: {worst:.2f}, at most {MOST}")
    return int(worst > MOST)


if __name__ == "__main__":
    sys.exit(main())
