"""The contenders: path of the tip and its derivatives, for a given tolerance or step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import giajax.schema.parameters
from benchmarks.bench._problem import STEPS, TOLERANCES, Problem
from giajax.runtime.programs import program
from giajax.simulation import simulate
from peers.mujoco_chain import MujocoChain
from peers.plain_arm import PARAMETERS
from peers.scipy_chain import ScipyChain

MINE = "giajax springs5"


@dataclass(frozen=True)
class Contender:
    """A method that computes the path of the tip.

    Arguments:
        tip: returns the path, shape (sample, 3), for a setting.
        settings: tolerances, or steps in s, from coarse to fine.
        jacobian: returns the derivatives with respect to the parameters, shape
            (sample, 3, parameter), and computes the path, too; None for methods that are
            not differentiated.
        steps: whether the settings are steps.
    """

    tip: Callable[[float], Any]
    settings: Sequence[float]
    jacobian: Callable[[float], Any] | None = None
    steps: bool = False

    def named(self, setting: float) -> str:
        """Return the setting in words."""
        return f"step {setting * 1e3:.1f} ms" if self.steps else f"tolerance {setting:.1e}"


@program
def giajax_tip(values: Any, problem: Any, tolerance: Any, solver: str) -> Any:
    arm, command, times = problem
    arm = giajax.schema.parameters.replace(arm, dict(zip(PARAMETERS, values, strict=True)))
    options: dict[str, Any] = {"rtol": tolerance, "atol": tolerance, "throw": False}
    return simulate(arm, command, times, solver=solver, **options).tip


@program
def giajax_tip_and_jacobian(values: Any, problem: Any, tolerance: Any, solver: str) -> Any:
    def push(direction: Any) -> Any:
        return jax.jvp(lambda x: giajax_tip(x, problem, tolerance, solver), (values,), (direction,))

    return jax.vmap(push, out_axes=(None, -1))(jnp.eye(len(values)))


def contenders(problem: Problem, quick: bool) -> dict[str, Contender]:
    """Return the contenders that this machine has, by name; `quick` omits some slow ones."""
    solvers = ("springs5",) if quick else ("springs5", "tsit5")
    methods = ("RK45",) if quick else ("RK45", "DOP853", "LSODA")
    return {
        **{f"giajax {solver}": _giajax(problem, solver) for solver in solvers},
        **_casadi(problem),
        **_mujoco(problem),
        **{f"scipy {method}": _scipy(problem, method) for method in methods},
    }


def _giajax(problem: Problem, solver: str) -> Contender:
    values = jnp.asarray(problem.values)
    inputs = (problem.arm, problem.command, jnp.asarray(problem.times))

    def tip(tolerance: float) -> Any:
        return giajax_tip(values, inputs, jnp.asarray(tolerance), solver)

    def jacobian(tolerance: float) -> Any:
        return giajax_tip_and_jacobian(values, inputs, jnp.asarray(tolerance), solver)[1]

    return Contender(tip, TOLERANCES, jacobian)


def _mujoco(problem: Problem) -> dict[str, Contender]:
    """Return MuJoCo's RK4 with drag in C, and with drag in Python for users without a compiler."""

    def slow_tip(step: float) -> np.ndarray:
        states = MujocoChain(problem.arm, problem.command).trajectory(problem.times, step)
        return problem.numpy.tip(states[:, 0])

    engine = problem.mujoco
    if engine is None:
        return {"MuJoCo, drag in Python": Contender(slow_tip, STEPS, steps=True)}

    def tip(step: float, values: Any = problem.values) -> np.ndarray:
        engine.set_parameters(dict(zip(PARAMETERS, values, strict=True)))
        return engine.ends(problem.times, step)[:, -1]

    def jacobian(step: float) -> np.ndarray:
        # With fixed steps, the result is a smooth function, so small one-sided differences suffice.
        return differences(lambda x: tip(step, x), problem.values, 1e-6, tip(step))

    # Both take the same steps, so a step that is too coarse for one is too coarse for the other.
    fine = [step for step in STEPS if step <= problem.coarsest(tip, STEPS)[0]]
    return {
        "MuJoCo, drag in C": Contender(tip, fine, jacobian, steps=True),
        "MuJoCo, drag in Python": Contender(slow_tip, fine, steps=True),
    }


def _casadi(problem: Problem) -> dict[str, Contender]:
    """Return the generated C code with each method, with derivatives in CasADi's forward mode."""
    code = problem.casadi
    if code is None:
        return {}
    from peers.casadi_c import TABLEAUX

    def contender(method: str) -> Contender:
        return Contender(
            lambda step: code.ends(problem.times, step, method)[:, -1],
            STEPS,
            lambda step: code.ends_and_jacobian(problem.times, step, method)[1][:, -1],
            steps=True,
        )

    return {f"CasADi in C, {method}": contender(method) for method in TABLEAUX}


def _scipy(problem: Problem, method: str) -> Contender:
    def tip(tolerance: float, values: Any = problem.values) -> np.ndarray:
        chain = ScipyChain(problem.with_parameters(values), problem.command)
        options: dict[str, Any] = {"method": method, "rtol": tolerance, "atol": tolerance}
        return problem.numpy.tip(chain.trajectory(problem.times, **options)[:, 0])

    def jacobian(tolerance: float) -> np.ndarray:
        # Smaller differences are dominated by changes in the steps that the solver takes.
        return differences(lambda x: tip(tolerance, x), problem.values, 1e-2)

    return Contender(tip, TOLERANCES[::4], jacobian)


def differences(
    tip: Callable[[Any], np.ndarray], values: Any, step: float, here: Any = None
) -> np.ndarray:
    """Return derivatives by relative differences: one-sided from `here` if given, else central."""
    columns = []
    for index, value in enumerate(values):
        forth, back = (np.array(values) for _ in range(2))
        forth[index] += step * value
        back[index] -= step * value
        if here is None:
            columns.append((tip(forth) - tip(back)) / (2 * step * value))
        else:
            columns.append((tip(forth) - here) / (step * value))
    return np.stack(columns, axis=-1)
