"""A Marquardt-scaled trust region behind optimistix's interface.


The Levenberg-Marquardt method of optimistix damps with a multiple of the identity, and computes the
Jacobian more than once for each step. For the arm of the paper it needs 36 to 45 steps. Here the
damping is scaled by the norms of the columns of the Jacobian (Marquardt 1963; More 1978). One
vmapped jvp gives the value and the Jacobian of the trial point together, so an accepted step
requires one evaluation.
"""

import functools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx

from ..runtime.arrays import Array, Bool, Float, Scalar

Linearised = tuple[Array, Any, Array, Array, Any]
"""Residual, Jacobian, R and Q^T r of its QR factorisation, and auxiliary output."""


class MarquardtState(eqx.Module):
    """State between two steps. Fields such as `residual` belong to the last accepted point.

    Attributes:
        residual: residual at the point.
        jacobian: Jacobian in the form that `linearise` returns.
        factor, projected: R and Q^T r of the QR factorisation of the Jacobian.
        cost: half the squared norm of the residual, infinite before the first evaluation.
        scale: largest norm of each column so far, which scales the damping.
        damping: Marquardt's lambda.
        growth: factor on the damping at the next rejection.
        step: last step, accepted or rejected.
        accepted: whether the last step was accepted.
        detour: step to try next instead of a shorter one, 0 if there is none.
        finite: whether all values at the end of the last step were finite.
        aux: auxiliary output at the point.
        evaluations: number of evaluations of value and Jacobian.
    """

    residual: Float[Array, " residual"]
    jacobian: Any
    factor: Float[Array, "parameter parameter"]
    projected: Float[Array, " parameter"]
    cost: Scalar
    scale: Float[Array, " parameter"]
    damping: Scalar
    growth: Scalar
    step: Float[Array, " parameter"]
    accepted: Bool[Array, ""]
    detour: Float[Array, " parameter"]
    finite: Bool[Array, ""]
    aux: Any
    evaluations: Array


def residual_scale(state: MarquardtState) -> Any:
    """Return the root of the reduced chi-square: the noise estimated from the residual itself."""
    size = state.residual.shape[0] - state.projected.shape[0]
    return (2 * state.cost / max(size, 1)) ** 0.5


# Maximum number of rounds in which coordinates that leave the box are put on its sides, coordinates
# that return are released, and the others are solved for again; and the number of rounds that
# change all of them at once.
_SIDES, _AT_ONCE = 40, 6

# A bound is reached only from nearby. From further away, a step covers at most this fraction of the
# distance.
_AT_HAND, _WAY = 0.1, 0.9


def towards(bound: Float[Array, " parameter"], most: float) -> Float[Array, " parameter"]:
    """Return the limits of a step of at most `most` towards bounds (negative downwards)."""
    way = jnp.where(jnp.abs(bound) > _AT_HAND, _WAY * bound, bound)
    return jnp.clip(way, -abs(most), abs(most))


class _Sides(NamedTuple):
    """Coordinates that are held on a side of the box, and the resulting step."""

    step: Array
    side: Array
    held: Array
    wrong: Array
    rounds: Array


def boxed_step(
    factor: Float[Array, "parameter parameter"],
    projected: Float[Array, " parameter"],
    damping: Float[Array, " parameter"],
    box: tuple[Float[Array, " parameter"], Float[Array, " parameter"]],
    active: Bool[Array, " parameter"],
) -> Float[Array, " parameter"]:
    """Return the step s that minimises |R s + Q^T r|^2 + |D s|^2 over a box.

    The method is block principal pivoting (Kim and Park 2011). Coordinates that would leave the box
    are held on its side, the others are solved for again, and held coordinates that would return
    are released. Shortening the whole step instead would let one weak parameter delay all others.

    Arguments:
        factor, projected: R and Q^T r of the QR factorisation of the Jacobian.
        damping: diagonal of D, positive.
        box: lowest (at most 0) and highest (at least 0) step of each coordinate.
        active: coordinates that may move.
    """
    lowest, highest = box
    diagonal = jnp.diag(damping)

    def solve(direct: Array, held: Array) -> Array:
        matrix = jnp.concatenate([jnp.where(held[None], 0, factor), diagonal])
        load = projected + factor @ direct
        vector = jnp.concatenate([-load, jnp.zeros_like(load)])
        operator = lx.MatrixLinearOperator(matrix)
        return lx.linear_solve(operator, vector, solver=lx.QR(), throw=False).value + direct

    places = jnp.arange(active.shape[0])

    def again(carry: _Sides) -> _Sides:
        step = solve(jnp.where(carry.held, carry.side, 0), carry.held | ~active)
        below, above = step < lowest, step > highest
        uphill = factor.T @ (projected + factor @ step) + damping**2 * step
        back = carry.held & jnp.where(carry.side <= lowest, uphill < 0, uphill > 0)
        wrong = active & ((~carry.held & (below | above)) | back)
        # Changing all at once is fast, but may cycle. Changing one at a time, by position, does
        # not.
        last = jnp.max(jnp.where(wrong, places, -1))
        wrong = wrong & ((carry.rounds < _AT_ONCE) | (places == last))
        side = jnp.where(wrong & below, lowest, jnp.where(wrong & above, highest, carry.side))
        return _Sides(step, side, carry.held ^ wrong, jnp.any(wrong), carry.rounds + 1)

    nothing = jnp.zeros_like(damping)
    begin = _Sides(
        nothing,
        nothing,
        jnp.zeros_like(active),
        jnp.asarray(True),
        jnp.asarray(0, dtype=jnp.int32),
    )
    end = jax.lax.while_loop(lambda now: now.wrong & (now.rounds < _SIDES), again, begin)
    return jnp.clip(end.step, lowest, highest)


