"""Keys of sections that are made from the declarations of quantities."""

from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import Field, create_model

from ..quantities import Declaration, Group, Key
from ._section import Finite, Section, key

S = TypeVar("S", bound=Section)

_COUNTS = {2: "two", 3: "three", 5: "five"}


def with_keys(*groups: Group, required: bool = False) -> Callable[[type[S]], type[S]]:
    """Class decorator: the section, with the keys of these groups after its own.

    A quantity without a key in files is left out; several that share a key are a list there.

    Arguments:
        groups: of quantities, in the order of their keys.
        required: whether a section must have those that are not optional, as an entry of a list
            does, which describes one thing; the optional ones are 0 there.
    """

    def decorate(section: type[S]) -> type[S]:
        sharing: dict[str, tuple[Declaration, ...]] = {}
        for group in groups:
            for declaration in group:
                if declaration.key is not None:
                    others = sharing.get(declaration.key.name, ())
                    # Laws that share a key have it in one place; the first one's default shows.
                    new = not others or declaration.path not in {d.path for d in others}
                    sharing[declaration.key.name] = (*others, declaration) if new else others
        fields: dict[str, Any] = {
            name: _entry(*parts) if required else _optional(parts)
            for name, parts in sharing.items()
        }
        extended = create_model(
            section.__name__,
            __base__=section,
            __module__=section.__module__,
            __doc__=section.__doc__,
            **fields,
        )
        extended.quantities = {**section.quantities, **sharing}
        return extended

    return decorate


def _optional(parts: tuple[Declaration, ...]) -> tuple[Any, Any]:
    """Type and field of a key that a file may leave out."""
    declaration, about = parts[0], _key(parts[0])
    shared = about.place is not None
    default = [_shown(part) for part in parts] if shared else _shown(declaration)
    if shared or declaration.shape:
        length = len(default)
        kind: Any = Annotated[list[Finite], Field(min_length=length, max_length=length)]
        must = f"a list of {_COUNTS[length]} numbers"
    else:
        kind, must = _number(declaration), _sentence(declaration)
        if declaration.per:
            kind, must = kind | list[kind], f"{must} or a list of them, one a {declaration.per}"
    example = default if about.example is None else about.example
    preset = None if declaration.optional else default
    meaning = about.meaning or declaration.doc
    return kind | None, key(must + about.remark, meaning, preset=preset, example=example)


def _entry(declaration: Declaration) -> tuple[Any, Any]:
    """Type and field of a key that an entry of a list must have."""
    default = 0.0 if declaration.optional else ...
    field = key(_sentence(declaration), declaration.doc, default=default)
    return _number(declaration), field


def _key(declaration: Declaration) -> Key:
    assert declaration.key is not None
    return declaration.key


def _shown(declaration: Declaration) -> Any:
    """The default in the unit of the key, without the last digits of a conversion."""
    value = float(f"{declaration.default / declaration.factor:.12g}")
    return [value] * declaration.shape[0] if declaration.shape else value


def _range(declaration: Declaration) -> tuple[float, float]:
    """What a file may state, in the unit of the key."""
    about = _key(declaration)
    lower = declaration.lower if about.lower is None else about.lower
    upper = declaration.upper if about.upper is None else about.upper
    return lower / declaration.factor, upper / declaration.factor


def _number(declaration: Declaration) -> Any:
    lower, upper = _range(declaration)
    above, below = ("ge", "le") if _key(declaration).closed else ("gt", "lt")
    about: dict[str, Any] = {"allow_inf_nan": False}
    about |= {name: end for name, end in ((above, lower), (below, upper)) if np.isfinite(end)}
    return Annotated[float, Field(**about)]


def _sentence(declaration: Declaration) -> str:
    """What a number must be."""
    (lower, upper), closed = _range(declaration), _key(declaration).closed
    if np.isfinite(lower) and np.isfinite(upper):
        between = ("from", "to") if closed else ("between", "and")
        return f"a number {between[0]} {lower:.3g} {between[1]} {upper:.3g}"
    if np.isfinite(upper):
        return f"a number {'of at most' if closed else 'below'} {upper:.3g}"
    if lower == 0:
        return "zero or a positive number" if closed else "a positive number"
    if np.isfinite(lower):
        return f"a number {'of at least' if closed else 'above'} {lower:.3g}"
    return "a number"
