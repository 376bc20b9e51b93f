"""Integration methods by name; diffrax is imported only when a method is required.

A process with only cached programs never requires diffrax, whose import takes a tenth of a second.
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
"""One of `SOLVERS`, a text such as "Kvaerno4()", or the solver that such a text describes."""


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
"""Integration methods by name: explicit methods, `springs5`, and fully implicit methods.

`springs5` is implicit only in the springs and dampers of the joints, and is the fastest if they are
stiff.
"""


def solver(named: Solver, *, reverse: bool = True) -> "diffrax.AbstractSolver[Any]":
    """Return the named method; `reverse` selects support of reverse-mode differentiation.

    Raises:
        InputError: there is no such name, or the method is not for ordinary differential equations.
    """
    import diffrax

    if isinstance(named, str) and named in SOLVERS:
        return _springs5(reverse) if named == "springs5" else SOLVERS[named]()
    method: Any = named
    if isinstance(named, str) and "(" in named:
        method = from_text(named)
    # A wrapper around an object that is not a solver has no terms.
    if not (isinstance(method, diffrax.AbstractSolver) and hasattr(method, "term_structure")):
        raise InputError(
            f"there is no solver '{named}': use one of {', '.join(SOLVERS)}, or a diffrax "
            "solver such as Kvaerno4()"
        )
    if method.term_structure is not diffrax.AbstractTerm:
        raise InputError(
            f"{type(method).__name__} is for stochastic or split equations, but the equations of "
            "motion of an arm are neither: give another solver, such as Tsit5()"
        )
    return method


def check_method(named: Solver, controller: object = None) -> None:
    """Reject (`InputError`) a solver or a step-size controller that cannot be used for an arm."""
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
            "sizes: give diffrax.StepTo(ts=...), or an adaptive controller such as "
            "diffrax.PIDController"
        )
    if adaptive and not isinstance(method, diffrax.AbstractAdaptiveSolver):
        raise InputError(
            f"{name} does not estimate the error of a step, which an adaptive step size requires: "
            f"give diffrax.HalfSolver({name}()), or stepsize_controller=diffrax.StepTo(ts=...)"
        )
    if fixed and isinstance(method, diffrax.AbstractImplicitSolver):
        of_controller = diffrax.ImplicitEuler().root_finder.rtol  # means the controller's tolerance
        if method.root_finder.rtol is of_controller:
            raise InputError(
                f"{name} takes the tolerances of its equations from an adaptive controller, but "
                "StepTo has no tolerances: give the solver "
                "root_finder=diffrax.VeryChord(rtol=1e-8, atol=1e-8)"
            )
    if adaptive and controller is not None:
        with_tolerances(controller, 0.0, 0.0)


def with_tolerances(controller: Any, rtol: Any, atol: Any) -> Any:
    """Return a controller with other tolerances, which may belong to a controller inside it."""
    held = vars(controller)
    if {"rtol", "atol"} <= held.keys():
        return dataclasses.replace(controller, rtol=rtol, atol=atol)
    if "controller" in held:
        inner = with_tolerances(held["controller"], rtol, atol)
        return eqx.tree_at(lambda outer: outer.controller, controller, inner)
    raise InputError(
        f"the step size controller {type(controller).__name__} has no fields rtol and atol, which "
        "a fit or a caller sets: add both fields, or give diffrax.PIDController(rtol=..., "
        "atol=...)"
    )
