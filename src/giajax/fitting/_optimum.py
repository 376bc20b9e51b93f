"""Evaluation and repetition of a fit at its optimum, with its problem, noise and programs.

Studies that require many fits of the same data (profiles, repetitions, omitted runs) begin at the
optimum and use the compiled programs of the fit. Held values, recorded values and initial values
are arguments of these programs, so nothing is compiled again.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..models import AbstractModel
from ..noise import Cells, ChannelNoise
from ..runtime.arrays import Bool, Float, on_device
from ..runtime.text import InputError
from ._configuration import Setup
from ._derived import derived_quantity
from ._fit import Refit, refitted
from ._linearise import BlockJacobian
from ._loop import with_active
from ._losses import AbstractLoss
from ._problem import Recorded, predictions_by_run, with_recorded
from ._records import RunFit, recorded_noise
from ._statistics import Statistics, statistics
from ._steps import FitState, begin, evaluate, labels, move, reweight, step
from ._uncertainty import (
    dense_cells,
    prior_rows,
    reestimate,
    residual_cells,
    responds,
    weighted_cells,
)
from ._weights import Noise

MOST_STEPS = 50


@dataclasses.dataclass(frozen=True)
class Point:
    """Problem evaluated at given values of its free parameters.

    Attributes:
        cost: half the sum of the losses of the residuals divided by the noise, infinite where the
            model fails.
        residual: residuals, whitened and transformed by the loss, with those of the priors last,
            shape (residual,).
        jacobian: Jacobian of the residual with respect to the parameters themselves.
        predictions: predictions for each run, by channel, SI units.
    """

    cost: float
    residual: np.ndarray
    jacobian: BlockJacobian
    predictions: list[dict[str, np.ndarray]]


@dataclasses.dataclass(frozen=True)
class Optimum:
    """Point where a fit ended, with the noise of the fit. `optimum` creates it.

    The free parameters are those of the model, with one value or one for each group of runs, and
    those of single runs, in the order of `labels`.

    Attributes:
        state: evaluated state at this point.
    """

    state: FitState

    @functools.cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of all free parameters. Those of single runs include the name of the run."""
        return tuple(labels(self.state.problem, self.state.setup.runs))

    @functools.cached_property
    def statistics(self) -> Statistics:
        """Standard errors and correlations at the optimum."""
        return statistics(self.state)

    @property
    def values(self) -> np.ndarray:
        """Values of all free parameters, SI units, shape (parameter,)."""
        return self.state.values()

    @property
    def cost(self) -> float:
        """Half the sum of the losses of the residuals, which are divided by the noise."""
        return self.state.cost

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of all free parameters, infinite if there is none."""
        bijector = self.state.problem.bijector
        return np.asarray(bijector.lower), np.asarray(bijector.upper)

    @property
    def predictions(self) -> list[dict[str, np.ndarray]]:
        """Predictions for each run, by channel, SI units."""
        state = self.state
        return predictions_by_run(state.problem, state.inner.aux, state.setup.runs)

    def position(self, label: str) -> int:
        """Return the position of a free parameter.

        Raises:
            InputError: no free parameter has this name.
        """
        if label not in self.labels:
            raise InputError(f"'{label}' was not free in this fit: use one of {self.labels}")
        return self.labels.index(label)

    def model(self, values: np.ndarray) -> AbstractModel:
        """Return the model at values of shape (parameter,). Values of one path are averaged."""
        problem = self.state.problem
        return problem.with_values(problem.means(np.asarray(values)[: problem.shared]))

    def derived(self, name: str) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
        """Return a derived quantity or a tied parameter by its name in `FitResult.derived`.

        It is returned as a function of the values of all free parameters, which gives its value and
        its gradient.

        Raises:
            InputError: no derived quantity has this name.
        """
        return derived_quantity(self.state.problem, self.values, name)

    def at(self, values: np.ndarray) -> Point:
        """Return cost, residual and Jacobian at values within the bounds, shape (parameter,)."""
        bijector = self.state.problem.bijector
        coordinate = bijector.inverse(np.clip(values, *self.bounds))
        inner = evaluate(self.state, coordinate)
        there = dataclasses.replace(
            self.state, coordinate=on_device(coordinate, self.state.coordinate.dtype), inner=inner
        )
        predictions = predictions_by_run(there.problem, inner.aux, there.setup.runs)
        residual = np.asarray(inner.residual)
        return Point(float(inner.cost), residual, there.natural_jacobian, predictions)

    def refit(
        self,
        *,
        held: Mapping[str, float] | None = None,
        start: np.ndarray | None = None,
        recorded: Recorded | None = None,
        centres: Float[np.ndarray, " prior"] | None = None,
        max_iterations: int = MOST_STEPS,
    ) -> Refit:
        """Fit again with the noise unchanged. The result contains the reason for its end.

        Arguments:
            held: values of held parameters, SI units, by label.
            start: initial values of all free parameters, SI units, shape (parameter,). The default
                is the optimum.
            recorded: recorded values that replace those of the runs.
            centres: centres that replace those of the priors. For a logarithmic prior, the
                logarithm.
            max_iterations: maximum number of trial steps.

        Raises:
            InputError: an unknown label in `held`, or a value outside its bounds.
        """
        state, (lower, upper) = self.state, self.bounds
        values = np.array(self.values if start is None else start, dtype=float)
        active = np.array(state.active)
        for label, value in (held or {}).items():
            place = self.position(label)
            if not lower[place] <= value <= upper[place]:
                raise InputError(
                    f"{label} cannot be fixed at {value:g}, which is outside its bounds"
                )
            values[place], active[place] = value, False
        values = np.clip(values, lower, upper)
        problem = state.problem
        if recorded is not None:
            batches = with_recorded(problem.batches, state.setup.runs, state.noise, recorded)
            problem = dataclasses.replace(problem, batches=batches)
        if centres is not None:
            known = on_device(centres, problem.priors.centre.dtype)
            priors = dataclasses.replace(problem.priors, centre=known)
            problem = dataclasses.replace(problem, priors=priors)
        begun = dataclasses.replace(
            state,
            problem=problem,
            start=values,
            active=on_device(active),
            done=False,
            converged=False,
            trials=0,
            round_began=0,
            history=(),
            step_seconds=(),
            ending=None,
        )
        return refitted(move(begun, problem.bijector.inverse(values)), max_iterations)


def optimum(setup: Setup, records: Sequence[RunFit]) -> Optimum:
    """Return the optimum of a fit, without fitting again.

    Arguments:
        setup: setup of the fit. Its model has the fitted values and the tolerance of the fit, and
            `own` has the values of single runs.
        records: records of its runs, with the noise of the fit.

    Raises:
        InputError: the model cannot be evaluated there.
    """
    begun = begin(dataclasses.replace(setup, unstarted=()))
    noise = begun.noise.with_values({
        key: recorded_noise(run.channels[name], record.channels[name])
        for run, record, keys in zip(setup.runs, records, begun.noise.keys, strict=True)
        for name, key in keys.items()
    })  # fmt: skip
    noise = dataclasses.replace(noise, estimated=not noise.complete)
    state = _evaluated(begun, noise)
    if not setup.loss.is_linear and noise.correlated:
        # The weights of cells are not stored, because they follow from the residuals.
        weights = reestimate(state).weights
        if weights is not None:
            state = _evaluated(begun, dataclasses.replace(noise, weights=weights))
    return Optimum(dataclasses.replace(state, rounds_left=0))


def _evaluated(begun: FitState, noise: Noise) -> FitState:
    state = step(reweight(begun, noise))
    if not state.evaluated:
        raise InputError("the model cannot be evaluated at the point where the fit ended")
    return with_active(state, responds(state.natural_jacobian.norms(), state.sizes))


# Eigenvalues below this fraction of the largest, for scaled columns, belong to directions without
# any response.
_FLAT = 1e-10
_LOOSE = 0.01  # component of a parameter in such a direction above which it is not determined


@dataclasses.dataclass(frozen=True)
class Equations:
    """Linear equations A x = -b of the step x that minimises the cost to first order.

    The matrix A is the curvature of the cost, and b is its gradient.
    """

    matrix: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]

    def __add__(self, other: "Equations") -> "Equations":
        return Equations(self.matrix + other.matrix, self.gradient + other.gradient)

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the step and the square roots of the diagonal of A^-1.

        Parameters that are not determined have NaN.
        """
        sizes = np.sqrt(np.maximum(np.diag(self.matrix), 0.0))
        sizes = np.where(sizes > 0, sizes, np.inf)
        values, vectors = np.linalg.eigh(self.matrix / np.outer(sizes, sizes))
        flat = values <= _FLAT * max(float(values[-1]), 1e-300)
        root = vectors[:, ~flat] / np.sqrt(values[~flat]) / sizes[:, None]
        step = -root @ (root.T @ self.gradient)
        errors = np.linalg.norm(root, axis=1)
        loose = np.any(np.abs(vectors[:, flat]) > _LOOSE, axis=1) | np.isinf(sizes)
        return np.where(loose, np.nan, step), np.where(loose, np.nan, errors)


