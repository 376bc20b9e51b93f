"""The declaration of a quantity, once: unit, bounds, prior and meaning, for models and files."""

import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, create_model

from ..runtime.limits import ELEMENTS
from ..runtime.text import InputError, one_of, shown


@dataclass(frozen=True)
class Quantity:
    """A physical quantity of the column table.

    `suffixes` maps what a column name ends in to its unit; the first one is what giajax writes
    by default. A quantity without suffixes is a pure number or text.
    """

    name: str
    si_unit: str
    suffixes: dict[str, str]


QUANTITIES: dict[str, Quantity] = {
    quantity.name: quantity
    for quantity in (
        Quantity("time", "s", {"s": "s", "ms": "ms"}),
        Quantity("angle", "rad", {"deg": "deg", "rad": "rad"}),
        Quantity("angular_velocity", "rad/s", {"deg_per_s": "deg/s", "rad_per_s": "rad/s"}),
        Quantity("length", "m", {"m": "m", "cm": "cm", "mm": "mm"}),
        Quantity("pixel", "px", {"px": "px"}),
        Quantity("velocity", "m/s", {"m_per_s": "m/s"}),
        Quantity("acceleration", "m/s^2", {"m_per_s2": "m/s^2"}),
        Quantity("curvature", "1/m", {"per_m": "1/m"}),
        Quantity("force", "N", {"N": "N", "mN": "mN"}),
        Quantity("torque", "N m", {"N_m": "N m"}),
        Quantity("pressure", "Pa", {"kPa": "kPa", "MPa": "MPa", "bar": "bar"}),
        Quantity("ratio", "", {"": ""}),
        Quantity("text", "", {"": ""}),
    )
}

# `input` and `output` of a hysteresis run take any of these; each suffix belongs to one quantity.
QUANTITY_OF_SUFFIX: dict[str, str] = {
    suffix: quantity.name
    for quantity in QUANTITIES.values()
    if quantity.name not in ("time", "text")
    for suffix in quantity.suffixes
}

# The units of the table that are not SI, in the SI unit of their quantity.
_IN_SI = {
    "ms": 1e-3,
    "deg": np.pi / 180,
    "deg/s": np.pi / 180,
    "cm": 1e-2,
    "mm": 1e-3,
    "mN": 1e-3,
    "kPa": 1e3,
    "MPa": 1e6,
    "bar": 1e5,
}

# Units of keys that no column has, by their SI unit.
_OF_KEYS = {"m^3": {"l": 1e-3}, "m^3/s": {"l_per_min": 1e-3 / 60}}


@functools.cache
def si_factor(quantity: str, suffix: str) -> float:
    """How many SI units one unit of `suffix` is: 0.01 for `cm`, pi/180 for `deg`.

    Raises:
        InputError: the quantity has no such suffix.
    """
    known = QUANTITIES[quantity]
    if suffix not in known.suffixes:
        raise InputError(
            f"unit {suffix!r} is not a unit of {quantity.replace('_', ' ')}: "
            f"use {one_of(known.suffixes)}"
        )
    unit = known.suffixes[suffix]
    return 1.0 if unit == known.si_unit else _IN_SI[unit]


def key_factor(key: str, si_unit: str) -> float:
    """How many SI units one unit of a key's value is: 1 for `link_mass_kg`.

    Arguments:
        key: of a file; it ends in its unit, `_per_` standing for a stroke.
        si_unit: of its quantity, as in `kg m^2`; "" for a pure number, whose key has no unit.

    Raises:
        ValueError: the key does not end in a unit of the quantity.
    """
    if not si_unit:
        return 1.0
    known = {si_unit.replace("/", "_per_").replace(" ", "_").replace("^", ""): 1.0}
    known |= _OF_KEYS.get(si_unit, {})
    for quantity in QUANTITIES.values():
        if quantity.si_unit == si_unit:
            known |= {name: si_factor(quantity.name, name) for name in quantity.suffixes}
    for suffix, factor in known.items():
        if key.endswith(f"_{suffix}"):
            return factor
    raise ValueError(f"key {key} does not end in a unit of {si_unit}: end it in {one_of(known)}")


