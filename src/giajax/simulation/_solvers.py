"""Integration methods by name."""

import diffrax

from .._errors import InputError

SOLVERS: dict[str, type[diffrax.AbstractAdaptiveSolver]] = {
    "tsit5": diffrax.Tsit5,
    "dopri5": diffrax.Dopri5,
    "dopri8": diffrax.Dopri8,
    "bosh3": diffrax.Bosh3,
    "heun": diffrax.Heun,
    "kvaerno3": diffrax.Kvaerno3,
    "kvaerno5": diffrax.Kvaerno5,
}
"""Explicit methods, then the implicit ones, which stiff arms may need."""


def solver(name: str) -> diffrax.AbstractAdaptiveSolver:
    """The diffrax solver of a name.

    Raises:
        InputError: there is no such solver.
    """
    if name not in SOLVERS:
        raise InputError(f"there is no solver '{name}'; use one of: {', '.join(SOLVERS)}")
    return SOLVERS[name]()
