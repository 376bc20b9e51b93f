"""One fit between the steps of its host loop: a point, the solver's state, one compiled step."""

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .._program import program
from .._typing import Array
from ._jacobian import BlockJacobian
from ._problem import Prediction, Problem, linearise, residual
from ._solver import Marquardt, MarquardtState

# In the free coordinate: a positive parameter changes by less than a factor of 4.5 in one step.
_LARGEST_STEP = 1.5


class Fitter:
    """The state of one fit between the steps of its host loop."""

    def __init__(self, problem: Problem, start: np.ndarray, sizes: np.ndarray) -> None:
        """Begin at values of the free parameters; nothing is evaluated yet.

        Arguments:
            problem: what is minimised.
            start: values of the free parameters, those of single runs last, shape (parameter,).
            sizes: their typical sizes, for judging whether anything responds to them.
        """
        self.problem = problem
        self.start = start
        self.sizes = sizes
        # In 32-bit the rounding of a simulation hides the last hundredth of a standard error.
        coarse = jnp.result_type(float) == jnp.float32
        distance = 0.1 if coarse else 0.01
        self.solver = Marquardt(
            distance=distance,
            # Residuals of this norm, in units of the noise, move no parameter by more than that.
            floor=distance**2 / 2,
            largest_step=_LARGEST_STEP,
        )
        self.coordinate: Array = jnp.asarray(
            problem.bijector.inverse(start), dtype=jnp.result_type(float)
        )
        self.active = jnp.ones(problem.size, bool)
        self.state = self.fresh_state()
        self.step_seconds: list[float] = []
        self.converged = False
        self.best: tuple[Array, MarquardtState] | None = None

    def fresh_state(self) -> MarquardtState:
        """The solver's state before its first evaluation."""
        groups = self.problem.groups
        dtype = self.coordinate.dtype
        count = sum(group.observed.size for group in groups)
        prediction = Prediction(
            tuple(jax.ShapeDtypeStruct(group.observed.shape, dtype) for group in groups),
            jax.ShapeDtypeStruct((), bool),
        )
        shape = jax.ShapeDtypeStruct((count,), dtype)
        shared = len(self.problem.paths)
        blocks = tuple(
            jnp.zeros((len(g.members), g.observed[0].size, shared + g.width), dtype) for g in groups
        )
        options = {"jacobian": blocks}
        return self.solver.init(
            residual, self.coordinate, self.problem, options, shape, prediction, frozenset()
        )

    def step(self) -> bool:
        """One step; returns whether the solver is done."""
        began = time.perf_counter()
        self.coordinate, self.state, done, converged = _step(
            self.solver, self.coordinate, self.problem, self.state, self.active
        )
        self.converged = bool(converged)  # waits for the result
        self.step_seconds.append(time.perf_counter() - began)
        return bool(done)

    def evaluate(self, coordinate: Any, problem: Problem | None = None) -> MarquardtState:
        """Residual and Jacobian at a point, by the same compiled program as a step."""
        coordinate = jnp.asarray(coordinate, dtype=self.coordinate.dtype)
        problem = self.problem if problem is None else problem
        fresh = self.fresh_state()
        _, state, _, _ = _step(self.solver, coordinate, problem, fresh, self.active)
        return state

    def jacobian(self, state: MarquardtState | None = None) -> BlockJacobian:
        """Weighted residuals by the free coordinates; those that are held count as zero."""
        state = self.state if state is None else state
        whole = BlockJacobian.of(self.problem, state.jacobian)
        return whole.scaled(np.asarray(self.active, dtype=float))

    def natural_jacobian(self) -> BlockJacobian:
        """Weighted residuals by the parameters themselves."""
        slope = self.problem.bijector.slope(np.asarray(self.coordinate))
        return self.jacobian().scaled(1 / np.maximum(slope, 1e-300))

    def release(self) -> bool:
        """Move parameters off a bound at which only their coordinate has become flat.

        Near a bound the slope of the bijector vanishes, and with it the gradient, whether the
        optimum is there or not. The Gauss-Newton step of the parameter itself tells: where it
        leads inwards, further than the bound is away, and promises a lower cost, the parameter
        moves there. Returns whether one did; the next step evaluates the new point.
        """
        bijector = self.problem.bijector
        coordinate = np.array(self.coordinate)
        values = np.array(bijector.forward(self.coordinate))
        residual = np.asarray(self.state.residual)
        slopes = bijector.slope(coordinate)
        noise = 2 * float(self.state.cost) / max(len(residual) - len(values), 1)
        released = False
        jacobian = self.jacobian()
        responses, along = jacobian.norms() ** 2, jacobian.transposed_times(residual)
        for index in np.flatnonzero(np.asarray(self.active)):
            response, downhill = float(responses[index]), -float(along[index])
            if response == 0 or slopes[index] == 0:
                continue
            change = downhill / response * slopes[index]
            gain = downhill**2 / response / 2
            lower, upper = bijector.lower[index], bijector.upper[index]
            to_bound = min(values[index] - lower, upper - values[index])
            target = values[index] + change
            if lower < target < upper and abs(change) > to_bound and gain > noise:
                values[index] = target
                released = True
        if released:
            self.move_to(bijector.inverse(values))
        return released

    def move_to(self, coordinate: Any) -> None:
        """Go on from another point, or with another problem: the next step evaluates it."""
        self.best = (self.coordinate, self.state)
        self.coordinate = jnp.asarray(coordinate, dtype=self.coordinate.dtype)
        self.state = self.fresh_state()

    def back_to_best(self) -> bool:
        """Return to where `move_to` left, unless the new point is better; whether it did."""
        if self.best is None or float(self.state.cost) < float(self.best[1].cost):
            return False
        self.coordinate, self.state = self.best
        return True

    @property
    def evaluated(self) -> bool:
        """Whether the model was evaluated at the present point."""
        return bool(np.isfinite(float(self.state.cost)))

    def values(self) -> np.ndarray:
        """Values of all free coordinates' parameters at the best point."""
        values = np.asarray(self.problem.bijector.forward(self.coordinate), dtype=float)
        # What is held keeps its start exactly, not as it comes back from its coordinate.
        return np.where(np.asarray(self.active), values, self.start)

    def parameters(self) -> dict[str, float]:
        """Values of the model's free parameters at the best point."""
        values = self.values()[: len(self.problem.paths)]
        return {path: float(v) for path, v in zip(self.problem.paths, values, strict=True)}


@program
def _step(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> tuple[Array, MarquardtState, Array, Array]:
    options = {"active": active, "linearise": linearise}
    coordinate, state, _ = solver.step(residual, coordinate, problem, options, state, frozenset())
    done, result = solver.terminate(residual, coordinate, problem, options, state, frozenset())
    return coordinate, state, done, done & (result == optx.RESULTS.successful)
