"""What a fit gains by choosing its tolerance: time of a step, and how far off the estimates are.

A definition is fitted as it is and, from where that ends, at a tolerance of 1e-10: no estimate may
differ by more than a hundredth of a standard error. The processor time of a step (value and
Jacobian) is shown over that of one with Tsit5 at 1e-7, as fits used to take; the two take turns.
With `--draws N`, so many recordings with other noise are fitted, too.

    python -m benchmarks.tolerance [--quick] [--draws N] [--out FILE]
"""

import sys
import time
from typing import Any

import jax
import numpy as np

from benchmarks.measuring import RESULTS, command_line, store
from giajax import FitResult, FitTask, Run, fit, model_for

DEFINITIONS = ("base_step", "pitch_yaw", "wind", "full_air")
MOST_OFF = 0.01
FORMER = {"solver": "tsit5", "tolerance": 1e-7}
REFERENCE = 1e-10


def fitted(run: Run, task: FitTask, **options: Any) -> tuple[FitResult, float]:
    """The fit of a recording, and the least processor time of a step, s."""
    times = [time.process_time()]
    settings = task.definition.fit
    result = fit(
        model_for([run]),
        run,
        free=settings.free,
        start=options.pop("start", settings.start),
        noise_model="white",
        check=False,
        progress=lambda _: times.append(time.process_time()),
        **options,
    )
    # Before the first one there is the choice.
    return result, float(np.min(np.diff(times[1:]), initial=np.inf))


def drawn(run: Run, truth: FitResult, seed: int) -> Run:
    """What a fitted model predicts for a recording, with other noise of the size that it has."""
    noise = np.random.default_rng(seed)
    predicted = truth.predict(run)
    deviations = {name: channel.rmse for name, channel in truth.runs[0].channels.items()}
    rows = {
        name: predicted[name]
        + _si(run, name, deviations[name]) * noise.normal(size=len(row))
        + 0 * row  # cells that were not measured stay empty
        for name, row in run.observations.items()
    }
    return Run.from_arrays(
        run.times, {**run.commands, **run.winds, **rows}, definition=run.definition
    )


def _si(run: Run, name: str, deviation: float | None) -> float:
    return (deviation or 0.0) / float(run.channels[name].from_si(1.0))


def off(result: FitResult, run: Run, task: FitTask) -> float:
    """The largest distance of an estimate from the reference, in standard errors."""
    ends = {path: each.value for path, each in result.free.items()}
    reference, _ = fitted(run, task, start=ends, tolerance=REFERENCE)
    known = [(path, each) for path, each in reference.free.items() if each.standard_error]
    return max(
        abs(result.parameters[path].value - each.value) / each.standard_error
        for path, each in known
    )


def _tolerance(result: FitResult) -> float:
    assert result.integration is not None
    return result.integration.tolerance


def figures(name: str, draws: int, repeats: int) -> dict[str, Any]:
    """All figures of a definition."""
    task = FitTask.load(f"fits/{name}.toml")
    (run,) = task.prepare().runs
    seconds: dict[str, list[float]] = {"chosen": [], "former": []}
    for _ in range(repeats):
        result, step = fitted(run, task)
        seconds["chosen"].append(step)
        seconds["former"].append(fitted(run, task, **FORMER)[1])
    distances = [off(result, run, task)]
    tolerances = [_tolerance(result)]
    for seed in range(draws):
        other = drawn(run, result, seed)
        again, _ = fitted(other, task)
        distances.append(off(again, other, task))
        tolerances.append(_tolerance(again))
    least = {key: min(each) for key, each in seconds.items()}
    return {
        "tolerances": tolerances,
        "off_in_standard_errors": distances,
        "seconds_of_a_step": least,
        "ratio": least["chosen"] / least["former"],
    }


def main() -> int:
    """Measure, print, store, and say by the exit status whether the limits are held."""
    jax.config.update("jax_enable_x64", True)
    options = command_line(__doc__, RESULTS / "tolerance.json", draws=0)
    names, repeats = (DEFINITIONS[:1], 1) if options.quick else (DEFINITIONS, 3)
    table = {}
    for name in names:
        table[name] = each = figures(name, options.draws, repeats)
        print(
            f"{name:10} tolerance {max(each['tolerances']):.0e} to {min(each['tolerances']):.0e}; "
            f"at most {max(each['off_in_standard_errors']):.4f} standard errors off; "
            f"a step {1e3 * each['seconds_of_a_step']['chosen']:.0f} ms, "
            f"{each['ratio']:.2f} of the former",
            flush=True,
        )
    store(table, options.out)
    farthest = max(max(each["off_in_standard_errors"]) for each in table.values())
    print(f"at most {farthest:.4f} standard errors off, of {MOST_OFF} that are allowed")
    return int(farthest > MOST_OFF)


if __name__ == "__main__":
    sys.exit(main())