@dataclasses.dataclass(frozen=True)
class Prior:
    """What is known of a parameter before a fit: about where it is, and how surely.

    With a `deviation` the knowledge is normal, with a `factor` log-normal: the logarithm of the
    parameter is normal, and its standard deviation is that of the factor.

    Arguments:
        value: the most probable value; of a log-normal prior the median. SI.
        deviation: standard deviation, SI.
        factor: the value is known to so much, one standard deviation up or down: 1.2 is 20 %.

    Raises:
        InputError: neither or both of the last two, or a number that they may not be.

    Example:
        >>> import giajax
        >>> drag = giajax.Prior(1.1, deviation=0.2)
        >>> mass = giajax.Prior(0.05, factor=1.5)  # one sigma: between 0.033 and 0.075
    """

    value: float
    deviation: float | None = None
    factor: float | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise InputError(f"the value of the prior is {self.value}: give a finite number")
        if (self.deviation is None) == (self.factor is None):
            raise InputError(
                "the prior must have a deviation, or a factor if it is log-normal: give one of them"
            )
        if self.deviation is not None and not 0 < self.deviation < math.inf:
            raise InputError(
                f"the deviation of the prior is {self.deviation:g}: give a positive number"
            )
        if self.factor is not None and not 1 < self.factor < math.inf:
            raise InputError(
                f"the factor of the prior is {self.factor:g}: give a number above 1, such as 1.2 "
                "for 20 percent"
            )
        if self.factor is not None and self.value <= 0:
            raise InputError(
                f"the prior has a factor and the value {self.value:g}: give a positive value, or "
                "a deviation"
            )

    @property
    def logarithmic(self) -> bool:
        """Whether the logarithm of the parameter is normal."""
        return self.factor is not None

    @property
    def centre(self) -> float:
        """Mean of the parameter, or of its logarithm."""
        return math.log(self.value) if self.logarithmic else self.value

    @property
    def spread(self) -> float:
        """Standard deviation of the parameter, or of its logarithm."""
        if self.factor is not None:
            return math.log(self.factor)
        assert self.deviation is not None
        return self.deviation

    def contents(self) -> dict[str, float]:
        """What a file says of it."""
        known = dataclasses.asdict(self)
        return {name: value for name, value in known.items() if value is not None}


@dataclasses.dataclass(frozen=True)
class Key:
    """How a file states a quantity.

    Attributes:
        name: of the key; it ends in its unit, which need not be the SI unit.
        lower, upper: what a file may state, SI, where that is less than the model computes with.
        closed: whether the value may be the bound itself, as an axial inertia may be zero.
        example: a value, in the key's unit, that shows more than the default does.
        remark: added to the sentence of what the value must be.
        place: of the quantity in the list of numbers, where several share the key: x, then y.
        meaning: of a key that several quantities share.
        earlier: what the key was called before; files may have that name.
    """

    name: str
    _: dataclasses.KW_ONLY
    lower: float | None = None
    upper: float | None = None
    closed: bool = False
    example: float | list[float] | None = None
    remark: str = ""
    place: int | None = None
    meaning: str = ""
    earlier: str = ""


@dataclasses.dataclass(frozen=True)
class Declaration:
    """What a parameter says of itself.

    Attributes:
        default: the value of the preset `takeichi_20m` (each element, where it is an array), SI.
        unit: SI unit, in the spelling of the file formats; "" for a pure number.
        doc: one line of meaning.
        lower, upper: bounds, SI; a fit starts strictly between them, and may end on one.
        frozen: held at its value in a fit unless it is asked for by its path.
        assumed: the paper gives no number; this one is a guess that a fit should replace.
        optional: may be None, which leaves out its part of the model and the cost of it; its
            default is then the value that it is switched on with.
        neutral: of an optional one, the value with which its part changes nothing: the model
            then predicts what it does where the part is left out.
        shape: of a parameter that is an array of fixed shape, such as a vector.
        per: what an element of it belongs to: "link", "joint", "body"; "" where it belongs to
            the whole model.
        each: whether it may be one number for all links or joints, as well as an array with one
            for each; without it, a parameter per link is always an array.
        any_number: whether a model may have any number of its elements, with no count of its own.
        has_states: of an optional one, whether its part adds states to the motion; suspects are
            not asked for with those, and one of the model's `variants` has it.
        essential: what the motion comes from: an estimate of 0 casts doubt on the model.
        source: where the default is from, or the equation that the parameter stands in.
        key: how files state it; None: by its path alone.
        path: in a model, such as `links.mass`; "" for a parameter that is in no group.
        earlier: what the path was before; files and `replace` may have that name.
    """

    default: float
    unit: str
    doc: str
    _: dataclasses.KW_ONLY
    lower: float = -np.inf
    upper: float = np.inf
    frozen: bool = True
    assumed: bool = False
    optional: bool = False
    neutral: float = 0.0
    shape: tuple[int, ...] = ()
    per: str = ""
    each: bool = False
    any_number: bool = False
    has_states: bool = False
    essential: bool = False
    source: str = ""
    key: Key | None = None
    path: str = ""
    earlier: str = ""

    def keyed(self, name: str, **about: Any) -> "Declaration":
        """The same with a key by which files state it, and what is said `about` a `Key`."""
        return dataclasses.replace(self, key=Key(name, **about))

    @property
    def meaning(self) -> str:
        """`doc`, and whether there may be several numbers."""
        several = f" (one number, or one for each {self.per})" if self.each and self.per else ""
        return self.doc + several

    @property
    def factor(self) -> float:
        """How many SI units one unit of the key's value is; 1 without a key."""
        return 1.0 if self.key is None else key_factor(self.key.name, self.unit)


