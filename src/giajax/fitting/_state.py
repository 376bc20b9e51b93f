"""Where a fit stands: a frozen state, so that whoever holds one has a whole fit in hand."""

import dataclasses
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array
from ._bijector import Bijector
from ._configuration import Setup
from ._group import build_groups, own_start
from ._jacobian import BlockJacobian
from ._noise import Noise
from ._problem import Prediction, Problem, residual
from ._records import Iteration, Status
from ._solver import Marquardt, MarquardtState

# In the free coordinate: a positive parameter changes by less than a factor of 4.5 in one step.
_LARGEST_STEP = 1.5


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
        done: whether the solver wants no further step.
        converged: whether it stopped at an optimum.
        trials: steps that were tried.
        history: the start and each trial.
        step_seconds: wall time of each evaluation; the first one compiles.
        ending: how the fit ended and one sentence about it; None while it goes on.
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
    done: bool = False
    converged: bool = False
    trials: int = 0
    history: tuple[Iteration, ...] = ()
    step_seconds: tuple[float, ...] = ()
    ending: tuple[Status, str] | None = None

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
        values = np.asarray(self.problem.bijector.forward(self.coordinate), dtype=float)
        # What is held keeps its start exactly, not as it comes back from its coordinate.
        return np.where(np.asarray(self.active), values, self.start)

    def parameters(self) -> dict[str, float]:
        """Values of the model's free parameters at the best point, by path."""
        values = self.values()[: len(self.problem.paths)]
        return {path: float(v) for path, v in zip(self.problem.paths, values, strict=True)}

    def jacobian(self, inner: MarquardtState | None = None) -> BlockJacobian:
        """Weighted residuals by the free coordinates; those that are held count as zero."""
        inner = self.inner if inner is None else inner
        whole = BlockJacobian.of(self.problem, inner.jacobian)
        return whole.scaled(np.asarray(self.active, dtype=float))

    def natural_jacobian(self) -> BlockJacobian:
        """Weighted residuals by the parameters themselves."""
        slope = self.problem.bijector.slope(np.asarray(self.coordinate))
        return self.jacobian().scaled(1 / np.maximum(slope, 1e-300))

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

    def ended(self, status: Status, message: str) -> Self:
        """The end of the fit."""
        return dataclasses.replace(self, ending=(status, message))


def begin(setup: Setup) -> FitState:
    """The state before anything is evaluated."""
    setup = setup.at_start()
    model, parameters = setup.model, setup.parameters
    noise = Noise.of(setup.runs)
    groups = build_groups(model, setup.runs, noise.values, len(parameters))
    own = own_start(groups)
    bijector = Bijector(
        (*(p.declaration.lower for p in parameters), *(-np.inf for _ in own)),
        (*(p.declaration.upper for p in parameters), *(np.inf for _ in own)),
    )
    problem = Problem(
        model=model,
        groups=groups,
        bijector=bijector,
        paths=tuple(p.path for p in parameters),
        loss=setup.loss,
    )
    start = np.asarray([*(float(p.value(model)) for p in parameters), *own])
    # A parameter whose start and default are zero has no size of its own: one unit.
    defaults = np.asarray([*(p.declaration.default for p in parameters), *(0.0 for _ in own)])
    sizes = np.maximum(np.abs(start), np.abs(defaults))
    # In 32-bit the rounding of a simulation hides the last hundredth of a standard error.
    distance = 0.1 if jnp.result_type(float) == jnp.float32 else 0.01
    solver = Marquardt(
        distance=distance,
        # Residuals of this norm, in units of the noise, move no parameter by more than that.
        floor=distance**2 / 2,
        largest_step=_LARGEST_STEP,
    )
    coordinate = jnp.asarray(bijector.inverse(start), dtype=jnp.result_type(float))
    return FitState(
        setup=setup,
        problem=problem,
        noise=noise,
        start=start,
        sizes=np.where(sizes > 0, sizes, 1.0),
        solver=solver,
        coordinate=coordinate,
        inner=blank(solver, problem, coordinate),
        active=jnp.ones(problem.size, bool),
    )


def blank(solver: Marquardt, problem: Problem, coordinate: Array) -> MarquardtState:
    """The solver's state before its first evaluation."""
    groups, dtype = problem.groups, coordinate.dtype
    count = sum(group.observed.size for group in groups)
    prediction = Prediction(
        tuple(jax.ShapeDtypeStruct(group.observed.shape, dtype) for group in groups),
        jax.ShapeDtypeStruct((), bool),
    )
    shape = jax.ShapeDtypeStruct((count,), dtype)
    shared = len(problem.paths)
    blocks = tuple(
        jnp.zeros((len(g.members), g.observed[0].size, shared + g.width), dtype) for g in groups
    )
    options = {"jacobian": blocks}
    return solver.init(residual, coordinate, problem, options, shape, prediction, frozenset())
