"""Finding a parameter by its path, reading it, and giving it another value."""

import dataclasses
import difflib
import re
from collections.abc import Iterable

import equinox as eqx

from .._errors import InputError
from .._typing import Array
from ._walk import Parameter, declared, left_out

_PATH = re.compile(r"(?P<name>[A-Za-z_][\w.]*?)(?:\[(?P<index>[0-9]{1,9})\])?\Z", re.ASCII)


def find(model: eqx.Module, path: str) -> Parameter:
    """The parameter at a path such as `air.drag_coefficient` or `links.mass[2]`.

    Indices count from 0, as in Python.

    Raises:
        InputError: there is no such parameter (the nearest one is named), or the index is
            beyond its length.
    """
    known = declared(model)
    match = _PATH.match(path)
    name = match["name"] if match else path
    if match is None or name not in known:
        off = left_out(model)
        if name in off:
            raise InputError(
                f"'{name}' is left out of this model: give it a value to switch it on "
                f"(such as {off[name].declaration.default:g})"
            )
        raise InputError(f"there is no parameter '{path}': {_suggestion(name, [*known, *off])}")
    parameter = known[name]
    if match["index"] is None:
        return parameter
    index = int(match["index"])
    shape = parameter.value(model).shape
    if len(shape) != 1:
        raise InputError(f"'{name}' is a single number: leave out the index in '{path}'")
    if index >= shape[0]:
        raise InputError(
            f"'{path}' is beyond the {shape[0]} elements of '{name}': "
            f"indices run from 0 to {shape[0] - 1}"
        )
    return dataclasses.replace(parameter, path=path, index=index)


def elements(model: eqx.Module, path: str) -> list[Parameter]:
    """The scalar parameters that a path stands for: itself, or each element of its array."""
    parameter = find(model, path)
    shape = parameter.value(model).shape
    if shape == ():
        return [parameter]
    return [
        dataclasses.replace(parameter, path=f"{path}[{index}]", index=index)
        for index in range(shape[0])
    ]


def get(model: eqx.Module, path: str) -> Array:
    """Value of the parameter at a path."""
    return find(model, path).value(model)


def _suggestion(name: str, known: Iterable[str]) -> str:
    names = list(known)
    last = {path.rsplit(".", 1)[-1]: path for path in names}
    begun = [path for path in names if name and path.startswith(name)]
    near = (
        begun
        or difflib.get_close_matches(name, names, n=1, cutoff=0.5)
        or [
            last[match]
            for match in difflib.get_close_matches(name.rsplit(".", 1)[-1], last, n=1, cutoff=0.5)
        ]
    )
    if near:
        return f"did you mean '{near[0]}'?"
    return "'giajax parameters' lists them all"
