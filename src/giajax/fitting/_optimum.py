"""A fit where it ended, to be asked again: its problem, its noise, and its compiled programs.

What takes many fits of the same data (profiles, repetitions, runs left out) begins at the optimum
and uses the programs that the fit was computed by: what is held, what was recorded and where it
starts are numbers of them, so that nothing is compiled again.
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
    """The problem at some values of its free parameters.

    Attributes:
        cost: half the sum of the loss, in units of the noise; infinite where the model fails.
        residual: whitened, transformed by the loss, those of priors last, shape (residual,).
        jacobian: of the residual by the parameters themselves.
        predictions: of each run, by channel, SI.
    """

    cost: float
    residual: np.ndarray
    jacobian: BlockJacobian
    predictions: list[dict[str, np.ndarray]]


@dataclasses.dataclass(frozen=True)
class Optimum:
    """Where a fit ended, with the noise that it was fitted with; made by `optimum`.

    Free parameters are those of the model, one value or one for each group of runs, and those of
    single runs, in the order of `labels`.

    Attributes:
        state: evaluated there.
    """

    state: FitState

    @functools.cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of all free parameters, those of single runs with the run."""
        return tuple(labels(self.state.problem, self.state.setup.runs))

    @functools.cached_property
    def statistics(self) -> Statistics:
        """Standard errors and correlations there."""
        return statistics(self.state)

    @property
    def values(self) -> np.ndarray:
        """Of all free parameters, SI, shape (parameter,)."""
        return self.state.values()

    @property
    def cost(self) -> float:
        """Half the sum of the loss, in units of the noise."""
        return self.state.cost

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of all free parameters, infinite where there is none."""
        bijector = self.state.problem.bijector
        return np.asarray(bijector.lower), np.asarray(bijector.upper)

    @property
    def predictions(self) -> list[dict[str, np.ndarray]]:
        """Of each run, by channel, SI."""
        state = self.state
        return predictions_by_run(state.problem, state.inner.aux, state.setup.runs)

    def position(self, label: str) -> int:
        """Where a free parameter stands.

        Raises:
            InputError: there is no such name.
        """
        if label not in self.labels:
            raise InputError(f"'{label}' was not free in this fit: use one of {self.labels}")
        return self.labels.index(label)

    def model(self, values: np.ndarray) -> AbstractModel:
        """The model at some values, shape (parameter,); of several of a path, their mean."""
        problem = self.state.problem
        return problem.with_values(problem.means(np.asarray(values)[: problem.shared]))

    def derived(self, name: str) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
        """A derived quantity, or a tied parameter, by its name in `FitResult.derived`.

        Its value and its gradient as a function of the values of all free parameters.

        Raises:
            InputError: there is no such name.
        """
        return derived_quantity(self.state.problem, self.values, name)

    def at(self, values: np.ndarray) -> Point:
        """Cost, residual and Jacobian at some values within the bounds, shape (parameter,)."""
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
        """Fit again, with the noise as it is; an end that did not converge says why.

        Arguments:
            held: values, SI, of parameters that do not move, by label.
            start: of all free parameters, SI, shape (parameter,); by default the optimum.
            recorded: in place of the values that the runs have.
            centres: of the priors, in place of theirs; of a logarithmic one the logarithm.
            max_iterations: trial steps.

        Raises:
            InputError: a label in `held` that there is not, or a value beyond its bounds.
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
    """The optimum of a fit, without fitting it again.

    Arguments:
        setup: what was fitted to what; its model has the fitted values and the tolerance that was
            used, and `own` those of single runs.
        records: of its runs, with the noise that was used.

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
        # The weights of cells are not kept: they follow from the residuals.
        weights = reestimate(state).weights
        if weights is not None:
            state = _evaluated(begun, dataclasses.replace(noise, weights=weights))
    return Optimum(dataclasses.replace(state, rounds_left=0))


def _evaluated(begun: FitState, noise: Noise) -> FitState:
    state = step(reweight(begun, noise))
    if not state.evaluated:
        raise InputError("the model cannot be evaluated where the fit ended")
    return with_active(state, responds(state.natural_jacobian.norms(), state.sizes))


# Of scaled columns: eigenvalues below this, of the largest, are directions that nothing shows.
_FLAT = 1e-10
_LOOSE = 0.01  # part of a parameter in such a direction from which it is not determined


@dataclasses.dataclass(frozen=True)
class Equations:
    """A x = -b, of the step x of some parameters that makes the cost least, to first order.

    The matrix A is the curvature of the cost, b its gradient.
    """

    matrix: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]

    def __add__(self, other: "Equations") -> "Equations":
        return Equations(self.matrix + other.matrix, self.gradient + other.gradient)

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """The step, and the roots of the diagonal of A^-1; NaN of what is not determined."""
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
    """What the cells of a fit say of its parameters, by the noise and the weights that it has.

    Attributes:
        positions: of the parameters: those that respond and are at no bound.
        cells: of each channel, by the position of the run and its name, with their derivatives.
        rows: of all samples of a run, which were measured, likewise.
        loss: that is left where weights of cells do not stand for it.
        priors: what is known beforehand.
    """

    positions: tuple[int, ...]
    cells: Mapping[tuple[int, str], Cells]
    rows: Mapping[tuple[int, str], Bool[np.ndarray, " sample"]]
    noise: Mapping[str, ChannelNoise]
    loss: AbstractLoss
    priors: Equations

    @classmethod
    def of(cls, optimum: Optimum) -> "CellEquations":
        """The equations of a fit where it ended."""
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
        """What the cells of a channel, or those of kept samples, say: A and b, made independent."""
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
        """What these say together with what is known beforehand."""
        return sum(said, self.priors)
