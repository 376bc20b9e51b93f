"""Solvers of diffrax and optimistix as text in Python syntax. This module does not import JAX."""

import ast
import dataclasses
import importlib
from typing import Any

from .plugins import registered
from .process import configure, is_own_process
from .text import InputError, shown

_PACKAGES = ("diffrax", "optimistix")
_LONGEST = 1_000  # maximum length of a text


def as_text(given: Any) -> Any:
    """Return a solver or controller as text for files; other objects are returned unchanged.

    Raises:
        InputError: its class is neither from diffrax nor registered, or a field is not a number.
    """
    if not dataclasses.is_dataclass(given):
        return given
    import equinox as eqx

    text = eqx.tree_pformat(given, width=_LONGEST)
    try:
        same = bool(from_text(text) == given)
    except InputError:
        same = False
    if not same:
        raise InputError(
            f"the solver {shown(text)} cannot be stored in a file: give a diffrax solver whose "
            "fields are numbers, or call giajax.register with its class, which must have "
            'registered_as = "solver"'
        )
    return text


def from_text(text: str) -> Any:
    """Return the object that a text such as `Kvaerno5(scan_kind="lax")` describes.

    Raises:
        InputError: it does not describe an object, or there is no such class.
    """
    try:
        return _made(ast.parse(text[:_LONGEST], mode="eval").body)
    except Exception as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{shown(text)} is not a solver: write it as in Python, such as Kvaerno5(), with "
            "existing fields"
        ) from None


def _made(node: ast.expr) -> Any:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
        return ast.literal_eval(node)
    name = node.func.id
    if is_own_process():
        configure()
    modules = map(importlib.import_module, _PACKAGES)
    found = [each for module in modules if dataclasses.is_dataclass(each := vars(module).get(name))]
    cls: Any = found[0] if found else registered("solver", name)
    if cls is None:
        raise InputError(
            f"the solver {name} is unknown: give a diffrax solver, or register its class"
        )
    positional = [_made(each) for each in node.args]
    return cls(*positional, **{str(each.arg): _made(each.value) for each in node.keywords})
