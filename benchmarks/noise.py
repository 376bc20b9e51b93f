"""What it costs a fit to look for correlated noise: at most 1.3 times a fit with white noise.

Both fit the same files from the same starts, in turns and in one process, so that nothing is
compiled any more; the least processor time of each counts. Where the noise is correlated, a fit
takes steps again with the new weights, and white noise does not. What is less than a quarter of
a second more is shown and not counted.

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
# What nobody notices, s: a fit of a few hundred cells takes a tenth of a second.
UNNOTICED = 0.25


def taken(name: str, repeats: int) -> dict[str, Any]:
    """Processor time of a fit of both kinds, s, and how many steps each takes."""
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
    """Measure, print, store, and say by the exit status whether it is cheap enough."""
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
