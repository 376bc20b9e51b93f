"""The whole run at one accuracy, and its derivatives with respect to four parameters."""

import time
from typing import Any

import jax
import numpy as np

from benchmarks.bench._contenders import MINE, Contender, contenders
from benchmarks.bench._problem import Problem
from benchmarks.measuring import in_turns

# A contender that is slower than the quickest by this factor is measured once.
SLOW = 20


def run_and_gradient(problem: Problem, repeats: int, quick: bool) -> dict[str, Any]:
    """Measure settings, errors and seconds of each contender, and giajax's compilation time."""
    everyone = contenders(problem, quick)
    compile_seconds = _compilation(everyone[MINE])
    chosen: dict[str, dict[str, Any]] = {}
    settings: dict[str, float] = {}
    for name, each in everyone.items():
        settings[name], error = problem.coarsest(each.tip, each.settings)
        chosen[name] = {"setting": each.named(settings[name]), "error": error}

    def run(name: str) -> Any:
        return lambda: jax.block_until_ready(everyone[name].tip(settings[name]))

    def gradient(name: str) -> Any:
        jacobian = everyone[name].jacobian
        assert jacobian is not None
        return lambda: jax.block_until_ready(jacobian(settings[name]))

    seconds = _measured({name: run(name) for name in everyone}, repeats)
    best_of_scipy = min(
        (name for name in everyone if "scipy" in name), key=lambda name: seconds[name]["min"]
    )
    with_jacobian = [
        name
        for name, each in everyone.items()
        if each.jacobian is not None and ("scipy" not in name or name == best_of_scipy)
    ]
    columns = _measured({name: gradient(name) for name in with_jacobian}, repeats)
    tight = everyone[MINE].jacobian
    assert tight is not None
    exact = np.asarray(tight(1e-9))
    for name in with_jacobian:
        # Scale each column to a parameter that doubles, which gives metres at the tip.
        off = (np.asarray(gradient(name)()) - exact) * problem.values
        columns[name]["error"] = float(np.abs(off).max())
    return {
        "chosen": chosen,
        "run": seconds,
        "gradient": columns,
        "compile": compile_seconds,
        "absent": problem.absent,
    }


def _compilation(mine: Contender) -> dict[str, float]:
    seconds = {}
    for name, call in (("run", mine.tip), ("gradient", mine.jacobian)):
        assert call is not None
        began = time.perf_counter()
        jax.block_until_ready(call(1e-6))
        seconds[name] = time.perf_counter() - began
    return seconds


def _measured(calls: dict[str, Any], repeats: int) -> dict[str, dict[str, float]]:
    """Measure the seconds of each call, the quick ones several times in turns."""
    once = in_turns(calls, 1)
    quickest = min(each["min"] for each in once.values())
    quick = {name: call for name, call in calls.items() if once[name]["min"] < SLOW * quickest}
    return once | in_turns(quick, repeats)
