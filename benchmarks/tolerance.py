"""The automatic tolerance of a fit: time of a step, and error of the estimates.

Each definition is fitted, and fitted again with a tolerance of 1e-10 from the estimates of the
first fit. The estimates must not differ by more than 0.01 standard errors. The table shows the
processor time of a step (value and Jacobian) relative to Tsit5 at 1e-7, the former setting; the two
take turns. With `--draws N`, N further recordings with newly drawn noise are fitted, too. With
`--all`, every definition in `fits` whose model has a tolerance is fitted as it is, with its own
loss, noise and priors. Fits that do not converge are listed, and are errors.

    python -m benchmarks.tolerance [--quick] [--all] [--draws N] [--out FILE]
"""

import sys
import time
from collections.abc import Mapping
from pathlib import Path
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
    """Fit a recording; return the result and the least processor time of a step, s."""
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
    # The first interval is left out, because it includes the choice of the tolerance.
    return result, float(np.min(np.diff(times[1:]), initial=np.inf))


def drawn(run: Run, truth: FitResult, seed: int) -> Run:
    """Simulate a recording with a fitted model, with new noise of the same standard deviation."""
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
    """Return the largest error of an estimate, in units of the standard error.

    The reference is a fit with the tolerance `REFERENCE`.
    """
    ends = {path: each.value for path, each in result.free.items()}
    return _farthest(result, fitted(run, task, start=ends, tolerance=REFERENCE)[0])


def _farthest(result: FitResult, reference: FitResult) -> float:
    """Return the largest distance of an estimate from the reference, in standard errors."""
    pairs: list[tuple[Mapping[str, Any], Mapping[str, Any]]] = [(result.free, reference.free)]
    for mine, exact in zip(result.runs, reference.runs, strict=True):
        pairs.append((mine.parameters, exact.parameters))
    distances = [
        abs(found[path].value - each.value) / each.standard_error
        for found, exact in pairs
        for path, each in exact.items()
        if each.standard_error
    ]
    return max(distances, default=np.nan)


def _tolerance(result: FitResult) -> float:
    assert result.integration is not None
    return result.integration.tolerance


def figures(name: str, draws: int, repeats: int) -> dict[str, Any]:
    """Return all figures of a definition."""
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


def as_defined(path: Path) -> dict[str, Any] | None:
    """Return the tolerance and the error of a definition with all its settings.

    The dictionary has a `reason` instead if one of the fits does not converge. None if the model
    has no tolerance.
    """
    task = FitTask.load(path)
    ready = task.prepare()
    # The tolerance of these settings is also None if the fit is to choose it.
    if ready.setup.config["solver"] is None:
        return None
    result = ready.run(check=False)
    # Further initial guesses would only find the same optimum again.
    reference = task.on_top(begin=result, tolerance=REFERENCE, starts=1).run(check=False)
    for each in (result, reference):
        if each.status != "converged":
            return {"reason": each.message}
    return {
        "tolerances": [_tolerance(result)],
        "off_in_standard_errors": [_farthest(result, reference)],
    }


def main() -> int:
    """Measure, print and store; return 1 if a limit is exceeded or a fit does not converge."""
    jax.config.update("jax_enable_x64", True)
    options = command_line(
        __doc__,
        RESULTS / "tolerance.json",
        switches={"all": "also fit every definition in fits whose model has a tolerance"},
        draws=0,
    )
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
    for path in sorted(Path("fits").glob("*.toml")) if options.all else ():
        if (whole := as_defined(path)) is None:
            continue
        if (reason := whole.get("reason")) is None:
            said = f"{whole['off_in_standard_errors'][0]:.4f} standard errors off"
            said = f"tolerance {whole['tolerances'][0]:.0e}, {said}"
        else:
            said = f"not compared: {reason}"
        table[f"{path.stem}, as defined"] = whole
        print(f"{path.stem:20} as defined: {said}", flush=True)
        store(table, options.out)
    compared = [each for each in table.values() if "reason" not in each]
    farthest = float(np.max(np.concatenate([each["off_in_standard_errors"] for each in compared])))
    print(f"at most {farthest:.4f} standard errors off, of {MOST_OFF} that are allowed")
    if failed := len(table) - len(compared):
        print(f"{failed} of {len(table)} were not compared")
    # The condition is also false for a NaN.
    return int(not farthest <= MOST_OFF or failed > 0)


if __name__ == "__main__":
    sys.exit(main())