@dataclasses.dataclass(frozen=True)
class CellEquations:
    """Information of the cells of a fit on its parameters, with the noise and weights of the fit.

    Attributes:
        positions: positions of the parameters that affect a channel and are not at a bound.
        cells: cells of each channel with their derivatives, by the position of the run and the name
            of the channel.
        rows: which samples of a run were measured, by the same keys.
        noise: noise of the channels, by key.
        loss: remaining loss, unless weights of cells replace it.
        priors: equations of the priors.
    """

    positions: tuple[int, ...]
    cells: Mapping[tuple[int, str], Cells]
    rows: Mapping[tuple[int, str], Bool[np.ndarray, " sample"]]
    noise: Mapping[str, ChannelNoise]
    loss: AbstractLoss
    priors: Equations

    @classmethod
    def of(cls, optimum: Optimum) -> "CellEquations":
        """Return the equations of a fit at its end."""
        state, statistics = optimum.state, optimum.statistics
        at = [int(i) for i in statistics.alive if int(i) not in statistics.bounds]
        slope = state.problem.bijector.slope(np.asarray(state.coordinate))
        cells = {
            key: dense_cells(weighted_cells(state, key, each), np.asarray(at, dtype=int), slope)
            for key, each in residual_cells(state, together=True).items()
        }
        rows, off = prior_rows(state, np.asarray(at, dtype=int))
        recorded = [run.observations for run in state.setup.runs]
        return cls(
            positions=tuple(at),
            cells=cells,
            rows={(run, name): ~np.isnan(recorded[run][name]) for run, name in cells},
            noise=state.noise.by_key(),
            loss=state.problem.loss,
            priors=Equations(rows.T @ rows, rows.T @ off),
        )

    def said(
        self, run: int, name: str, kept: Bool[np.ndarray, " sample"] | None = None
    ) -> Equations:
        """Return A and b of the cells of a channel, or of some samples, after whitening."""
        cells = self.cells[run, name]
        if kept is not None:
            cells = cells.where(kept[self.rows[run, name]])
        noise = self.noise[cells.key]
        if self.loss.is_linear:
            width = cells.own.shape[1]
            gram = cells.gram(noise)[0][width:, width:]
            return Equations(gram[:-1, :-1], gram[:-1, -1])
        _, psi, curvature, _ = self.loss.scores(cells.residual / noise.deviation)
        columns = cells.shared / noise.deviation
        return Equations(columns.T @ (columns * curvature[:, None]), columns.T @ psi)

    def whole(self, said: Sequence[Equations]) -> Equations:
        """Return the sum of these equations and those of the priors."""
        return sum(said, self.priors)
