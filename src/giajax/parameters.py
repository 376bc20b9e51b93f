"""A parameter declares itself at its field; everything else is read from that declaration.

`parameter(...)` makes a field of an Equinox module that carries its default, unit, bounds and
meaning. `declared(model)` walks a model and lists its parameters by dotted path;
`get` and `replace` read and write them. Tables, help texts and reports are made from here.
"""

import dataclasses
import difflib
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._errors import InputError
from ._typing import Array

Module = TypeVar("Module", bound=eqx.Module)

_KEY = "giajax.parameter"
_INLINE = "giajax.inline"
_PATH = re.compile(r"(?P<name>[A-Za-z_][\w.]*?)(?:\[(?P<index>\d+)\])?\Z")


@dataclasses.dataclass(frozen=True)
class Declaration:
    """What a parameter says of itself.

    Attributes:
        default: the value of the preset `takeichi_20m` (each element, where it is an array).
        unit: SI unit, in the spelling of the file formats; "" for a pure number.
        lower, upper: open bounds; a free parameter stays strictly between them.
        frozen: held at its value in a fit unless it is asked for by its path.
        optional: may be None, which leaves out its part of the model and the cost of it; its
            default is then the value that it is switched on with.
        shape: of a parameter that is an array of fixed shape, such as a vector.
        each: one number for all links or joints, or an array with one for each.
        assumed: the paper gives no figure; this one is a guess that a fit should replace.
        doc: one line of meaning.
    """

    default: float
    unit: str
    lower: float
    upper: float
    frozen: bool
    assumed: bool
    doc: str
    optional: bool = False
    shape: tuple[int, ...] = ()
    each: bool = False


def parameter(
    default: float,
    *,
    unit: str,
    doc: str,
    lower: float = -np.inf,
    upper: float = np.inf,
    frozen: bool = True,
    assumed: bool = False,
    optional: bool = False,
    shape: tuple[int, ...] = (),
    each: bool = False,
) -> Any:
    """Field of an Equinox module that is a parameter; see `Declaration` for the arguments.

    The value is converted to an array of the default floating-point type, strongly typed: a
    weakly typed scalar would compile every program twice.
    """
    declaration = Declaration(
        default, unit, lower, upper, frozen, assumed, doc, optional=optional, shape=shape, each=each
    )

    def convert(value: Any) -> Any:
        if value is None and optional:
            return None
        array = _as_float_array(value)
        return jnp.broadcast_to(array, shape) if shape and array.ndim == 0 else array

    return eqx.field(
        converter=convert,
        default=None if optional else default,
        metadata={_KEY: declaration},
    )


def inline(**options: Any) -> Any:
    """Field whose parameters appear in the paths of its owner without the field's own name.

    `options` are those of `equinox.field`, such as `default_factory`.
    """
    return eqx.field(metadata={_INLINE: True}, **options)


def _as_float_array(value: Any) -> Any:
    return jnp.asarray(value, dtype=jnp.result_type(float))


def declaration(module: type[eqx.Module], field: str) -> Declaration:
    """The declaration at a field of a module class."""
    return module.__dataclass_fields__[field].metadata[_KEY]


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A declared parameter of one model: its path, its declaration and how to reach it."""

    path: str
    declaration: Declaration
    getter: Callable[[Any], Any]
    index: int | None = None

    def value(self, model: eqx.Module) -> Array:
        """The parameter's array in a model (one element where the path has an index)."""
        array = self.getter(model)
        return array if self.index is None else array[self.index]

    def is_on(self, model: eqx.Module) -> bool:
        """Whether the model has this parameter, or leaves its part out."""
        return self.getter(model) is not None

    def set(self, model: Module, value: Any) -> Module:
        """The model with this parameter replaced; differentiable in `value`.

        A parameter that was left out is switched on.
        """
        old = self.getter(model)
        if old is None:
            value = jnp.asarray(value, dtype=jnp.result_type(float))
            if value.ndim == 0:
                value = jnp.broadcast_to(value, self.declaration.shape)
            model = eqx.tree_at(self.getter, model, value, is_leaf=lambda leaf: leaf is None)
            _check(model)
            return model
        value = jnp.asarray(value, dtype=old.dtype)
        if self.index is not None:
            new = old.at[self.index].set(value)
        elif self.declaration.each and value.ndim > old.ndim:
            new = value
        else:
            new = jnp.broadcast_to(value, old.shape)
        return eqx.tree_at(self.getter, model, new)


