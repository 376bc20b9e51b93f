"""Integration methods by name."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from .._errors import InputError
from ._springs import pull, springs

if TYPE_CHECKING:
    from diffrax import AbstractAdaptiveSolver


def _of_diffrax(name: str) -> "AbstractAdaptiveSolver":
    # Slow to import, and needed only where a program is traced.
    import diffrax

    solver: AbstractAdaptiveSolver = getattr(diffrax, name)()
    return solver


def _springs5(reverse: bool = True) -> "AbstractAdaptiveSolver":
    from ._linearly_implicit import LinearlyImplicit

    return LinearlyImplicit(springs, pull, reverse)


SOLVERS: dict[str, Callable[[], "AbstractAdaptiveSolver"]] = {
    "tsit5": partial(_of_diffrax, "Tsit5"),
    "dopri5": partial(_of_diffrax, "Dopri5"),
    "dopri8": partial(_of_diffrax, "Dopri8"),
    "bosh3": partial(_of_diffrax, "Bosh3"),
    "heun": partial(_of_diffrax, "Heun"),
    "springs5": _springs5,
    "kvaerno3": partial(_of_diffrax, "Kvaerno3"),
    "kvaerno5": partial(_of_diffrax, "Kvaerno5"),
}
"""Explicit methods, then the one that is implicit in the joints' springs and dampers alone, the
fastest of all where they are stiff, then fully implicit ones."""


def solver(name: str, *, reverse: bool = True) -> "AbstractAdaptiveSolver":
    """The solver of a name.

    Arguments:
        name: one of `SOLVERS`.
        reverse: whether its steps are to be differentiated in reverse mode.

    Raises:
        InputError: there is no such solver.
    """
    if name not in SOLVERS:
        raise InputError(f"there is no solver '{name}': use one of {', '.join(SOLVERS)}")
    return _springs5(reverse) if name == "springs5" else SOLVERS[name]()
