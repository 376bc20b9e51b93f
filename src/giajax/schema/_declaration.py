"""Declaration of a quantity for models and files: unit, bounds, prior and meaning."""

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

    `suffixes` maps the suffix of a column name to its unit. giajax writes the first one by default.
    A quantity without suffixes is a pure number or text.
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

# `input` and `output` of a hysteresis run accept any of these, so each suffix has one quantity.
QUANTITY_OF_SUFFIX: dict[str, str] = {
    suffix: quantity.name
    for quantity in QUANTITIES.values()
    if quantity.name not in ("time", "text")
    for suffix in quantity.suffixes
}

# Units of the table other than SI units, in the SI unit of their quantity.
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

# Units of keys that are not used by columns, by their SI unit.
_OF_KEYS = {"m^3": {"l": 1e-3}, "m^3/s": {"l_per_min": 1e-3 / 60}}


@functools.cache
def si_factor(quantity: str, suffix: str) -> float:
    """Return the number of SI units in one unit of `suffix`: 0.01 for `cm`, pi/180 for `deg`.

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
    """Return the number of SI units in one unit of the value of a key: 1 for `link_mass_kg`.

    Arguments:
        key: key in a file; it ends with its unit, in which `_per_` means a division.
        si_unit: SI unit of its quantity, such as `kg m^2`; "" for a pure number, whose key has no
            unit.

    Raises:
        ValueError: the key does not end with a unit of the quantity.
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
    raise ValueError(
        f"key {key} does not end in a unit of {si_unit}: end its name in {one_of(known)}"
    )


@dataclasses.dataclass(frozen=True)
class Prior:
    """Prior knowledge of a parameter: a value and its uncertainty.

    With a `deviation` the prior is normal. With a `factor` it is log-normal: the logarithm of the
    parameter is normal, and its standard deviation is the logarithm of the factor.

    Arguments:
        value: most probable value, or the median of a log-normal prior. SI.
        deviation: standard deviation, SI.
        factor: uncertainty as a factor, one standard deviation up or down: 1.2 is 20 %.

    Raises:
        InputError: neither or both of `deviation` and `factor` are given, or a number is not legal.

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
        """Return the keys of the prior in a file."""
        known = dataclasses.asdict(self)
        return {name: value for name, value in known.items() if value is not None}


@dataclasses.dataclass(frozen=True)
class Key:
    """The key of a quantity in a file.

    Attributes:
        name: name of the key; it ends with its unit, which need not be the SI unit.
        lower, upper: bounds in a file, SI, if they are narrower than those of the model.
        closed: True if the value may equal a bound, as an axial inertia may be zero.
        example: a value in the unit of the key that is a better example than the default.
        remark: text that is added to the sentence on legal values.
        place: index of the quantity in a list of numbers if several share the key, such as x and y.
        meaning: meaning of a key that several quantities share.
        earlier: former name of the key, which files may still contain.
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
    """The declaration of a parameter.

    Attributes:
        default: value in the preset `takeichi_20m` (of each element of an array), SI.
        unit: SI unit, in the spelling of the file formats; "" for a pure number.
        doc: meaning, in one line.
        lower, upper: bounds, SI; a fit starts strictly between them, and may end at one.
        frozen: True if a fit holds the parameter unless its path is given.
        assumed: True if the paper gives no number, so the default is a guess to be fitted.
        optional: True if the parameter may be None, which leaves out its part of the model and the
            computation of this part. The default is then the value when it is switched on.
        neutral: value of an optional parameter at which its part has no effect: the model then
            predicts the same as without the part.
        shape: shape of a parameter that is an array of fixed shape, such as a vector.
        per: part that an element belongs to: "link", "joint", "body"; "" for the whole model.
        each: True if the parameter may be one number for all links or joints, or an array with one
            number for each. Otherwise a parameter per link is always an array.
        any_number: True if the number of elements is arbitrary.
        has_states: True if the part of an optional parameter adds states to the motion. Such a
            parameter is not tested as a suspect itself; one of the model's `variants` has it.
        essential: True if the motion depends on it, so an estimate of 0 casts doubt on the model.
        source: source of the default, or equation that contains the parameter.
        key: key in files; None if files give the parameter by its path only.
        path: path in a model, such as `links.mass`; "" for a parameter without a group.
        earlier: former path, which files and `replace` may still use.
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
        """Return the declaration with a key for files; `about` contains attributes of `Key`."""
        return dataclasses.replace(self, key=Key(name, **about))

    @property
    def meaning(self) -> str:
        """The meaning (`doc`), with a remark if there may be several numbers."""
        several = f" (one number, or one for each {self.per})" if self.each and self.per else ""
        return self.doc + several

    @property
    def factor(self) -> float:
        """Return the number of SI units in one unit of the key; 1 without a key."""
        return 1.0 if self.key is None else key_factor(self.key.name, self.unit)


# Common forms of declarations. Many parameters have a number for each part of an arm.
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

    The attributes of an instance have paths that start with the path of the module (`at`: `links`,
    or "" for the model itself). Iteration yields them in order.
    """

    def __init__(self, at: str) -> None:
        self._names = [name for name, d in vars(type(self)).items() if isinstance(d, Declaration)]
        for name in self._names:
            path = f"{at}.{name}" if at else name
            setattr(self, name, dataclasses.replace(getattr(type(self), name), path=path))

    def __iter__(self) -> Iterator[Declaration]:
        return iter([getattr(self, name) for name in self._names])


