"""Methods of integration by name; diffrax is imported only where one is looked at.

A process whose programs are all kept never needs it, and its import takes a tenth of a second.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Union

import equinox as eqx

from ..runtime.solvers import from_text
from ..runtime.text import InputError

if TYPE_CHECKING:
    import diffrax

Solver = Union[str, "diffrax.AbstractSolver[Any]"]
"""One of `SOLVERS`, a text such as "Kvaerno4()", or what that describes."""


def _springs5(reverse: bool = True) -> "diffrax.AbstractAdaptiveSolver":
    from ._linearly_implicit import LinearlyImplicit
    from ._motion import pull, springs

    return LinearlyImplicit(springs, pull, reverse=reverse)


SOLVERS: dict[str, Callable[[], "diffrax.AbstractAdaptiveSolver"]] = {
    "tsit5": partial(from_text, "Tsit5()"),
    "dopri5": partial(from_text, "Dopri5()"),
    "dopri8": partial(from_text, "Dopri8()"),
    "bosh3": partial(from_text, "Bosh3()"),
    "heun": partial(from_text, "Heun()"),
    "springs5": _springs5,
    "kvaerno3": partial(from_text, "Kvaerno3()"),
    "kvaerno5": partial(from_text, "Kvaerno5()"),
}
"""Explicit methods, then the one that is implicit in the joints' springs and dampers alone, the
fastest of all where they are stiff, then fully implicit ones."""


def solver(named: Solver, *, reverse: bool = True) -> "diffrax.AbstractSolver[Any]":
    """The method that is named, to be differentiated in reverse mode or not.

    Raises:
        InputError: there is no such name, or it is not for ordinary differential equations.
    """
    import diffrax

    if isinstance(named, str) and named in SOLVERS:
        return _springs5(reverse) if named == "springs5" else SOLVERS[named]()
    method: Any = named
    if isinstance(named, str) and "(" in named:
        method = from_text(named)
    # A solver around what is none has no terms.
    if not (isinstance(method, diffrax.AbstractSolver) and hasattr(method, "term_structure")):
        raise InputError(
            f"there is no solver '{named}': use one of {', '.join(SOLVERS)}, or one of diffrax, "
            "such as Kvaerno4()"
        )
    if method.term_structure is not diffrax.AbstractTerm:
        raise InputError(
            f"{type(method).__name__} is for stochastic or split equations, but the equations of "
            f"motion of an arm are neither"
            ": give another solver, such as Tsit5()"
        )
    return method


def check_method(named: Solver, controller: object = None) -> None:
    """Refuse (`InputError`) a solver, or a controller of its steps, that no arm moves by."""
    if controller is None and isinstance(named, str) and named in SOLVERS:
        return
    import diffrax

    method = solver(named)
    fixed, name = isinstance(controller, diffrax.StepTo), type(method).__name__
    adaptive = controller is None or isinstance(
        controller, diffrax.AbstractAdaptiveStepSizeController
    )
    if not (fixed or adaptive):
        raise InputError(
            f"the step size controller is {type(controller).__name__}, which does not choose step "
            f"sizes"
            ": give diffrax.StepTo(ts=...), or an adaptive one such as diffrax.PIDController"
        )
    if adaptive and not isinstance(method, diffrax.AbstractAdaptiveSolver):
        raise InputError(
            f"{name} does not estimate the error of a step, which an adaptive step size requires: "
            f"give "
            f"diffrax.HalfSolver({name}()), or stepsize_controller=diffrax.StepTo(ts=...)"
        )
    if fixed and isinstance(method, diffrax.AbstractImplicitSolver):
        of_controller = diffrax.ImplicitEuler().root_finder.rtol  # what stands for that
        if method.root_finder.rtol is of_controller:
            raise InputError(
                f"{name} takes the tolerances of its equations from an adaptive controller, but "
                f"StepTo has none: give the solver"
                " root_finder=diffrax.VeryChord(rtol=1e-8, atol=1e-8)"
            )
    if adaptive and controller is not None:
        with_tolerances(controller, 0.0, 0.0)


def with_tolerances(controller: Any, rtol: Any, atol: Any) -> Any:
    """A controller with other tolerances, which may be those of one within it."""
    held = vars(controller)
    if {"rtol", "atol"} <= held.keys():
        return dataclasses.replace(controller, rtol=rtol, atol=atol)
    if "controller" in held:
        inner = with_tolerances(held["controller"], rtol, atol)
        return eqx.tree_at(lambda outer: outer.controller, controller, inner)
    raise InputError(
        f"the step size controller {type(controller).__name__} has no fields rtol and atol, which "
        f"a fit or a caller sets: add both fields"
        ", or diffrax.PIDController(rtol=..., atol=...)"
    )
