"""A Marquardt-scaled trust region behind optimistix's interface.

optimistix's Levenberg-Marquardt damps with a multiple of the identity and pays for the Jacobian
more than once a step; on the paper's arm it needs 36 to 45 steps. Here the damping is scaled by
the norms of the Jacobian's columns (Marquardt 1963; More 1978), and one vmapped jvp gives value
and Jacobian of the trial point together, so that an accepted step costs one evaluation.
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
    """State between two steps; `residual`, `jacobian` and the like are those of the accepted point.

    Attributes:
        jacobian: whatever `linearise` gives.
        factor, projected: R and Q^T r of the Jacobian's QR factorisation.
        cost: half the squared norm of the residual; infinite before the first evaluation.
        scale: largest norm of each column so far, which scales the damping.
        damping: Marquardt's lambda; `growth` is what the next rejection multiplies it by.
        step: last accepted or rejected step.
        detour: the step to try next in place of a shorter one; 0 where there is none.
        finite: whether everything was finite where the last step led to.
        evaluations: how often value and Jacobian were computed.
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
    """The root of the reduced chi-square: the noise that the residual itself shows."""
    size = state.residual.shape[0] - state.projected.shape[0]
    return (2 * state.cost / max(size, 1)) ** 0.5


# How often coordinates that leave the box are put on its sides, those that want to come back let
# go, and the rest solved anew; and how often all of them at once.
_SIDES, _AT_ONCE = 40, 6

# A bound is reached from near it: farther off a step covers this part of the way at most.
_AT_HAND, _WAY = 0.1, 0.9


def towards(bound: Float[Array, " parameter"], most: float) -> Float[Array, " parameter"]:
    """How far a step of at most `most` may go towards bounds; the way is negative downwards."""
    way = jnp.where(jnp.abs(bound) > _AT_HAND, _WAY * bound, bound)
    return jnp.clip(way, -abs(most), abs(most))


