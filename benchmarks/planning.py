"""Optimisers for `giajax plan`: duration of the planned command, and time of the search.

The paper's arm in full air turns its base joint by 20 degrees. The package uses SLSQP from scipy,
with its early end and its repetitions. The alternatives are Levenberg-Marquardt from optimistix
with a quadratic penalty on the violations, whose weight increases (Nocedal and Wright, Numerical
Optimization, chapter 17), the trust-region interior point method from scipy and, if they are
installed (`pip install qpax slsqp-jax`), Gauss-Newton steps whose quadratic programmes are solved
by qpax, and slsqp-jax. Among the commands that respect all limits, the shortest is the best. A
short search is repeated, and the second time is reported, too. Both times of the JAX optimisers
include compilation.

    python -m benchmarks.planning [--quick] [--out FILE]
"""

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from rich.table import Table
from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize

from benchmarks.measuring import report
from giajax import ArmModel, takeichi_20m_full
from giajax.apps.planning import CommandLimits, PlanProblem, Pose, plan_command

STEPS, KNOTS = 150, 10
SHORT, LONG = 3, 20
SCALE = 0.02  # violation that is negligible
WEIGHTS = (1.0, 10.0, 100.0)
DAMPED = 1e-2  # largest damping at which a small gain ends the search
LONGEST_S = 60.0  # a first search that takes less is repeated

Found = tuple[np.ndarray, int]


def problem(links: int, rate: float) -> PlanProblem:
    pose = np.zeros(links)
    pose[0] = np.deg2rad(20.0)
    limits = CommandLimits(rate=np.deg2rad(rate))
    model = ArmModel(takeichi_20m_full(links))
    return plan_command(model, Pose(pose), limits=limits, knots=KNOTS, draw_count=0).problem


def by_slsqp(task: PlanProblem) -> Found:
    return task.solved(STEPS)


def by_interior_point(task: PlanProblem) -> Found:
    found: Any = minimize(
        lambda y: float(task.cost @ y),
        task.start,
        jac=lambda y: task.cost,
        hess=lambda y: np.zeros((len(y), len(y))),
        method="trust-constr",
        bounds=list(zip(task.low, task.high, strict=True)),
        constraints=[
            NonlinearConstraint(task.values, 0.0, np.inf, jac=task.slopes),
            LinearConstraint(task.linear, -task.offset, np.inf),
        ],
        options={"maxiter": STEPS},
    )
    return found.x, int(found.nit)


def _missing(task: PlanProblem, y: Any) -> Any:
    """Return the violation of each limit, divided by the negligible violation."""
    lines = jnp.asarray(task.linear) @ y + jnp.asarray(task.offset)
    low, high = jnp.asarray(task.low), jnp.asarray(task.high)
    every = jnp.concatenate([task.kept(y), lines, y - low, high - y])
    return jnp.minimum(every, 0.0) / SCALE


def by_levenberg_marquardt(task: PlanProblem) -> Found:
    solver: Any = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-4)
    cost = jnp.asarray(task.cost)

    def residuals(y: Any, weight: Any) -> Any:
        # The cost is positive, so its square root has the same minimiser.
        least = jnp.sqrt(2 * jnp.maximum(cost @ y, 1e-6))
        return jnp.concatenate([least[None], jnp.sqrt(weight) * _missing(task, y)])

    @jax.jit
    def searched(y: Any, weight: Any) -> Any:
        found: Any = optx.least_squares(
            residuals, solver, y, weight, max_steps=STEPS // len(WEIGHTS), throw=False,
            options={"jac": "fwd"},
        )  # fmt: skip
        return found.value, found.stats["num_steps"]

    y, steps = jnp.asarray(task.start), 0
    for weight in WEIGHTS:
        y, count = searched(y, jnp.asarray(weight))
        steps += int(count)
    return np.asarray(y), steps