# Base of all sections of the TOML vocabulary, and the keys made from declarations.

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(min_length=1)]
Count = Annotated[int, Field(ge=1, le=ELEMENTS)]

# Descriptions of the legal values of keys.
COUNT = f"a whole number from 1 to {ELEMENTS}"
POSITIVE, NOT_NEGATIVE = "a positive number", "zero or a positive number"


def key(
    must: str,
    meaning: str,
    *,
    preset: Any = None,
    default: Any = None,
    example: Any = None,
    entry: str = "",
) -> Any:
    """Declare a key with its descriptions for errors and templates.

    Arguments:
        must: description of the legal values, for error messages.
        meaning: meaning of the key, for the template of a sidecar.
        preset: value in a model if a file does not contain the key, for the template.
        default: value of the field if a file does not contain the key.
        example: value shown in the template if there is no preset.
        entry: description of the entries of a table if they are not numbers or lists of them.
    """
    extra = {
        "must": must,
        "preset": preset,
        "example": preset if example is None else example,
        **({"entry": entry} if entry else {}),
    }
    return Field(default=default, description=meaning, json_schema_extra=extra)


class Section(BaseModel):
    """A section whose keys are declared by `key` or `with_keys`; other keys are refused.

    Attributes:
        quantities: declarations by the key that is made from them. Several declarations share a key
            if they form a list, or if only one of them belongs to a model.
        entries: class of the sections in a table whose keys are names chosen in the file.
    """

    quantities: ClassVar[Mapping[str, tuple[Declaration, ...]]] = {}
    entries: ClassVar["type[Section] | None"] = None

    # Strict: "0.3" and true are not accepted as numbers. An int is accepted as a float.
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, frozen=True)

    def contents(self) -> dict[str, Any]:
        """Return the keys in the file with their values."""
        return self.model_dump(exclude_unset=True)

    def values(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return the quantities in the file by path, in SI."""
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
        """Return the contained sections whose names are chosen in the file, by name."""
        return {} if self.entries is None else dict(self.__pydantic_extra__ or {})

    @classmethod
    def keys_of(cls, values: Mapping[str, npt.ArrayLike]) -> dict[str, Any]:
        """Convert values (SI) by path to keys, as in a file: the inverse of `values`."""
        keys: dict[str, Any] = {}
        for name, parts in cls.quantities.items():
            numbers = [_in_file(part, values[part.path]) for part in parts if part.path in values]
            if numbers:
                shared = parts[0].key is not None and parts[0].key.place is not None
                keys[name] = numbers if shared else numbers[0]
        return keys


def _in_file(declaration: Declaration, value: npt.ArrayLike) -> Any:
    """Convert a value from SI to the unit of its key."""
    numbers = np.asarray(value, dtype=float)
    # In a file, an array that the model always has is one number if all elements are equal.
    always = declaration.per and not declaration.each and numbers.ndim
    if always and np.all(numbers == numbers[0]):
        numbers = numbers[0]
    return (numbers / declaration.factor).tolist()


def flat(
    table: Mapping[str, Any], before: str = "", *, leaves: Collection[str] = ()
) -> dict[str, Any]:
    """Flatten nested tables; their keys are joined by points and start with `before`.

    A table that contains one of the keys `leaves` is a value, and stays a table.

    Raises:
        ValueError: two keys become equal.
    """
    pairs: dict[str, Any] = {}
    for name, value in table.items():
        path = f"{before}{name}"
        nested = isinstance(value, Mapping) and not (set(value) & set(leaves))
        inner = flat(value, f"{path}.", leaves=leaves) if nested else {path: value}
        for twice in inner.keys() & pairs.keys():
            raise ValueError(f"gives {shown(twice)} twice, quoted and unquoted: remove one")
        pairs.update(inner)
    return pairs


def each_of(section: Section) -> dict[str, list[Any]]:
    """Return the lists of a section with one value for each link or joint, by key."""
    return {
        name: value
        for name, value in section
        if isinstance(value, list) and any(part.per for part in section.quantities.get(name, ()))
    }


S = TypeVar("S", bound=Section)

_COUNTS = {2: "two", 3: "three", 5: "five"}


def with_keys(*groups: Group, required: bool = False) -> Callable[[type[S]], type[S]]:
    """Return a class decorator that adds the keys of these groups to a section.

    A quantity without a key in files is left out. Several quantities that share a key form a list.

    Arguments:
        groups: groups of quantities, in the order of their keys.
        required: True to require the keys that are not optional, as in an entry of a list. The
            optional ones are 0 by default.
    """

    def decorate(section: type[S]) -> type[S]:
        sharing: dict[str, tuple[Declaration, ...]] = {}
        for group in groups:
            for declaration in group:
                if declaration.key is not None:
                    others = sharing.get(declaration.key.name, ())
                    # Laws may share a key in one place. The default of the first one is shown.
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
    """Return type and field of a key that is optional in a file."""
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
    """Return the default in the unit of the key, without rounding errors of the conversion."""
    value = float(f"{declaration.default / declaration.factor:.12g}")
    return [value] * declaration.shape[0] if declaration.shape else value


def _range(declaration: Declaration) -> tuple[float, float]:
    """Return the range of legal values in a file, in the unit of the key."""
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
    """Return the description of legal numbers."""
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
