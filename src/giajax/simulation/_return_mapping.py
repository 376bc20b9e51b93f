"""The return mapping of what slides, at the end of each step of any integration method."""

import dataclasses
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..mechanics.arm import touch
from ..runtime.arrays import Array, Bool, Float
from ._motion import State


def turns(
    step: Any, y0: Float[Array, "row joint"], y1: Float[Array, "row joint"]
) -> tuple[Bool[Array, " joint"], Float[Array, " joint"]]:
    """Which joints turn round in a step (s), and after which part of it; 1 for those that do not.

    By the cubic through angles (rad) and rates (rad/s), the first two rows of the states at both
    ends. Where a joint turns, the equation of joints with memory has a corner.
    """
    a, b, v0, v1 = slopes(step, y0, y1)
    does = v0 * v1 < 0
    # The root between 0 and 1, where the slope has the sign of v0 before and of v1 after it.
    root = jnp.sqrt(jnp.where(does, b * b - a * v0, 1))
    part = jnp.clip(v0 / jnp.where(does, -b + jnp.sign(v0) * root, 1), 0, 1)
    return does, jnp.where(does, part, 1)


def angle_after(
    part: Float[Array, " joint"], step: Any, y0: Float[Array, "row joint"], y1: Any
) -> Float[Array, " joint"]:
    """Angles (rad) after a part of a step; arguments as of `turns`."""
    a, b, v0, _ = slopes(step, y0, y1)
    return y0[0] + part * (v0 + part * (b + part * a / 3))


def slopes(step: Any, y0: Any, y1: Any) -> tuple[Array, Array, Array, Array]:
    """Of the cubic, by the part x of the step: its slope is v0 + 2 b x + a x^2, and v1 at 1."""
    moved, v0, v1 = y1[0] - y0[0], step * y0[1], step * y1[1]
    return 3 * (v0 + v1 - 2 * moved), 3 * moved - 2 * v0 - v1, v0, v1


# State of the method inside, and whether a joint turned round in the last step.
Carried = tuple[Any, Bool[Array, ""]]


def with_return_mapping(
    solver: diffrax.AbstractAdaptiveSolver, rtol: Any, atol: Any, derivatives: str
) -> "_ReturnMapping":
    """A method whose steps end with the return mapping of what slides.

    Methods that iterate take over the tolerances of a step.
    """
    # diffrax does both for a method that it sees.
    if isinstance(solver, diffrax.AbstractRungeKutta) and derivatives == "forward":
        solver = dataclasses.replace(solver, scan_kind="lax")
    if isinstance(solver, diffrax.AbstractImplicitSolver):
        solver = eqx.tree_at(lambda s: s.root_finder, solver, diffrax.VeryChord(rtol, atol))
    return _ReturnMapping(solver)


class _ReturnMapping(diffrax.AbstractAdaptiveSolver):
    """A method whose steps end with the return mapping of the joints' sliding elements.

    Within a step the angles at which elements are without strain are held, and their torques
    follow the angles of the joints, limited: in a motion in one direction that is exact. At its
    end they catch up with the joints (Moreau's sweeping process; the return mapping of
    plasticity), first with the angle at which a joint turned round on its way. What that changes
    the torques did not know, and counts as an error of the step. The skin of links that slide
    along an obstacle catches up in the same way.

    Reference: J. C. Simo, T. J. R. Hughes, Computational Inelasticity, Springer 1998, chapter 1.
    """

    solver: diffrax.AbstractAdaptiveSolver

    @property
    def term_structure(self) -> Any:
        return self.solver.term_structure

    @property
    def interpolation_cls(self) -> Any:  # type: ignore[override]
        return self.solver.interpolation_cls

    @property
    def term_compatible_contr_kwargs(self) -> Any:
        return self.solver.term_compatible_contr_kwargs

    def order(self, terms: Any) -> int | None:
        return self.solver.order(terms)

    def strong_order(self, terms: Any) -> Any:
        return self.solver.strong_order(terms)

    def error_order(self, terms: Any) -> Any:
        return self.solver.error_order(terms)

    def init(self, terms: Any, t0: Any, t1: Any, y0: State, args: Any) -> Carried:
        return self.solver.init(terms, t0, t1, y0, args), jnp.asarray(False)

    def func(self, terms: Any, t0: Any, y0: State, args: Any) -> State:
        return self.solver.func(terms, t0, y0, args)

    def step(
        self,
        terms: Any,
        t0: Any,
        t1: Any,
        y0: State,
        args: Any,
        solver_state: Carried,
        made_jump: Any,
    ) -> tuple[State, State, Any, Carried, Any]:
        inner, turned = solver_state
        # The slope that the method carries over is that before the return mapping.
        y1, y_error, dense, inner, result = self.solver.step(
            terms, t0, t1, y0, args, inner, made_jump | turned
        )
        laws = args.arm.joints.further_laws
        last = 2 + laws.rows
        held = y1[2:last]
        direct = laws.return_mapped(y1[0], held)
        extreme = _extreme(t1 - t0, y0, y1)
        memory = laws.return_mapped(y1[0], laws.return_mapped(extreme, held))
        unknown = jax.lax.stop_gradient(memory - direct)
        y1 = jnp.concatenate([y1[:2], memory, y1[last:]])
        y1 = _slid(args, y1)
        assert y_error is not None
        y_error = y_error.at[2:last].add(unknown)
        return y1, y_error, dense, (inner, jnp.any(unknown != 0)), result


def _slid(args: Any, state: State) -> State:
    """The state with the skin of links stretched no further than friction holds it."""
    contact, parts = args.arm.contact, args.parts(state)
    if contact is None or not parts.skin.size:
        return state
    met = touch(args.arm, parts.angles, parts.rates, parts.skin)
    return state.at[-contact.rows :].set(contact.hold(parts.skin, met.normal))


def _extreme(step: Any, y0: State, y1: State) -> Array:
    """The angles (rad) at which joints turned round in a step; those at its end of the others."""
    does, part = turns(step, y0, y1)
    return jnp.where(does, angle_after(part, step, y0, y1), y1[0])
