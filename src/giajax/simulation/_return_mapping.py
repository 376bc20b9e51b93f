"""Return mapping of rate-independent states at the end of each step of any integration method."""

import dataclasses
from typing import Any

import diffrax
import equinox as eqx

from ..mechanics.arm import touch
from ._motion import Inputs, State


def with_return_mapping(
    solver: diffrax.AbstractAdaptiveSolver, rtol: Any, atol: Any, derivatives: str
) -> "_ReturnMapping":
    """Return an integration method whose steps end with the return mapping of sliding states.

    Iterative methods use the tolerances of a step.
    """
    # diffrax does the following two things itself for a solver that is not wrapped.
    if isinstance(solver, diffrax.AbstractRungeKutta) and derivatives == "forward":
        solver = dataclasses.replace(solver, scan_kind="lax")
    if isinstance(solver, diffrax.AbstractImplicitSolver):
        solver = eqx.tree_at(lambda s: s.root_finder, solver, diffrax.VeryChord(rtol, atol))
    return _ReturnMapping(solver)


class _Followed(diffrax.AbstractLocalInterpolation):
    """Interpolation of a method, with the rate-independent states updated up to each time."""

    t0: Any  # type: ignore[misc]
    t1: Any  # type: ignore[misc]
    inner: diffrax.AbstractLocalInterpolation
    inputs: Inputs

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> State:
        """Return the state at one time, or its change between two times."""
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        return self.inputs.followed(t0, self.inner.evaluate(t0, left=left))


class _ReturnMapping(diffrax.AbstractAdaptiveSolver):
    """Integration method whose steps end with the return mapping of sliding states.

    Rate-independent states of joints are constant within a step. The torque at each stage is the
    torque after the path up to this stage, including a reversal of the joint (`Inputs.followed`).
    At the end of the step the states are updated (Moreau's sweeping process; the return mapping of
    plasticity). The skin of links that slide along an obstacle is updated in the same way; the
    effect of this update does not enter the step itself.

    Reference: J. C. Simo, T. J. R. Hughes, Computational Inelasticity, Springer 1998, chapter 1.
    """

    solver: diffrax.AbstractAdaptiveSolver

    @property
    def term_structure(self) -> Any:
        return self.solver.term_structure

    @property
    def interpolation_cls(self) -> Any:  # type: ignore[override]
        def interpolation(*, t0: Any, t1: Any, inputs: Inputs, **dense: Any) -> _Followed:
            return _Followed(
                t0=t0,
                t1=t1,
                inner=self.solver.interpolation_cls(t0=t0, t1=t1, **dense),
                inputs=inputs,
            )

        return interpolation

    @property
    def term_compatible_contr_kwargs(self) -> Any:
        return self.solver.term_compatible_contr_kwargs

    def order(self, terms: Any) -> int | None:
        return self.solver.order(terms)

    def strong_order(self, terms: Any) -> Any:
        return self.solver.strong_order(terms)

    def error_order(self, terms: Any) -> Any:
        return self.solver.error_order(terms)

    def init(self, terms: Any, t0: Any, t1: Any, y0: State, args: Any) -> Any:
        return self.solver.init(terms, t0, t1, y0, args)

    def func(self, terms: Any, t0: Any, y0: State, args: Any) -> State:
        return self.solver.func(terms, t0, y0, args)

    def step(
        self,
        terms: Any,
        t0: Any,
        t1: Any,
        y0: State,
        args: Any,
        solver_state: Any,
        made_jump: Any,
    ) -> Any:
        """Perform one step."""
        inputs = args
        if args.arm.further_laws.mapped:
            inputs = dataclasses.replace(args, since=(t0, y0))
        y1, y_error, dense, inner, result = self.solver.step(
            terms, t0, t1, y0, inputs, solver_state, made_jump
        )
        mapped = inputs.followed(t1, y1)
        return _slid(args, mapped), y_error, {**dense, "inputs": inputs}, inner, result


def _slid(args: Any, state: State) -> State:
    """Return the state with the stretch of the skin limited to what friction can hold."""
    contact, parts = args.arm.contact, args.parts(state)
    if contact is None or not parts.skin.size:
        return state
    met = touch(args.arm, parts.angles, parts.rates, parts.skin)
    return state.at[-contact.rows :].set(contact.hold(parts.skin, met.normal))