# Most declarations are of one of these forms, and many have a number for each part of an arm.
positive = functools.partial(Declaration, lower=0)
guess = functools.partial(positive, assumed=True)
freed = functools.partial(positive, frozen=False)
freed_guess = functools.partial(freed, assumed=True)
left_out = functools.partial(Declaration, 0.0, optional=True)

EACH_LINK: dict[str, Any] = {"per": "link", "each": True}
EACH_JOINT: dict[str, Any] = {"per": "joint", "each": True}
EACH_BODY: dict[str, Any] = {"per": "body", "each": True}


class Group:
    """The quantities of one module of a model, as class attributes of a subclass.

    The attributes of an instance know their paths, below that of the module (`at`: `links`, "" for
    the model itself); iterating over it gives them in their order.
    """

    def __init__(self, at: str) -> None:
        self._names = [name for name, d in vars(type(self)).items() if isinstance(d, Declaration)]
        for name in self._names:
            path = f"{at}.{name}" if at else name
            setattr(self, name, dataclasses.replace(getattr(type(self), name), path=path))

    def __iter__(self) -> Iterator[Declaration]:
        return iter([getattr(self, name) for name in self._names])


# What every section of the TOML vocabulary is made of, and its keys that declarations make.

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(min_length=1)]
Count = Annotated[int, Field(ge=1, le=ELEMENTS)]

# What values of keys must be.
COUNT = f"a whole number from 1 to {ELEMENTS}"
POSITIVE, NOT_NEGATIVE = "a positive number", "a number that is not negative"


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
        """The keys of values (SI, by path) as a file has them: the inverse of `values`."""
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
    """Nested tables as one, its keys joined by points and begun with `before`.

    A table with one of the keys `leaves` is a value, and stays a table.

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


S = TypeVar("S", bound=Section)

_COUNTS = {2: "two", 3: "three", 5: "five"}


def with_keys(*groups: Group, required: bool = False) -> Callable[[type[S]], type[S]]:
    """Class decorator: the section, with the keys of these groups after its own.

    A quantity without a key in files is left out; several that share a key are a list there.

    Arguments:
        groups: of quantities, in the order of their keys.
        required: whether a section must have those that are not optional, as an entry of a list
            does; the optional ones are 0 there.
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
        fields: dict[str, Any] = {}
        for name, parts in sharing.items():
            fields[name] = _optional(parts)
            if required:
                default = 0.0 if parts[0].optional else ...
                field = key(_sentence(parts[0]), parts[0].doc, default=default)
                fields[name] = _number(parts[0]), field
        about = {f"__{name}__": getattr(section, f"__{name}__") for name in ("module", "doc")}
        extended = create_model(section.__name__, __base__=section, **about, **fields)
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
            kind, must = (
                kind | list[kind],
                f"{must} or a list of them, one for each {declaration.per}",
            )
    example = default if about.example is None else about.example
    preset = None if declaration.optional else default
    meaning = about.meaning or declaration.doc
    return kind | None, key(must + about.remark, meaning, preset=preset, example=example)


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