# Smallest factors by which an accepted step may lower the damping: after an accepted step, and
# after a rejected one.
_SHRINKS = 0.05, 0.33


class Marquardt(optx.AbstractLeastSquaresSolver):
    """Least-squares trust-region solver in which a failed trial point is a rejected step.

    `fn(y, args)` takes one array of parameters and returns one array of residuals and auxiliary
    output, and must be differentiable in forward mode. A trial point whose residual or Jacobian is
    not finite is rejected, and the step becomes shorter.

    These `options` of `optimistix.least_squares` are used:

    - `active`: Boolean array of the parameters that may move.
    - `lower`, `upper`: arrays of bounds, on which a trial point may lie. They are infinite by
      default.
    - `linearise`: a function of `(y, args)` that returns the residual, the Jacobian (any pytree),
      R and Q^T r of its QR factorisation, and the auxiliary output, for structured problems. `fn`
      is then not called. `jacobian` is a template of the pytree.

    Arguments:
        rtol, atol: a step that changes no parameter by more than `atol + rtol |y|` is the last. The
            solver has converged if that step was taken without damping, and is stuck otherwise.
        distance: the solver has converged if the full Gauss-Newton step would change the parameters
            by less than this number of standard errors (for the noise estimated from the residual).
        floor: the solver has converged if the cost is not above this value.
        largest_step: largest change of a coordinate in one step. If coordinates are logarithms, it
            limits a trial point to a factor, so that an early, poor model of the cost does not send
            a parameter to its bound or make a chain stiff.
        norm: not used by this solver, but required by optimistix.
    """

    rtol: float = 1e-9
    atol: float = 1e-9
    distance: float = 1e-2
    floor: float = 0.0
    largest_step: float = float("inf")
    norm: Callable[[Any], Scalar] = optx.max_norm

    def init(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        f_struct: Any,
        aux_struct: Any,
        tags: frozenset[object],
    ) -> MarquardtState:
        """Return the state before the first evaluation, which is the first step."""
        count, size = f_struct.shape[0], y.shape[0]
        dtype = f_struct.dtype
        # NumPy is used, because outside a program each operation of JAX is compiled separately.
        zeros = functools.partial(np.zeros, dtype=dtype)
        blank = {
            "residual": zeros(count),
            "jacobian": options.get("jacobian", zeros((count, size))),
            "factor": np.eye(size, dtype=dtype),
            "projected": zeros(size),
            "cost": np.full((), np.inf, dtype),
            "scale": zeros(size),
            "damping": np.full((), 1e-3, dtype),
            "growth": np.full((), 4.0, dtype),
            "step": zeros(size),
            "accepted": np.zeros((), bool),
            "detour": zeros(size),
            "finite": np.zeros((), bool),
            "aux": jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), aux_struct),
            "evaluations": np.zeros((), jnp.result_type(int)),
        }
        return MarquardtState(**jax.device_put(blank))

    def step(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        state: MarquardtState,
        tags: frozenset[object],
    ) -> tuple[Array, MarquardtState, Any]:
        """Try one step. The first step evaluates the initial point."""
        trial = self.propose(y, options, state)
        if "linearise" in options:
            there = options["linearise"](trial, args)
        else:
            there = _linearise(fn, trial, args)
        y, state = self.judge(y, options, state, trial, there)
        return y, state, state.aux

    def trials(
        self,
        y: Array,
        linearise: Callable[[Array], Linearised],
        options: dict[str, Any],
        blank: tuple[Array, Any],
    ) -> Iterator[tuple[Array, MarquardtState, optx.RESULTS | None]]:
        """Try steps from a point one after the other on the host. The first one evaluates it.

        Arguments:
            y: initial point.
            linearise: the option of this name, as a function of the point alone.
            options: the other options of `step`.
            blank: residual and auxiliary output whose values are not used.

        Yields:
            After each step, the point, the state, and how the solver ended, or None if it
            continues.
        """
        options = {**options, "linearise": lambda there, _: linearise(there)}
        state = self.init(_not_called, y, None, options, *blank, frozenset())
        while True:
            y, state, _ = self.step(_not_called, y, None, options, state, frozenset())
            over, how = self.terminate(_not_called, y, None, options, state, frozenset())
            yield y, state, how if bool(over) else None
            if bool(over):
                return

    def propose(self, y: Array, options: dict[str, Any], state: MarquardtState) -> Array:
        """Return the next point to evaluate, which is the initial point at first."""
        step = self._step_from(y, options, state, state.factor, state.projected)
        step = jnp.where(jnp.any(state.detour != 0), state.detour, step)
        # The point lies exactly on the bound, without rounding.
        lower, upper = _bounds(y, options)
        return jnp.where(jnp.isinf(state.cost), y, jnp.clip(y + step, lower, upper))

    def _step_from(
        self, y: Array, options: dict[str, Any], state: MarquardtState, factor: Array, at: Array
    ) -> Array:
        """Return the damped step within the box, for a linear model of the residual at a point."""
        active = options.get("active", jnp.ones(y.shape, bool))
        lower, upper = _bounds(y, options)
        weights = jnp.sqrt(state.damping) * jnp.where(state.scale > 0, state.scale, 1)
        box = towards(lower - y, -self.largest_step), towards(upper - y, self.largest_step)
        return boxed_step(factor, at, weights, box, active)

    def judge(
        self,
        y: Array,
        options: dict[str, Any],
        state: MarquardtState,
        trial: Array,
        there: Linearised,
    ) -> tuple[Array, MarquardtState]:
        """Move to a trial point with the results of `linearise` at this point, or stay."""
        first = jnp.isinf(state.cost)
        active = options.get("active", jnp.ones(y.shape, bool))
        residual, jacobian, factor, projected, aux = there
        step = trial - y
        factor = jnp.where(active[None], factor, 0)
        cost = jnp.sum(residual**2) / 2
        leaves = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(jacobian)]
        # Derivatives may be finite, but so large that their squares are not.
        finite = jnp.isfinite(cost) & jnp.all(jnp.stack(leaves))
        finite = finite & jnp.isfinite(jnp.sum(factor**2))

        linear = state.projected + state.factor @ step
        expected = (jnp.sum(state.projected**2) - jnp.sum(linear**2)) / 2
        # The linear model may predict no gain for a step that the box has bent. Then only a lower
        # cost is required.
        gain = jnp.where(first, 1, state.cost - cost)
        ratio = jnp.where(first, 1, gain / jnp.where(expected > 0, expected, jnp.inf))
        # For a detour only a lower cost is required, because the linear model is not valid that
        # far.
        roundabout = jnp.any(state.detour != 0)
        accepted = finite & (gain > 0) & ((ratio > 1e-4) | (expected <= 0) | roundabout)

        # Nielsen's rule: a good step lowers the damping smoothly, and failures raise it
        # increasingly fast. After a recent failure the damping decreases only a little, because
        # failures would recur.
        least = jnp.where(state.accepted | ~state.finite, *_SHRINKS)
        shrink = jnp.clip(1 - (2 * ratio - 1) ** 3, least, 2.0)
        moved = MarquardtState(
            residual=residual,
            jacobian=jacobian,
            factor=factor,
            projected=projected,
            cost=cost,
            scale=jnp.maximum(state.scale, jnp.linalg.norm(factor, axis=0)),
            damping=jnp.where(first | roundabout, state.damping, state.damping * shrink),
            growth=jnp.asarray(4.0, y.dtype),
            step=step,
            accepted=jnp.asarray(True),
            detour=jnp.zeros_like(step),
            finite=finite,
            aux=aux,
            evaluations=state.evaluations + 1,
        )
        # A step along a curved valley leaves its floor. Before a shorter step is tried, the linear
        # model at the end of the step is used to continue to a point with a lower cost than the
        # first.
        onward = self._step_from(trial, options, state, factor, projected)
        detours = finite & ~roundabout & ~first & (state.growth == 4)
        stayed = eqx.tree_at(
            lambda s: (s.damping, s.growth, s.step, s.accepted, s.detour, s.finite, s.evaluations),
            state,
            (
                jnp.where(detours, state.damping, jnp.maximum(state.damping, 1e-8) * state.growth),
                jnp.where(detours, state.growth, state.growth * 2),
                step,
                jnp.asarray(False),
                jnp.where(detours, step + onward, 0),
                finite,
                state.evaluations + 1,
            ),
        )
        state = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), moved, stayed)
        return jnp.where(accepted, trial, y), state

    def terminate(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        state: MarquardtState,
        tags: frozenset[object],
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Return whether the solver has converged or is stuck."""
        near = self.explainable_norm(y, options, state) <= self.distance * residual_scale(state)
        # With data without noise, no step could lower the cost further.
        perfect = state.cost <= self.floor
        tiny = jnp.all(jnp.abs(state.step) <= self.atol + self.rtol * jnp.abs(y))
        tiny = tiny & (state.evaluations > 1)
        # A step that is tiny because of damping, or that was rejected, does not indicate an
        # optimum.
        settled = tiny & state.accepted & (state.damping < 1)
        evaluated = jnp.isfinite(state.cost)
        converged = evaluated & (near | perfect | settled)
        stuck = (tiny & ~settled) | ((state.evaluations > 0) & ~evaluated)
        result = optx.RESULTS.where(
            converged | ~stuck, optx.RESULTS.successful, optx.RESULTS.nonlinear_divergence
        )
        return converged | stuck, result

    def explainable_norm(
        self, y: Any, options: dict[str, Any], state: MarquardtState, maths: Any = jnp
    ) -> Any:
        """Return the norm of the residual that parameters could still explain, to first order.

        Directions without any response (held or collinear parameters) are excluded, because Q is
        arbitrary there. Coordinates with a response below the permitted distance from the optimum,
        such as those that tend to infinity, are excluded, because they would never stop. So are
        coordinates at a bound that would only leave it outwards. NumPy is used if all arrays are
        NumPy arrays.
        """
        lower, upper = _bounds(y, options)
        uphill = state.factor.T @ state.projected
        outwards = ((y <= lower) & (uphill > 0)) | ((y >= upper) & (uphill < 0))
        scale = maths.where(state.scale > 0, state.scale, 1)
        norms = maths.linalg.norm(state.factor, axis=0)
        moves = (norms > self.distance * residual_scale(state)) & ~outwards
        scaled = maths.where(moves[None], state.factor / scale[None], 0)
        left, singular, _ = maths.linalg.svd(scaled)
        along = left.T @ state.projected
        return maths.linalg.norm(maths.where(singular > 1e-8 * maths.max(singular), along, 0))

    def postprocess(
        self,
        fn: Callable,
        y: Array,
        aux: Any,
        args: Any,
        options: dict[str, Any],
        state: MarquardtState,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Array, Any, dict[str, Any]]:
        """Return the point and the auxiliary output unchanged."""
        return y, aux, {"cost": state.cost, "evaluations": state.evaluations}


def _not_called(y: Any, args: Any) -> Any:
    """Placeholder for the function if the options contain `linearise`."""
    raise NotImplementedError


def _bounds(y: Array, options: dict[str, Any]) -> tuple[Array, Array]:
    """Return the bounds of the parameters, infinite if the options contain none."""
    unbounded = np.full(y.shape, np.inf, y.dtype)
    return options.get("lower", -unbounded), options.get("upper", unbounded)


def with_jacobian(
    function: Callable[[Array], tuple[Array, Any]], at: Array
) -> tuple[Array, Array, Any]:
    """Return value, Jacobian and auxiliary output from one vmapped jvp with a shared primal."""

    def push(tangent: Array) -> tuple[Array, Array, Any]:
        return jax.jvp(function, (at,), (tangent,), has_aux=True)

    return jax.vmap(push, out_axes=(None, 1, None))(jnp.eye(at.shape[0], dtype=at.dtype))


def _linearise(fn: Callable, y: Array, args: Any) -> Linearised:
    """Return residual, Jacobian, R, Q^T r and auxiliary output."""
    residual, jacobian, aux = with_jacobian(lambda y: fn(y, args), y)
    q, r = jnp.linalg.qr(jnp.where(jnp.isfinite(jacobian), jacobian, 0))
    return residual, jacobian, r, q.T @ residual, aux