def declared(model: eqx.Module) -> dict[str, Parameter]:
    """All parameters of a model by dotted path, in the order of their fields.

    Optional ones that the model leaves out are not among them; see `left_out`.
    """
    return {p.path: p for p in _walk(model, "", lambda root: root) if p.is_on(model)}


def left_out(model: eqx.Module) -> dict[str, Parameter]:
    """The optional parameters that a model leaves out, by dotted path.

    `replace` switches one on, by giving it a value.
    """
    return {p.path: p for p in _walk(model, "", lambda root: root) if not p.is_on(model)}


def switched_on(model: Module, paths: Iterable[str]) -> Module:
    """The model in which none of the paths is left out; those that were have their defaults."""
    for path in paths:
        name = path.partition("[")[0]
        absent = left_out(model)
        if name in absent:
            model = absent[name].set(model, absent[name].declaration.default)
    return model


def _walk(node: eqx.Module, prefix: str, getter: Callable[[Any], Any]) -> Iterable[Parameter]:
    for field in dataclasses.fields(node):
        reach = _attribute(getter, field.name)
        if _KEY in field.metadata:
            yield Parameter(prefix + field.name, field.metadata[_KEY], reach)
        elif isinstance(child := getattr(node, field.name), eqx.Module):
            inner = prefix if field.metadata.get(_INLINE) else f"{prefix}{field.name}."
            yield from _walk(child, inner, reach)


def _check(node: eqx.Module) -> None:
    """What the classes of a model check when it is built: not every option suits every model."""
    check = getattr(node, "__check_init__", None)
    if check is not None:
        check()
    for field in dataclasses.fields(node):
        if isinstance(child := getattr(node, field.name), eqx.Module):
            _check(child)


def _attribute(getter: Callable[[Any], Any], name: str) -> Callable[[Any], Any]:
    return lambda root: getattr(getter(root), name)


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
                f"'{name}' is left out of this model; give it a value to switch it on "
                f"(such as {off[name].declaration.default:g})"
            )
        raise InputError(f"there is no parameter '{path}'; {_suggestion(name, [*known, *off])}")
    parameter = known[name]
    if match["index"] is None:
        return parameter
    index = int(match["index"])
    shape = parameter.value(model).shape
    if len(shape) != 1:
        raise InputError(f"'{name}' is a single number; leave out the index in '{path}'")
    if index >= shape[0]:
        raise InputError(
            f"'{path}' is beyond the {shape[0]} elements of '{name}'; "
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


def replace(model: Module, values: Mapping[str, Any]) -> Module:
    """The model with the parameters at the given paths replaced; the model itself is unchanged.

    An optional parameter that the model leaves out is switched on.

    Example:
        >>> import giajax
        >>> arm = giajax.takeichi_20m()
        >>> heavier = giajax.replace(arm, {"links.mass": 0.06, "air.drag_coefficient": 1.0})
    """
    for path, value in values.items():
        absent = left_out(model)
        model = (absent[path] if path in absent else find(model, path)).set(model, value)
    return model


def check_within_bounds(parameter: Parameter, value: float, *, free: bool) -> None:
    """Refuse a value outside the bounds; a free parameter must lie strictly inside.

    Raises:
        InputError: naming the parameter, the value and its bounds.
    """
    declaration = parameter.declaration
    lower, upper = declaration.lower, declaration.upper
    inside = lower < value < upper if free else lower <= value <= upper
    if np.isfinite(value) and inside:
        return
    unit = f" {declaration.unit}" if declaration.unit else ""
    between = "strictly between" if free else "between"
    raise InputError(
        f"{parameter.path} = {value:g}{unit} is outside its bounds; "
        f"choose a value {between} {lower:g} and {upper:g}{unit}"
    )


def default_free(model: eqx.Module, started: Iterable[str] = ()) -> tuple[str, ...]:
    """Paths that a fit frees when nothing is said: those whose declaration is not frozen.

    What the model holds at a bound, such as the spring of a pendulum at zero, is left out of it
    on purpose, and stays so, unless it is among those that are given a start.
    """
    started = set(started)

    def inside(parameter: Parameter) -> bool:
        value, declaration = np.asarray(parameter.value(model)), parameter.declaration
        return bool(np.all((declaration.lower < value) & (value < declaration.upper)))

    return tuple(
        path
        for path, parameter in declared(model).items()
        if not parameter.declaration.frozen and (path in started or inside(parameter))
    )


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


def is_concrete(value: Any) -> bool:
    """Whether a value is known now, not while a program is being traced."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))
