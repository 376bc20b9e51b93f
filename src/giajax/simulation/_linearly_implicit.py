"""A linearly implicit method for stiff joints: one more factorisation a step, no iteration.

Between two accurate steps of an explicit method stiff springs force many that are merely stable.
Here the springs and dampers of the joints are implicit, and nothing else is.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Bool, Float, Scalar

State = Float[Array, "2 joint"]
# Whether the slope at the start of the next step is known, and the slope.
Carried = tuple[Bool[Array, ""], State]
Springs = tuple[Float[Array, "joint joint"], Float[Array, " joint"], Float[Array, " joint"]]


# The embedded method is so near to the method itself that its difference understates the error;
# with this a tolerance means about the same error of an arm's motion as with Tsit5.
_CAUTION = 10.0


def _rows(tableau: diffrax.ButcherTableau) -> np.ndarray:
    """The matrix of a method as a square, and below it the weights of the end of the step."""
    size = len(tableau.b_sol)
    matrix = np.zeros((size + 1, size + 1))
    for row, lower in enumerate((*tableau.a_lower, tableau.b_sol), start=1):
        matrix[row, : len(lower)] = lower
    if tableau.a_diagonal is not None:
        matrix[range(size), range(size)] = tableau.a_diagonal
    return matrix


class Tableau(NamedTuple):
    """The coefficients of an additive Runge-Kutta method as a W-method.

    Attributes:
        combine: of which slopes h f(Y) and of which h J (Y - y0) each stage is made, the first
            stage being the start and the last row the end of the step.
        times: of the stages, as fractions of the step.
        error: of which slopes the error of the step is made.
        gamma: the diagonal of the implicit method.
    """

    combine: np.ndarray
    times: np.ndarray
    error: np.ndarray
    gamma: float


def tableau() -> Tableau:
    """The coefficients of ARK5(4)8L[2]SA."""
    explicit, implicit = diffrax.KenCarp5.tableau.tableaus
    combine = _rows(explicit)
    # The rows of both have the same sums, so that J y0 drops out of their difference.
    springs = _rows(implicit) - combine
    gamma = float(springs[1, 1])
    np.fill_diagonal(springs, 0)
    return Tableau(
        np.concatenate([combine, springs], axis=1),
        np.concatenate([[0], explicit.c, [1]]),
        np.append(explicit.b_error, 0),
        gamma,
    )


class QuinticInterpolation(diffrax.AbstractLocalInterpolation):
    """Angles by the polynomial through angles, rates and accelerations at both ends of a step.

    The rates are its slope. Both are of the fifth order, as the method is; the interpolation that
    Kennedy and Carpenter give is of the third.
    """

    t0: Scalar  # type: ignore[misc]
    t1: Scalar  # type: ignore[misc]
    y0: State
    y1: State
    f0: State
    f1: State

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> State:
        """The state at a time, or the change between two."""
        del left
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        step = self.t1 - self.t0
        # A step of no length occurs between corners that differ by rounding.
        step = jnp.where(step == 0, 1, step)
        x = (t0 - self.t0) / step
        start, end = self.y0[0], self.y1[0]
        v0, v1 = step * self.y0[1], step * self.y1[1]
        a0, a1 = step**2 * self.f0[1], step**2 * self.f1[1]
        # What is left to reach at the end after a motion with the acceleration of the start.
        angle, rate, bend = end - start - v0 - a0 / 2, v1 - v0 - a0, a1 - a0
        c3 = 10 * angle - 4 * rate + bend / 2
        c4 = -15 * angle + 7 * rate - bend
        c5 = 6 * angle - 3 * rate + bend / 2
        angles = start + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5))))
        rates = v0 + x * (a0 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))
        return jnp.stack([angles, rates / step])


class LinearlyImplicit(diffrax.AbstractAdaptiveSolver):
    """ARK5(4)8L[2]SA of Kennedy and Carpenter with the joints' springs as its implicit part.

    The equation y' = f(y) is split, anew in each step, into J y, implicit, and f(y) - J y,
    explicit, with J = [[0, 1], [-M^-1 K, -M^-1 D]] of the mass matrix, stiffness and damping at
    the start of the step. The method keeps its order 5 for every split, hence for every J: it is
    a W-method. The implicit part being linear, a stage is one solution with one matrix,
    M + g h D + (g h)^2 K, which is factorised once a step.

    Source: Kennedy and Carpenter, Applied Numerical Mathematics 44 (2003) 139; the coefficients
    are those of `diffrax.KenCarp5`.

    Attributes:
        springs: mass matrix (kg m^2), stiffness (N m/rad) and damping (N m s/rad) of the joints
            from time, state and arguments.
    """

    springs: Callable[[Any, State, Any], Springs]

    term_structure: ClassVar[Any] = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Any] = QuinticInterpolation

    def order(self, terms: Any) -> int:
        """Order of the method; the one embedded for the error is one lower."""
        del terms
        return 5

    def init(self, terms: Any, t0: Any, t1: Any, y0: State, args: Any) -> Carried:
        """Nothing carried from a step before."""
        del terms, t0, t1, args
        return jnp.asarray(False), jnp.zeros_like(y0)

    def func(self, terms: Any, t0: Any, y0: State, args: Any) -> State:
        """The slope at one time."""
        return terms.vf(t0, y0, args)

    def step(
        self,
        terms: Any,
        t0: Any,
        t1: Any,
        y0: State,
        args: Any,
        solver_state: Carried,
        made_jump: Any,
    ) -> tuple[State, State, dict[str, State], Carried, Any]:
        """One step."""
        step = t1 - t0
        *arrays, gamma = tableau()
        combine, times, error = (jnp.asarray(array, y0.dtype) for array in arrays)
        end = len(times) - 1
        solve = self._solver(gamma * step, t0, y0, args)
        known, slope = solver_state
        anew = made_jump | ~known
        # Of a batch, one evaluates for all.
        slope = jax.lax.cond(
            eqxi.unvmap_any(anew),
            lambda: jnp.where(anew, terms.vf(t0, y0, args), slope),
            lambda: slope,
        )

        def advance(parts: Array, stage: Array) -> tuple[Array, tuple[State, State]]:
            known_part = jnp.sum(combine[stage][:, None, None] * parts, axis=0)
            # The end of the step is a sum, not a stage.
            change = jnp.where(stage == end, known_part, solve(known_part))
            # Not beyond the end by rounding, where the next piece of the command may start.
            time = jnp.minimum(t0 + times[stage] * step, t1)
            slope = terms.vf(time, y0 + change, args)
            parts = parts.at[stage].set(step * slope)
            # h J (Y - y0)
            parts = parts.at[end + 1 + stage].set((change - known_part) / gamma)
            return parts, (y0 + change, slope)

        # In a loop the equation of motion is compiled once.
        parts = jnp.zeros((2 * (end + 1), *y0.shape), y0.dtype).at[0].set(step * slope)
        parts, (states, slopes) = jax.lax.scan(advance, parts, jnp.arange(1, end + 1))
        y1, f1 = states[-1], slopes[-1]
        dense = {"y0": y0, "y1": y1, "f0": slope, "f1": f1}
        y_error = _CAUTION * jnp.tensordot(error, parts[: end + 1], 1)
        return y1, y_error, dense, (jnp.asarray(True), f1), diffrax.RESULTS.successful

    def _solver(
        self, scale: Scalar, time: Any, state: State, args: Any
    ) -> Callable[[State], State]:
        """What solves (1 - scale J) x = b."""
        # The order holds for every J, so that of the equation for a derivative holds with J
        # taken for a constant, too: that equation has J again, and terms that are not stiff.
        scale, (mass, stiffness, damping) = jax.lax.stop_gradient(
            (scale, self.springs(time, state, args))
        )
        spring = scale * stiffness
        damper = scale * (damping + spring)
        factor = jnp.linalg.cholesky(mass + jnp.diag(damper), symmetrize_input=False)
        # Seven stages, and as many for each derivative: products are cheaper than solutions.
        half = jax.lax.linalg.triangular_solve(
            factor, jnp.eye(len(damper)), left_side=True, lower=True
        )
        inverse = half.T @ half

        def solve(right_side: State) -> State:
            angles, rates = right_side
            rates = rates - inverse @ (spring * angles + damper * rates)
            return jnp.stack([angles + scale * rates, rates])

        return solve