def by_qpax(task: PlanProblem) -> Found:
    """Linearise the cost and the constraints, with a damping that follows the merit function."""
    import qpax  # type: ignore[import-not-found,unused-ignore]

    y, damping, hard, steps = task.start, 1e-2, 10.0, 0
    size = len(y)
    bounded = np.flatnonzero(np.isfinite(task.low)), np.flatnonzero(np.isfinite(task.high))
    unit = np.eye(size)

    def merit(y: np.ndarray) -> float:
        return float(task.cost @ y + hard * np.max(-np.minimum(task.values(y), 0.0)))

    solve = jax.jit(lambda *parts: qpax.solve_qp(*parts, solver_tol=1e-6, max_iter=60)[0])
    none = jnp.zeros((0, size)), jnp.zeros(0)
    while steps < STEPS:
        steps += 1
        lines = [task.slopes(y), task.linear, unit[bounded[0]], -unit[bounded[1]]]
        left = [
            task.values(y),
            task.linear @ y + task.offset,
            y[bounded[0]] - task.low[bounded[0]],
            task.high[bounded[1]] - y[bounded[1]],
        ]
        step = np.asarray(
            solve(
                jnp.asarray(damping * unit), jnp.asarray(task.cost), *none,
                jnp.asarray(-np.concatenate(lines)), jnp.asarray(np.concatenate(left)),
            )
        )  # fmt: skip
        gained = merit(y) - merit(y + step) if np.all(np.isfinite(step)) else -np.inf
        if gained > 0:
            y = y + step
            if gained < 3e-4 * abs(merit(y)) and damping <= DAMPED:
                break
            damping = max(damping / 3, 1e-6)
        else:
            damping *= 5
            if damping > 1e6:
                break
    return y, steps


def by_slsqp_jax(task: PlanProblem) -> Found:
    import slsqp_jax  # type: ignore[import-not-found,unused-ignore]

    cost, linear, offset = map(jnp.asarray, (task.cost, task.linear, task.offset))
    found = slsqp_jax.minimize_like_scipy(
        lambda y: cost @ y,
        jnp.asarray(task.start),
        bounds=list(zip(task.low, task.high, strict=True)),
        constraints=[
            {"type": "ineq", "fun": task.kept, "jac": jax.jacfwd(task.kept)},
            {"type": "ineq", "fun": lambda y: linear @ y + offset, "jac": lambda y: linear},
        ],
        options={"maxiter": STEPS, "rtol": 1e-4, "atol": 1e-4},
    )
    return np.asarray(found.value), int(found.stats["num_steps"])


OPTIMISERS: dict[str, tuple[Callable[[PlanProblem], Found], str | None]] = {
    "SLSQP, scipy": (by_slsqp, None),
    "interior point, scipy": (by_interior_point, None),
    "Levenberg-Marquardt, optimistix": (by_levenberg_marquardt, None),
    "Gauss-Newton, qpax": (by_qpax, "qpax"),
    "slsqp-jax": (by_slsqp_jax, "slsqp_jax"),
}


def judged(task: PlanProblem, found: np.ndarray) -> dict[str, float]:
    """Return the duration of the command, and the largest violation of a limit."""
    y = np.concatenate([found[:-2], np.zeros(2)])
    worst = np.nanmin(
        [
            np.min(task.values(y)) if np.all(np.isfinite(y)) else -np.inf,
            np.min(task.linear @ y + task.offset),
            np.min(y - task.low),
            np.min(task.high - y),
        ]
    )
    return {"command_s": float(y[0] * task.task.period), "not_kept": float(max(-worst, 0.0))}


def measure(quick: bool) -> dict[str, Any]:
    task = problem(SHORT, 8.0) if quick else problem(LONG, 2.0)
    rows: dict[str, Any] = {}
    for name, (search, needed) in OPTIMISERS.items():
        if needed is not None and importlib.util.find_spec(needed) is None:
            continue
        times: list[float] = []
        while len(times) < 2 and sum(times) < LONGEST_S:
            begun = time.perf_counter()
            found, steps = search(task)
            times.append(time.perf_counter() - begun)
        rows[name] = {**judged(task, found), "steps": steps, "first_s": times[0], "s": times[-1]}
        print(f"{name}: {rows[name]}", flush=True)
    return {"links": SHORT if quick else LONG, "optimisers": rows}


def table(found: dict[str, Any]) -> Table:
    shown = Table("optimiser", "command, s", "not kept", "steps", "s", "s, first")
    for name in OPTIMISERS:
        each = found["optimisers"].get(name)
        if each is None:
            shown.add_row(name, "not installed")
            continue
        keys = ("command_s", "not_kept", "steps", "s", "first_s")
        shown.add_row(name, *(f"{each[key]:.3g}" for key in keys))
    return shown


if __name__ == "__main__":
    report(__doc__, "planning", measure, table)
