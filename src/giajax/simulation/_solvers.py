"""Integration methods by name."""

from collections.abc import Callable
from functools import partial

import diffrax

from .._errors import InputError
from ._linearly_implicit import LinearlyImplicit
from ._motion import springs

SOLVERS: dict[str, Callable[[], diffrax.AbstractAdaptiveSolver]] = {
    "tsit5": diffrax.Tsit5,
    "dopri5": diffrax.Dopri5,
    "dopri8": diffrax.Dopri8,
    "bosh3": diffrax.Bosh3,
    "heun": diffrax.Heun,
    "springs5": partial(LinearlyImplicit, springs),
    "kvaerno3": diffrax.Kvaerno3,
    "kvaerno5": diffrax.Kvaerno5,
}
"""Explicit methods, then the one that is implicit in the joints' springs and dampers alone, the
fastest of all where they are stiff, then fully implicit ones."""


def solver(name: str) -> diffrax.AbstractAdaptiveSolver:
    """The solver of a name.

    Raises:
        InputError: there is no such solver.
    """
    if name not in SOLVERS:
        raise InputError(f"there is no solver '{name}': use one of {', '.join(SOLVERS)}")
    return SOLVERS[name]()