class _Sides(NamedTuple):
    """Which coordinates are held on which side of the box, and the step with them there."""

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
    """The step s that minimises |R s + Q^T r|^2 + |D s|^2 over a box; D is positive.

    By block principal pivoting (Kim and Park 2011): coordinates that want to leave the box stay on
    its side, the others are solved for again, and those that then want to come back are let go. To
    shorten the whole step would let one weak parameter hold up all of them.

    Arguments:
        factor, projected: R and Q^T r of the Jacobian's QR factorisation.
        damping: D.
        box: the lowest (at most 0) and the highest (at least 0) step of each coordinate.
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
        # All at once is quick, and may go round in circles; one by one, by place, does not.
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


# By what a step may lower the damping at most: one after another, and after one that was refused.
_SHRINKS = 0.05, 0.33


class Marquardt(optx.AbstractLeastSquaresSolver):
    """Least squares by a trust region; a trial point that fails is a rejected step.

    `fn(y, args)` takes one array of parameters and returns one array of residuals and auxiliary
    output, and must be differentiable in forward mode. A trial point whose residual or Jacobian
    is not finite is rejected, and the step shrinks.

    Options (of `optimistix.least_squares`):
        `active`: a boolean array: parameters that may move.
        `lower`, `upper`: arrays of bounds, which a trial point may lie on; infinite by default.
        `linearise`: a function of `(y, args)` that returns residual, Jacobian (any pytree), R and
        Q^T r of its QR factorisation, and the auxiliary output, for problems with a structure;
        `fn` is then not called. `jacobian` is a template of the pytree.

    Arguments:
        rtol, atol: a step that changes no parameter by more than `atol + rtol |y|` is the last:
            converged when it was taken undamped, stuck otherwise.
        distance: converged when the full Gauss-Newton step would change the parameters by less
            than this many standard errors (with the noise that the residual itself shows).
        floor: converged when the cost is not above this.
        largest_step: no coordinate moves by more than this in one step. Where coordinates are
            logarithms it keeps a trial point within a factor, so that an early, poor model of
            the cost does not send a parameter to its bound or a chain into stiffness.
        norm: unused by this solver; required by optimistix.
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
        """State before the first evaluation, which is the first step."""
        count, size = f_struct.shape[0], y.shape[0]
        dtype = f_struct.dtype
        # By numpy: outside a program each operation of JAX is one, and compiled by itself.
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
        """Try one step; the first one evaluates the start."""
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
        """The steps from a point, tried one after the other on the host; the first evaluates it.

        Arguments:
            y: where to begin.
            linearise: the option of this name, as a function of the point alone.
            options: the others, as `step` has them.
            blank: a residual and auxiliary output, whose values do not count.

        Yields:
            After each step the point, the state there, and how it ended; None where it goes on.
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
        """The point to evaluate next; before the first evaluation, the one where it is."""
        step = self._step_from(y, options, state, state.factor, state.projected)
        step = jnp.where(jnp.any(state.detour != 0), state.detour, step)
        # Exactly on the bound, not beside it by rounding.
        lower, upper = _bounds(y, options)
        return jnp.where(jnp.isinf(state.cost), y, jnp.clip(y + step, lower, upper))

    def _step_from(
        self, y: Array, options: dict[str, Any], state: MarquardtState, factor: Array, at: Array
    ) -> Array:
        """The damped step within the box, by a linear model of the residual at a point."""
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
        """Go to a trial point, at which `linearise` gave what is there, or stay."""
        first = jnp.isinf(state.cost)
        active = options.get("active", jnp.ones(y.shape, bool))
        residual, jacobian, factor, projected, aux = there
        step = trial - y
        factor = jnp.where(active[None], factor, 0)
        cost = jnp.sum(residual**2) / 2
        leaves = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(jacobian)]
        # Derivatives may be finite and yet so large that their squares are not.
        finite = jnp.isfinite(cost) & jnp.all(jnp.stack(leaves))
        finite = finite & jnp.isfinite(jnp.sum(factor**2))

        linear = state.projected + state.factor @ step
        expected = (jnp.sum(state.projected**2) - jnp.sum(linear**2)) / 2
        # A step that the box has bent may promise nothing; then only a lower cost counts.
        gain = jnp.where(first, 1, state.cost - cost)
        ratio = jnp.where(first, 1, gain / jnp.where(expected > 0, expected, jnp.inf))
        # Of a detour only a lower cost counts: the linear model does not hold so far.
        roundabout = jnp.any(state.detour != 0)
        accepted = finite & (gain > 0) & ((ratio > 1e-4) | (expected <= 0) | roundabout)

        # Nielsen's rule: a good step lowers the damping smoothly, failures raise it ever faster.
        # Where they just did, a little: they would only come again.
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
        # A step along a valley that bends leaves its floor. Before a shorter one it is tried
        # whether the linear model where it led goes on to a cost that is lower than at first.
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
        """Converged, stuck, or neither."""
        near = self.explainable_norm(y, options, state) <= self.distance * residual_scale(state)
        # Data without noise: nothing is left that a step could lower.
        perfect = state.cost <= self.floor
        tiny = jnp.all(jnp.abs(state.step) <= self.atol + self.rtol * jnp.abs(y))
        tiny = tiny & (state.evaluations > 1)
        # A step that is tiny because it is damped, or was rejected, says nothing of an optimum.
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
        """Norm of the part of the residual that the parameters could still explain, to first order.

        Directions in which nothing responds (held or collinear parameters) do not count: there Q is
        arbitrary. Nor do coordinates to which the residual responds by no more than what a fit may
        be off by, as on their way to infinity: they would run on for ever; nor those that are at a
        bound and would only leave it outwards. By NumPy where all is of its arrays.
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
        """Nothing is left to do."""
        return y, aux, {"cost": state.cost, "evaluations": state.evaluations}


def _not_called(y: Any, args: Any) -> Any:
    """Stands for the function where the options have `linearise`."""
    raise NotImplementedError


def _bounds(y: Array, options: dict[str, Any]) -> tuple[Array, Array]:
    """Bounds of the parameters, infinite where the options have none."""
    unbounded = np.full(y.shape, np.inf, y.dtype)
    return options.get("lower", -unbounded), options.get("upper", unbounded)


def with_jacobian(
    function: Callable[[Array], tuple[Array, Any]], at: Array
) -> tuple[Array, Array, Any]:
    """Value, Jacobian and auxiliary output from one vmapped jvp, which shares the primal."""

    def push(tangent: Array) -> tuple[Array, Array, Any]:
        return jax.jvp(function, (at,), (tangent,), has_aux=True)

    return jax.vmap(push, out_axes=(None, 1, None))(jnp.eye(at.shape[0], dtype=at.dtype))


def _linearise(fn: Callable, y: Array, args: Any) -> Linearised:
    """Residual and Jacobian; R, Q^T r; aux."""
    residual, jacobian, aux = with_jacobian(lambda y: fn(y, args), y)
    q, r = jnp.linalg.qr(jnp.where(jnp.isfinite(jacobian), jacobian, 0))
    return residual, jacobian, r, q.T @ residual, aux
