"""Time of fits with several runs, of several starts and of batches on two cores and on one.

22 simulated recordings of the same motion with different noise are fitted together. This is done
for short recordings and for recordings that take seven times as long. One recording is fitted from
8 initial guesses, and a batch of arms with different drag, stiffness and damping is simulated. Each
task runs on one core and on two, in turns. The fit of the long runs must be at least 1.6 times
faster on two cores. The short runs have no limit, because one second of their time is not spent on
evaluations. The results must agree to 1e-6 standard errors, or metres.

    python -m benchmarks.cores [--quick] [--out FILE]
"""

import gc
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import giajax.schema.parameters
from benchmarks.measuring import RESULTS, ROOT, command_line, store
from giajax import (
    FitResult,
    FitTask,
    Run,
    fit,
    map_on_cores,
    model_for,
    multi_start,
    predict,
    read_run,
)
from giajax.mechanics.arm import Arm
from giajax.simulation import Signal, simulate
from peers.arms import driven_arm

SHORT, LONG = "base_step", "pitch_yaw"
PARAMETERS = ("air.drag_coefficient", "joints.pitch_stiffness", "joints.damping")
LEAST, SAME = 1.6, 1e-6


def recordings(name: str, count: int) -> list[Run]:
    """Simulate recordings of one motion that differ in their noise."""
    first = read_run(ROOT / "data" / "synthetic" / f"{name}.csv")
    motion = predict(model_for([first]), first)
    random = np.random.default_rng(0)
    return [
        Run.from_arrays(
            first.times,
            {name: first.values[name] for name in first.commands}
            | {
                name: motion[name] + 0.02 * random.normal(size=len(motion[name]))
                for name in first.observations
            },
            name=f"run{number}",
            definition=first.definition,
        )
        for number in range(count)
    ]


def tip(values: Any, arm: Arm, command: Signal, times: Any) -> Any:
    """Return the path of the tip of an arm with other values of `PARAMETERS`."""
    changed = giajax.schema.parameters.replace(arm, dict(zip(PARAMETERS, values, strict=True)))
    options: dict[str, Any] = {"solver": "springs5", "rtol": 1e-5, "atol": 1e-5, "throw": False}
    return simulate(changed, command, times, **options).tip


def on_cores(count: int, call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the time of a call on the given number of cores, s, and its result.

    The garbage collector is switched off, as in `timeit`, because it takes a fifth of a second at
    random times.
    """
    os.environ["GIAJAX_CORES"] = str(count)
    gc.collect()
    gc.disable()
    began = time.perf_counter()
    try:
        result = call()
        return time.perf_counter() - began, result
    finally:
        gc.enable()


def compared(call: Callable[[], Any], repeats: int) -> tuple[dict[str, float], list[Any]]:
    """Return the least times on one and two cores, their ratio, and both results."""
    results = [on_cores(count, call)[1] for count in (1, 2)]
    times = [[on_cores(count, call)[0] for count in (1, 2)] for _ in range(repeats)]
    one, two = np.min(times, axis=0)
    return {"one core, s": one, "two cores, s": two, "ratio": one / two}, results


def farthest(one: FitResult, two: FitResult) -> float:
    """Return the largest difference of two estimates, in units of the standard error."""
    distances = []
    for path, estimate in one.free.items():
        apart = abs(estimate.value - two.free[path].value)
        # A parameter without effect has no standard error and stays at its initial guess.
        distances.append(apart / estimate.standard_error if estimate.standard_error else apart)
    # NumPy's maximum keeps a NaN, which then exceeds the limit.
    return float(np.max(distances))


def measure(quick: bool) -> dict[str, Any]:
    """Return the figures of each task by name."""
    count, repeats = (2, 1) if quick else (22, 3)
    runs = {each: recordings(each, count) for each in ((SHORT,) if quick else (SHORT, LONG))}
    models = {motion: model_for(each) for motion, each in runs.items()}
    options: dict[str, Any] = {}
    if quick:
        options = {"max_iterations": 1, "check": False, "noise_model": "white"}

    def asked(name: str) -> dict[str, Any]:
        settings = FitTask.load(ROOT / "fits" / f"{name}.toml").definition.fit
        return {"free": settings.free, "start": settings.start, **options}

    def fitted(name: str) -> FitResult:
        return fit(models[name], runs[name], **asked(name))

    def from_starts() -> FitResult:
        return multi_start(models[SHORT], runs[SHORT][0], starts=8, **asked(SHORT))

    found: dict[str, Any] = {}
    for name, call, times in (
        ("short runs", lambda: fitted(SHORT), repeats),
        ("runs", lambda: fitted(LONG), 2),
        ("starts", from_starts, repeats),
    ):
        found[name], (one, two) = compared(call, times)
        found[name]["standard errors apart"] = farthest(one, two)
        if quick:
            return found
    arm, command = driven_arm(20)
    samples = jnp.linspace(0.0, 25.0, 251)
    random = np.random.default_rng(0)
    values = np.array([1.2, 3.0, 0.05]) * random.uniform(0.7, 1.3, (256, 3))
    found["batch"], (one, two) = compared(
        lambda: map_on_cores(tip, values, arm, command, samples), repeats
    )
    found["batch"]["metres apart"] = float(np.abs(one - two).max())
    return found


def main() -> int:
    """Measure, print and store; return exit status 1 if a limit is exceeded."""
    jax.config.update("jax_enable_x64", True)
    options = command_line(__doc__, RESULTS / "cores.json")
    found = measure(options.quick)
    store(found, options.out)
    for name, figures in found.items():
        print(f"{name:10}", "  ".join(f"{key} {value:.3g}" for key, value in figures.items()))
    apart = max(
        each.get("standard errors apart", each.get("metres apart", 0.0)) for each in found.values()
    )
    return int(not apart <= SAME or (not options.quick and found["runs"]["ratio"] < LEAST))


if __name__ == "__main__":
    sys.exit(main())
