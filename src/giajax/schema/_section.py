"""What every section of the TOML vocabulary is made of, and its keys that declarations make."""

from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, create_model

from ..runtime.limits import ELEMENTS
from ..runtime.text import shown
from ._declaration import Declaration, Group, Key

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(min_length=1)]
Count = Annotated[int, Field(ge=1, le=ELEMENTS)]
COUNT = f"a whole number from 1 to {ELEMENTS}"


def key(
    must: str,
    meaning: str,
    *,
    preset: Any = None,
    default: Any = None,
    example: Any = None,
    entry: str = "",
) -> Any:
    """Declare a key, once for errors and templates.

    Arguments:
        must: what its value must be, for errors.
        meaning: what it means, for the template of a sidecar.
        preset: the value that a model takes where a file leaves it out, for the template.
        default: the value of the field where a file leaves it out.
        example: what the template shows where there is no preset.
        entry: what an entry of a table must be, where that is not a number or a list of them.
    """
    extra = {
        "must": must,
        "preset": preset,
        "example": preset if example is None else example,
        **({"entry": entry} if entry else {}),
    }
    return Field(default=default, description=meaning, json_schema_extra=extra)


class Section(BaseModel):
    """A section whose keys are declared by `key` or `with_keys`, and that takes no others.

    Attributes:
        quantities: the keys that are made from declarations, by name. Several declarations share
            a key where they are a list in it, or where the model has one or the other.
        entries: the section that every key holds, where the keys are names that a file chooses.
    """

    quantities: ClassVar[Mapping[str, tuple[Declaration, ...]]] = {}
    entries: ClassVar["type[Section] | None"] = None

    # Strict: "0.3" and true are not numbers here. An int where a float is meant is one.
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, frozen=True)

    def contents(self) -> dict[str, Any]:
        """The keys that the file has, with their values."""
        return self.model_dump(exclude_unset=True)

    def values(self) -> dict[str, npt.NDArray[np.float64]]:
        """The quantities that the file has, by path, in SI."""
        values = {}
        for name, value in self.contents().items():
            for part in self.quantities.get(name, ()) if value is not None else ():
                place = None if part.key is None else part.key.place
                number = value if place is None else value[place]
                values[part.path] = np.asarray(np.multiply(number, part.factor), dtype=float)
        for name, entry in self.named().items():
            for path, value in entry.values().items():
                values[path.replace(".NAME.", f".{name}.")] = value
        return values

    def named(self) -> dict[str, Any]:
        """The sections in it whose names a file chooses, by name."""
        return {} if self.entries is None else dict(self.__pydantic_extra__ or {})

    @classmethod
    def keys_of(cls, values: Mapping[str, npt.ArrayLike]) -> dict[str, Any]:
        """The keys of quantities as a file has them: the inverse of `values`.

        Arguments:
            values: by path, SI; those without a key are left out.
        """
        keys: dict[str, Any] = {}
        for name, parts in cls.quantities.items():
            numbers = [_in_file(part, values[part.path]) for part in parts if part.path in values]
            if numbers:
                shared = parts[0].key is not None and parts[0].key.place is not None
                keys[name] = numbers if shared else numbers[0]
        return keys


def _in_file(declaration: Declaration, value: npt.ArrayLike) -> Any:
    """A value (SI) in the unit of its key."""
    numbers = np.asarray(value, dtype=float)
    # What is an array always is one number in a file, where all of it is the same.
    always = declaration.per and not declaration.each and numbers.ndim
    if always and np.all(numbers == numbers[0]):
        numbers = numbers[0]
    return (numbers / declaration.factor).tolist()


def flat(
    table: Mapping[str, Any], before: str = "", *, leaves: Collection[str] = ()
) -> dict[str, Any]:
    """Nested tables as one, its keys joined by points.

    Arguments:
        table: the tables.
        before: what each key begins with.
        leaves: a table with one of these keys is a value, and stays a table.

    Raises:
        ValueError: two keys are the same then.
    """
    pairs: dict[str, Any] = {}
    for name, value in table.items():
        path = f"{before}{name}"
        nested = isinstance(value, Mapping) and not (set(value) & set(leaves))
        inner = flat(value, f"{path}.", leaves=leaves) if nested else {path: value}
        for twice in inner.keys() & pairs.keys():
            raise ValueError(f"has {shown(twice)} twice, quoted and unquoted: remove one")
        pairs.update(inner)
    return pairs


def each_of(section: Section) -> dict[str, list[Any]]:
    """The lists of a section that have one value for each link or joint, by key."""
    return {
        name: value
        for name, value in section
        if isinstance(value, list) and any(part.per for part in section.quantities.get(name, ()))
    }


# Keys of sections that are made from the declarations of quantities.

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
