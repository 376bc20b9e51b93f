"""A state of a fit as plain data, from which the fit goes on bit for bit.

Residual and Jacobian are not among them: the same compiled program computes them anew at the same
point. Python's JSON gives every float back as it was.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._records import Iteration
from ._solver_state import MarquardtState
from ._state import FitState
from ._transitions import at_tolerance, move, reweight, step, tolerance_of

# The numbers of the solver that its next step depends on, apart from what is evaluated anew.
_SOLVER = ("damping", "growth", "scale", "step", "accepted", "detour", "sound", "evaluations")


class FitJournal(Protocol):
    """Where a fit writes what it has reached, and finds what it reached before.

    Attributes:
        kept: the lines of this fit so far, oldest first.
    """

    @property
    def kept(self) -> Sequence[Mapping[str, Any]]: ...

    def append(self, line: Mapping[str, Any]) -> None:
        """Keep one more line; it must not fail, because a fit does not end for that."""

    def other_bits(self) -> None:
        """Called where a kept point has another cost now: the end may differ in its last digits."""


def restored(begun: FitState, journal: FitJournal) -> tuple[FitState, float]:
    """The last state that a journal holds, evaluated anew.

    Arguments:
        begun: the state before anything is evaluated, of the same setup.
        journal: of the fit; may hold nothing yet.

    Returns:
        The state, and the seconds that the fit had taken up to it.

    Raises:
        ValueError, LookupError, TypeError: a line is not of this fit.
    """
    if not journal.kept:
        return begun, 0.0
    last = journal.kept[-1]
    noise = begun.noise.with_plain(last["noise"])
    coordinate = np.asarray(last["coordinate"], dtype=float)
    active = np.asarray(last["active"], dtype=bool)
    if coordinate.shape != begun.coordinate.shape or active.shape != coordinate.shape:
        raise ValueError("another number of free coordinates")
    there = dataclasses.replace(
        move(at_tolerance(reweight(begun, noise), last.get("tolerance")), coordinate),
        active=jnp.asarray(active),
    )
    there = step(there)
    if there.cost != float(last["cost"]):
        journal.other_bits()
    ending = last["ending"]
    state = dataclasses.replace(
        there,
        inner=_with_solver(there.inner, last["solver"]),
        done=bool(last["done"]),
        converged=bool(last["converged"]),
        trials=int(last["trials"]),
        rounds_left=int(last["rounds_left"]),
        round_began=int(last["round_began"]),
        history=tuple(Iteration(**item) for line in journal.kept for item in line["history"]),
        step_seconds=tuple(float(item) for line in journal.kept for item in line["step_seconds"]),
        ending=None if ending is None else (ending[0], str(ending[1]), ending[2]),
    )
    return state, float(last["seconds"])


def keeper(state: FitState, journal: FitJournal, elapsed: Callable[[], float]) -> Callable:
    """A function that writes each state that a fit reaches into its journal.

    Arguments:
        state: where the fit begins or goes on, which the journal holds already.
        journal: of the fit.
        elapsed: seconds that the fit has taken so far.
    """
    shown, stepped = len(state.history), len(state.step_seconds)

    def keep(reached: FitState) -> None:
        nonlocal shown, stepped
        inner = reached.inner
        line = {
            "trials": reached.trials,
            "cost": reached.cost,
            "coordinate": _plain(reached.coordinate),
            "active": _plain(reached.active),
            "solver": {name: _plain(getattr(inner, name)) for name in _SOLVER},
            "done": reached.done,
            "converged": reached.converged,
            "rounds_left": reached.rounds_left,
            "round_began": reached.round_began,
            "noise": reached.noise.to_plain(),
            "tolerance": tolerance_of(reached),
            "history": [dataclasses.asdict(item) for item in reached.history[shown:]],
            "step_seconds": list(reached.step_seconds[stepped:]),
            "seconds": elapsed(),
            "ending": reached.ending,
        }
        shown, stepped = len(reached.history), len(reached.step_seconds)
        journal.append(line)

    return keep


def _plain(value: Any) -> Any:
    return np.asarray(value).tolist()


def _with_solver(inner: MarquardtState, stored: Mapping[str, Any]) -> MarquardtState:
    """The solver's state with its stored numbers, in the types that the program is compiled for."""
    values = []
    for name in _SOLVER:
        before = getattr(inner, name)
        value = jnp.asarray(stored[name], dtype=before.dtype)
        if value.shape != before.shape:
            raise ValueError(f"{name} has another shape")
        values.append(value)
    return eqx.tree_at(lambda inner: [getattr(inner, name) for name in _SOLVER], inner, values)
