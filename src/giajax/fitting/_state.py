"""Where a fit stands between two steps of its loop, as frozen data."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, Self

import numpy as np

from ..recordings import Run
from ..runtime.arrays import Array
from ._configuration import Setup
from ._coordinates import names_of
from ._linearise import BlockJacobian
from ._problem import Problem
from ._records import Iteration, Status
from ._solver import Marquardt, MarquardtState, residual_scale
from ._weights import Noise

# Names of the free coordinates of a fit.


def coordinate_paths(problem: Problem) -> list[str]:
    """Path of the parameter at each position of the free coordinate."""
    names = [""] * problem.size
    for path, places in zip(problem.paths, problem.positions, strict=True):
        for place in places:
            names[place] = path
    for batch in problem.batches:
        for columns in batch.own_columns():
            for label, column in zip(batch.own_labels(), columns.tolist(), strict=True):
                names[column] = label
    return names


def labels(problem: Problem, runs: Sequence[Run]) -> list[str]:
    """Names of all free coordinates, each with the runs that it belongs to, if that is not all."""
    sharing: dict[int, list[int]] = {}
    for batch in problem.batches:
        for member, columns in zip(batch.members, batch.columns(), strict=True):
            for column in columns.tolist():
                sharing.setdefault(column, []).append(member)
    common = {places[0] for places in problem.positions if len(places) == 1}
    return [
        path if index in common else f"{path} of {names_of([runs[i] for i in sorted(who)])}"
        for index, path in enumerate(coordinate_paths(problem))
        for who in [sharing[index]]
    ]


# The word for what ended a fit; its sentence is the message.

Reason = Literal[
    "optimum",
    "iterations",
    "budget",
    "rough",
    "wall",
    "crawl",
    "cannot_fit",
    "no_response",
    "interrupted",
    "",
]
"""As `FitResult.reason` has it; empty in a file of an earlier version."""


# How often the noise is estimated anew, unless it settles before.
_NOISE_ROUNDS = 3


@dataclasses.dataclass(frozen=True)
class FitState:
    """One fit between two steps of its loop.

    Attributes:
        setup: what is fitted to what.
        problem: what is minimised, with the noise in use.
        noise: the noise in use, and where it comes from.
        start: start values of the free parameters, those of single runs last, shape (parameter,).
        sizes: their typical sizes, for judging whether anything responds to them.
        solver: of the least-squares problem.
        coordinate: the best point so far, shape (parameter,).
        inner: the solver's own state there.
        active: parameters that may move, shape (parameter,).
        finer: what a finer tolerance of the integrator changes of the residuals there; None where
            nobody has asked.
        done: whether the solver wants no further step.
        converged: whether it stopped at an optimum.
        trials: steps that were tried.
        rounds_left: how often the noise may still be estimated anew.
        round_began: how long the history was when noise or tolerance last changed.
        history: the start and each trial.
        step_seconds: wall time of each evaluation; the first one compiles.
        ending: how the fit ended, one sentence about it, and the word of `FitResult.reason`; None
            while it goes on.
    """

    setup: Setup
    problem: Problem
    noise: Noise
    start: np.ndarray
    sizes: np.ndarray
    solver: Marquardt
    coordinate: Array
    inner: MarquardtState
    active: Array
    finer: np.ndarray | None = None
    done: bool = False
    converged: bool = False
    trials: int = 0
    rounds_left: int = _NOISE_ROUNDS
    round_began: int = 0
    history: tuple[Iteration, ...] = ()
    step_seconds: tuple[float, ...] = ()
    ending: tuple[Status, str, Reason] | None = None

    @property
    def cost(self) -> float:
        """Half the sum of the loss; infinite where nothing was evaluated."""
        return float(self.inner.cost)

    @property
    def evaluated(self) -> bool:
        """Whether the model was evaluated at the present point."""
        return bool(np.isfinite(self.cost))

    def values(self) -> np.ndarray:
        """Values of all free parameters at the best point, shape (parameter,)."""
        values = self.problem.bijector.forward(np.asarray(self.coordinate, dtype=float))
        # What is held keeps its start exactly, not as it comes back from its coordinate.
        return np.where(np.asarray(self.active), values, self.start)

    def parameters(self) -> dict[str, float]:
        """Values of the model's free parameters at the best point, by path.

        Of what has a value for each group of runs, the mean.
        """
        values, problem = self.values(), self.problem
        return {
            path: float(np.mean(values[list(places)]))
            for path, places in zip(problem.paths, problem.positions, strict=True)
        }

    def jacobian(self, inner: MarquardtState | None = None) -> BlockJacobian:
        """Weighted residuals by the free coordinates; those that are held count as zero."""
        inner = self.inner if inner is None else inner
        whole = BlockJacobian.of(self.problem, inner.jacobian)
        return whole.scaled(np.asarray(self.active, dtype=float))

    def natural_jacobian(self) -> BlockJacobian:
        """Weighted residuals by the parameters themselves."""
        slope = self.problem.bijector.slope(np.asarray(self.coordinate))
        return self.jacobian().scaled(1 / np.maximum(slope, 1e-300))

    def predicted_decrease(self) -> float:
        """By how much the linear model would lower the cost with its best step within the bounds.

        A fit has converged where that is little, and this is how little it is.
        """
        names = ("residual", "factor", "projected", "cost", "scale")
        parts: dict[str, Any] = {name: np.asarray(getattr(self.inner, name)) for name in names}
        inner = dataclasses.replace(self.inner, **parts)
        lower, upper = (np.asarray(each) for each in self.problem.bijector.ends())
        options, coordinate = {"lower": lower, "upper": upper}, np.asarray(self.coordinate)
        return float(self.solver.explainable_norm(coordinate, options, inner, maths=np)) ** 2 / 2

    def residual_scale(self) -> float:
        """The size of the residuals in units of their noise: the root of the reduced chi-square."""
        # By numpy: each operation of JAX here would be a program of its own.
        cost: Any = np.asarray(self.inner.cost)
        return float(residual_scale(dataclasses.replace(self.inner, cost=cost)))

    def recorded(self, *, accepted: bool) -> Self:
        """With the present point as the last entry of the history."""
        iteration = Iteration(
            number=self.trials,
            cost=self.cost,
            step=float(np.max(np.abs(np.asarray(self.inner.step)), initial=0.0)),
            accepted=accepted,
            parameters=self.parameters(),
        )
        return dataclasses.replace(self, history=(*self.history, iteration))

    def next_round(self) -> Self:
        """With one estimation of the noise less."""
        return dataclasses.replace(
            self,
            rounds_left=self.rounds_left - 1,
            round_began=len(self.history),
            done=False,
            converged=False,
        )

    def ended(self, status: Status, message: str, reason: Reason) -> Self:
        """The end of the fit."""
        return dataclasses.replace(self, ending=(status, message, reason))
