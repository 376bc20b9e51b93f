"""A fit where it ended, to be asked again: its problem, its noise, and its compiled programs.

What takes many fits of the same data (profiles, repetitions, runs left out) begins at the optimum
and uses the programs that the fit was computed by: what is held, what was recorded and where it
starts are numbers of them, so that nothing is compiled anew.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping

import numpy as np

from .._errors import InputError
from .._maths import on_device
from .._typing import Float
from ..models import AbstractModel
from ._derived import derived_quantity
from ._group import recorded_otherwise
from ._jacobian import BlockJacobian
from ._labels import labels
from ._problem import predictions_by_run
from ._recorded import Recorded
from ._refit import Refit, descended
from ._state import FitState
from ._statistics import Statistics, statistics
from ._transitions import evaluate, move

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
        return self._predictions(self.state)

    def position(self, label: str) -> int:
        """Where a free parameter stands.

        Raises:
            InputError: there is none of this name.
        """
        if label not in self.labels:
            raise InputError(f"'{label}' was not free in this fit: use one of {self.labels}")
        return self.labels.index(label)

    def model(self, values: np.ndarray) -> AbstractModel:
        """The model at some values, shape (parameter,); of several of a path, their mean."""
        problem = self.state.problem
        return problem.with_values(problem.means(np.asarray(values)[: problem.shared]))

    def derived(self, name: str) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
        """A derived quantity, or a tied parameter, of the result.

        Arguments:
            name: as in `FitResult.derived`.

        Returns:
            Its value and its gradient as a function of the values of all free parameters.

        Raises:
            InputError: there is none of this name.
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
        return Point(
            cost=float(inner.cost),
            residual=np.asarray(inner.residual),
            jacobian=there.natural_jacobian(),
            predictions=self._predictions(there),
        )

    def refit(
        self,
        *,
        held: Mapping[str, float] | None = None,
        start: np.ndarray | None = None,
        recorded: Recorded | None = None,
        centres: Float[np.ndarray, " prior"] | None = None,
        max_iterations: int = MOST_STEPS,
    ) -> Refit:
        """Fit again, with the noise as it is.

        Arguments:
            held: values, SI, of parameters that do not move, by label.
            start: of all free parameters, SI, shape (parameter,); by default the optimum.
            recorded: of each run, values by channel, SI, in place of those that it has; NaN where
                a cell does not count.
            centres: of the priors, in place of those that they have, in the order of
                `state.problem.priors`; of a logarithmic one the logarithm.
            max_iterations: trial steps.

        Returns:
            The end; one that did not converge says why.

        Raises:
            InputError: a label in `held` that there is not, or a value beyond its bounds.
        """
        state, (lower, upper) = self.state, self.bounds
        values = np.array(self.values if start is None else start, dtype=float)
        active = np.array(state.active)
        for label, value in (held or {}).items():
            place = self.position(label)
            if not lower[place] <= value <= upper[place]:
                raise InputError(f"{label} cannot be held at {value:g}, beyond its bounds")
            values[place], active[place] = value, False
        values = np.clip(values, lower, upper)
        problem = state.problem
        if recorded is not None:
            groups = recorded_otherwise(problem.groups, state.setup.runs, state.noise, recorded)
            problem = dataclasses.replace(problem, groups=groups)
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
        return descended(move(begun, problem.bijector.inverse(values)), max_iterations)

    def _predictions(self, state: FitState) -> list[dict[str, np.ndarray]]:
        return predictions_by_run(state.problem, state.inner.aux, state.setup.runs)
