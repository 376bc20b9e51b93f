"""`springs5`, a linearly implicit additive Runge-Kutta method of order 5.

Stiff springs force an explicit method to take many steps for stability between two steps for
accuracy. Here the springs and dampers of the joints and the inputs that act on them are implicit,
and all other terms are explicit. A step requires one additional factorisation. It requires no
iteration, unless joints have hysteresis.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np

from ..runtime.arrays import (
    Array,
    Bool,
    Float,
    Scalar,
    cholesky_factor,
    inverse_of_positive,
    solution_by_factor,
)
from ._motion import Springs, resistance


class Tableau(NamedTuple):
    """Coefficients of an additive Runge-Kutta method as a W-method.

    Attributes:
        combine: weights of the slopes h f(Y) and h J (Y - y0) of each stage in each stage, shape
            (stage, stage, 2); the first row is the start and the last row the end of the step.
        times: times of the stages, as fractions of the step.
        error: weights of the slopes in the error estimate of the step.
        gamma: diagonal entry of the implicit method.
    """

    combine: np.ndarray
    times: np.ndarray
    error: np.ndarray
    gamma: float


def tableau() -> Tableau:
    """Return the coefficients of ARK5(4)8L[2]SA."""
    explicit, implicit = diffrax.KenCarp5.tableau.tableaus
    combine = _rows(explicit)
    # The rows of both matrices have the same sums, so J y0 cancels in their difference.
    springs = _rows(implicit) - combine
    gamma = float(springs[1, 1])
    np.fill_diagonal(springs, 0)
    return Tableau(
        np.stack([combine, springs], axis=2),
        np.concatenate([[0], explicit.c, [1]]),
        np.append(explicit.b_error, 0),
        gamma,
    )


def _rows(tableau: diffrax.ButcherTableau) -> np.ndarray:
    """Return the matrix of a method as a square, with the weights of the end of the step below."""
    size = len(tableau.b_sol)
    matrix = np.zeros((size + 1, size + 1))
    for row, lower in enumerate((*tableau.a_lower, tableau.b_sol), start=1):
        matrix[row, : len(lower)] = lower
    if tableau.a_diagonal is not None:
        matrix[range(size), range(size)] = tableau.a_diagonal
    return matrix


_POINTS = 3  # more points extrapolate worse, because stages are not ordered in time


def _extrapolation(times: np.ndarray) -> np.ndarray:
    """Return the weights of earlier stages in the initial guess of each, a polynomial in time."""
    weights = np.zeros((len(times), len(times)))
    for stage in range(1, len(times)):
        near = np.argsort(np.abs(times[:stage] - times[stage]), kind="stable")[:_POINTS]
        powers = np.vander(times[near], increasing=True).T
        weights[stage, near] = np.linalg.solve(powers, times[stage] ** np.arange(len(near)))
    return weights


State = Float[Array, "row joint"]


class QuinticInterpolation(diffrax.AbstractLocalInterpolation):
    """Quintic interpolation of the angles from angles, rates and accelerations at both ends.

    The rates are its derivative. Both are of order 5, like the method. The interpolation of Kennedy
    and Carpenter is of order 3. Further states are interpolated by cubics.
    """

    t0: Scalar  # type: ignore[misc]
    t1: Scalar  # type: ignore[misc]
    y0: State
    y1: State
    f0: State
    f1: State

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> State:
        """Return the state at one time, or its change between two times."""
        del left
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        step = self.t1 - self.t0
        # A step of zero length occurs between corners that differ by rounding.
        step = jnp.where(step == 0, 1, step)
        x = (t0 - self.t0) / step
        start, end = self.y0[0], self.y1[0]
        v0, v1 = step * self.y0[1], step * self.y1[1]
        a0, a1 = step**2 * self.f0[1], step**2 * self.f1[1]
        # Remaining differences at the end after a motion with the acceleration of the start.
        angle, rate, bend = end - start - v0 - a0 / 2, v1 - v0 - a0, a1 - a0
        c3 = 10 * angle - 4 * rate + bend / 2
        c4 = -15 * angle + 7 * rate - bend
        c5 = 6 * angle - 3 * rate + bend / 2
        angles = start + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5))))
        rates = v0 + x * (a0 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))
        moved = jnp.stack([angles, rates / step])
        if self.y0.shape[0] == 2:
            return moved
        start, end = self.y0[2:], self.y1[2:]
        v0, v1 = step * self.f0[2:], step * self.f1[2:]
        c2, c3 = 3 * (end - start) - 2 * v0 - v1, v0 + v1 - 2 * (end - start)
        return jnp.concatenate([moved, start + x * (v0 + x * (c2 + x * c3))])


# Whether the slope at the start of the next step is known, and the slope.
Carried = tuple[Bool[Array, ""], State]

# Slopes of all stages, state and slope of the last stage, and the largest expected correction of a
# stage, rad.
Stages = tuple[Array, State, State, Scalar]

# State of the iteration of a stage: number of iterations, size of the last correction, expected
# size of the next correction, and the rates.
_Search = tuple[Array, Array, Array, Array]

# The embedded method is so close to the method itself that their difference underestimates the
# error. With these factors a tolerance leads to about the same error of an arm's motion as with
# Tsit5. The second factor applies to further states, which have corners, and to the whole state if
# the arm has obstacles.
_CAUTION, _CAUTION_AT_CORNERS = 100.0, 10.0

# Factor for the rate-independent states, whose error is converted to the angle by which the joint
# bears it. Joints that oscillate fast with small amplitude reverse more often than a long step
# resolves, and each reversal leaves an error.
_CAUTION_AT_TURNS = 300.0

# A stage is solved if the next iteration would move no joint by more than the first value, rad, or
# by more than rounding. If this is not reached after the maximum number of iterations, and the next
# iteration would move a joint by more than the second value, the step is rejected.
_NEAR, _FAR, _MOST = 1e-8, 1e-6, 10
_ROUNDING = 16

# The error of a rate is multiplied by the time of a stage, or at least by the duration of a camera
# frame (s), and then treated as an error of an angle. Unscaled, it would dominate the step size,
# because light joints at the tip oscillate at high rates that hardly move the arm. After an impact
# the rates have the largest error, so with obstacles they have the same weight as the angles.
_FRAME = 0.03


class LinearlyImplicit(diffrax.AbstractAdaptiveSolver):
    """ARK5(4)8L[2]SA of Kennedy and Carpenter with implicit springs and dampers of the joints.

    In each step the equation y' = f(t, y) is split into an implicit part J y + g(t) and the
    explicit remainder. Here J = [[0, 1], [-M^-1 K, -M^-1 D]] consists of the mass matrix, stiffness
    and damping at the start of the step, and g = [0, M^-1 (tau(t) - tau(t0))] of the torque due to
    commands and drives. For a stiff spring that follows its command, both ends of the spring must
    be in the same part, so that only its small deflection remains. The method keeps its order 5 for
    each split, and thus for any J and g: it is a W-method, in which time is a further component of
    the state. Because the implicit part is linear in the state, each stage is the solution of a
    linear system with the same matrix, M + gamma h D + (gamma h)^2 K, which is factorised once per
    step.

    If laws of joints have states z, or pressures lag, J also contains their derivatives: of the
    torque with respect to z, and of dz/dt with respect to z and the rate. Each state depends only
    on its own joint, so it is eliminated from the matrix and adds to the damping. The supply of
    pressures is explicit. Contact adds its stiffness and damping, which couple the joints, and the
    skin of sticking links. Rate-independent torques of the joints (`resistance`) are implicit but
    nonlinear. In this case each stage is solved by Newton's method, and each iteration has its own
    matrix.

    Source: Kennedy and Carpenter, Applied Numerical Mathematics 44 (2003) 139; the coefficients are
    taken from `diffrax.KenCarp5`.

    Attributes:
        springs: function of time, state and arguments that returns the mass matrix (kg m^2),
            stiffness (N m/rad) and damping (N m s/rad) of the joints.
        pull: function of time, state and arguments that returns the torque of the joints (N m). For
            the state at the start of a step, its change with time is due to commands and drives
            only.
        reverse: whether a step can be differentiated in reverse mode, which compiles the equation
            of motion twice.
        resistance: function of time, state and arguments that returns the rate-independent torque
            of the joints (N m), or None if there is none. It is implicit but nonlinear.
    """

    springs: Callable[[Any, State, Any], Springs]
    pull: Callable[[Any, State, Any], Array]
    reverse: bool = eqx.field(static=True, default=True)
    resistance: Callable[[Any, State, Any], Array | None] = resistance

    term_structure: ClassVar[Any] = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Any] = QuinticInterpolation

    def order(self, terms: Any) -> int:
        """Return the order of the method; the embedded method has an order one lower."""
        del terms
        return 5

    def init(self, terms: Any, t0: Any, t1: Any, y0: State, args: Any) -> Carried:
        """Return the state before the first step, without a slope."""
        del terms, t0, t1, args
        return jnp.asarray(False), jnp.zeros_like(y0)

    def func(self, terms: Any, t0: Any, y0: State, args: Any) -> State:
        """Return the slope at one time."""
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
        """Perform one step."""
        step = t1 - t0
        # A step of zero length occurs between corners that differ by rounding.
        length = jnp.where(step == 0, 1, step)
        *arrays, gamma = tableau()
        combine, times, error = (jnp.asarray(array, y0.dtype) for array in arrays)
        end = len(times) - 1
        guess = jnp.asarray(_extrapolation(tableau().times), y0.dtype)
        # The order holds for any J. The same is true of the equation of a derivative if J is
        # treated as a constant, because that equation has the same J and further terms that are not
        # stiff.
        scale, springs = jax.lax.stop_gradient((gamma * step, self.springs(t0, y0, args)))
        # The inputs and the pull at all stages are computed together, which takes hardly more time
        # than for one. Rounding must not move the time beyond the end, where the next piece of the
        # command may start.
        moments = jnp.minimum(t0 + times * step, t1)
        given = jax.vmap(args.given)(jnp.minimum(moments, args.end))
        pulls = jax.vmap(lambda time: self.pull(time, y0, args))(moments)
        pulls = pulls - pulls[:1]
        resisted = self.resistance(t0, y0, args)
        solve, factorised = self._solver(scale, springs, linear=resisted is None)
        known, slope = solver_state
        # The slope at the start, usually that at the end of the previous step, is the slope of
        # stage 0. If it is computed in the loop over all stages, the equation of motion is compiled
        # once. A loop whose length is unknown cannot be differentiated in reverse mode.
        anew = eqxi.unvmap_any(made_jump | ~known)  # if one of a batch does, all do
        begin: Any = jnp.where(anew, 0, 1)
        if self.reverse:
            begin = 1
            slope = jax.lax.cond(anew, lambda: terms.vf(t0, y0, args), lambda: slope)

        def resist(rates: Array, given: Any) -> Array:
            """Return the change of the resisting torque since the start of the step."""
            known, _, time, y0, args, before = given
            moved = known.at[0].add(scale * rates).at[1].set(rates)
            return self.resistance(time, y0 + moved, args) - before

        def slope_at(rates: Array, given: Any) -> tuple[Array, Array]:
            """Return the nonlinear part of the resisting torque, and its linear damping."""
            torque, softening = jax.jvp(
                lambda x: resist(x, given), (rates,), (jnp.ones_like(rates),)
            )
            # A negative damping is omitted, because the matrix might then not be positive definite.
            # The derivatives of such a stage are approximate.
            damper = jax.lax.stop_gradient(jnp.maximum(-softening, 0))
            return torque + damper * rates, damper

        solved = max(_NEAR, _ROUNDING * float(jnp.finfo(y0.dtype).eps))

        def found(rates: Array, given: Any) -> tuple[State, Scalar]:
            """Return a stage with rate-independent torques, and its remaining error, rad."""
            stopped = jax.lax.stop_gradient(given)

            def better(carried: _Search) -> _Search:
                count, before, _, rates = carried
                torque, damper = slope_at(rates, stopped)
                pulled = stopped[1] + torque
                then = solve(stopped[0], pulled, damper, factorised(damper))[1]
                moved = jnp.max(jnp.abs(scale * (then - rates)))
                # The next correction is smaller by at least the same factor. (Another iteration
                # with the same matrix would be cheaper, but it finds solutions on the wrong side of
                # turns. The errors of the derivatives of a run are then a hundred times larger.)
                return count + 1, moved, moved * jnp.minimum(moved / before, 1), then

            far = jnp.asarray(jnp.inf, y0.dtype)
            least = jnp.full_like(far, jnp.finfo(y0.dtype).tiny)
            # The first iteration is outside of the loop, which saves a tenth of the time of a run.
            begun = better((jnp.asarray(0), least, far, jax.lax.stop_gradient(rates)))
            *_, left, rates = jax.lax.while_loop(
                lambda carried: (carried[0] < _MOST) & (carried[2] > solved), better, begun
            )
            # The derivatives of a stage are computed by one more iteration. They must be evaluated
            # where the equation of motion is evaluated, because they differ beyond a turn.
            rates = jax.lax.stop_gradient(rates)
            damper = slope_at(rates, stopped)[1]
            torque = resist(rates, given) + damper * rates
            return solve(given[0], given[1] + torque, damper, factorised(damper), rates), left

        def advance(stage: Any, carried: Stages) -> Stages:
            parts, _, _, off = carried
            known_part = jnp.sum(combine[stage][..., None, None] * parts, axis=(0, 1))
            time, pull, here = jax.tree.map(
                lambda each: jax.lax.dynamic_index_in_dim(each, stage, keepdims=False),
                (moments, pulls, given),
            )
            own = dataclasses.replace(args, known=here)
            # The end of the step is a weighted sum rather than a stage.
            if resisted is None:
                change = jnp.where(stage == end, known_part, solve(known_part, pull))
            else:
                fixed = known_part, pull, time, y0, own, resisted
                near = guess[stage] @ parts[:, 0, 0] / length - y0[1]
                near = jnp.where(stage == 0, 0, near)
                change, moved = jax.lax.cond(
                    stage == end,
                    lambda: (known_part, jnp.zeros_like(off)),
                    lambda: found(near, fixed),
                )
                off = jnp.maximum(off, moved)
            slope = terms.vf(time, y0 + change, own)
            # h f(Y) and h (J (Y - y0) + g)
            part = jnp.stack([step * slope, (change - known_part) / gamma])
            parts = jax.lax.dynamic_update_index_in_dim(parts, part, stage, 0)
            return parts, y0 + change, slope, off

        first = jnp.stack([step * slope, jnp.zeros_like(y0)])[None]
        parts = jnp.concatenate([first, jnp.zeros((end, *first.shape[1:]), y0.dtype)])
        stages: Stages = (parts, y0, slope, jnp.zeros((), y0.dtype))
        parts, y1, f1, off = jax.lax.fori_loop(begin, end + 1, advance, stages)
        f0 = parts[0, 0] / length
        dense = {"y0": y0, "y1": y1, "f0": f0, "f1": f1}
        y_error = jnp.tensordot(error, parts[:, 0], 1)
        weight: Any = _CAUTION_AT_CORNERS
        if springs.contact is None:
            row = jnp.arange(len(y0))[:, None]
            of_rate = jnp.maximum(scale, _FRAME)
            weight = jnp.where(row == 1, _CAUTION * of_rate, jnp.where(row == 0, _CAUTION, weight))
        if resisted is not None:
            rows = ((2, len(y0) - 2 - len(springs.borne)), (0, 0))
            borne = jnp.pad(springs.borne, rows, constant_values=jnp.nan)
            weight = jnp.where(jnp.isnan(borne), weight, _CAUTION_AT_TURNS * borne)
        y_error = weight * y_error
        if resisted is not None:
            y_error = jnp.where(jax.lax.stop_gradient(off) > max(_FAR, solved), jnp.inf, y_error)
        return y1, y_error, dense, (jnp.asarray(True), f1), diffrax.RESULTS.successful

    @staticmethod
    def _solver(
        scale: Scalar, springs: Springs, linear: bool
    ) -> tuple[Callable[..., State], Callable[[Array], Array]]:
        """Return functions that solve (1 - scale J) x = b + scale g and factorise the matrix.

        The first function takes b and the torque in g. If the problem is not `linear`, J has
        additional dampers (N m s/rad) in each call, and the second function returns the factor of
        the matrix with these dampers. If the rates are given as `known`, only the derivatives of x
        are computed from the system.
        """
        mass, stiffness, damping, strain, contact, _ = springs
        spring = scale * stiffness
        damper = scale * (damping + spring)
        if strain is not None:
            # For each state: x = kept (b + scale filling rate).
            kept = 1 / (1 + scale * strain.forgetting)
            torque = scale * strain.torque * kept
            damper = damper + jnp.sum(torque * scale * strain.filling, axis=0)
        count = 0 if strain is None else len(strain.torque)
        matrix, sticking = mass + jnp.diag(damper), None
        if contact is not None:
            pressing = scale * contact.angles
            resisting = scale * (contact.rates + pressing)
            if contact.sticking is not None:
                sticking = contact.sticking.reshape(-1, len(damper))
                stretching = scale * contact.skin * sticking.T
                resisting = resisting + stretching @ (scale * sticking)
            matrix = matrix + resisting
        # There are seven stages, and as many for each derivative, so products with the inverse are
        # cheaper than solutions.
        inverse = inverse_of_positive(matrix) if linear else matrix

        def solve(
            right_side: State,
            pull: Array,
            further: Array | None = None,
            factor: Array | None = None,
            known: Array | None = None,
        ) -> State:
            angles, rates, states = right_side[0], right_side[1], right_side[2:]
            held = spring * angles + damper * rates - scale * pull
            stretch = states[count:]
            if contact is not None:
                held = held + pressing @ angles + resisting @ rates
            if sticking is not None:
                held = held + stretching @ stretch.ravel()
            if strain is not None:
                held = held + jnp.sum(torque * states[:count], axis=0)
            if further is None or factor is None:
                rates = rates - inverse @ held
            else:
                held = held + scale * further * rates
                if known is None:
                    rates = rates - solution_by_factor(factor, held)
                else:
                    rates = _known(known, factor, held, rates)
            rows = [(angles + scale * rates)[None], rates[None]]
            if strain is not None:
                rows.append(kept * (states[:count] + scale * strain.filling * rates[None]))
            if sticking is not None:
                rows.append(stretch + (scale * sticking @ rates).reshape(stretch.shape))
            return jnp.concatenate(rows)

        return solve, lambda further: cholesky_factor(matrix + jnp.diag(scale * further))


@jax.custom_jvp
def _known(rates: Array, factor: Array, held: Array, begin: Array) -> Array:
    """Return the known value of begin - A^-1 held, with its derivatives; A = L L^T."""
    del factor, held, begin
    return rates


@_known.defjvp
def _known_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    rates, factor, *_ = primals
    _, _, held, begin = tangents
    return rates, begin - solution_by_factor(factor, held)
