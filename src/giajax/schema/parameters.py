"""Parameters of models as fields: find, read and replace them by path. Imports JAX."""

import dataclasses
import difflib
import functools
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..runtime.arrays import Array
from ..runtime.text import InputError, format_estimate
from ._declaration import Declaration

DECLARED = "giajax.parameter"
"""Metadata key of the declaration of a field that is a parameter."""

INLINE = "giajax.inline"
"""Metadata key of a field whose own name is not in the paths of its parameters."""


@overload
def parameter(declared: Declaration, /, *, default: bool = ...) -> Any: ...
@overload
def parameter(
    declared: float,
    /,
    *,
    unit: str,
    doc: str,
    lower: float = -np.inf,
    upper: float = np.inf,
    frozen: bool = True,
    assumed: bool = False,
    optional: bool = False,
    neutral: float = 0.0,
    shape: tuple[int, ...] = (),
    per: str = "",
    each: bool = False,
    source: str = "",
) -> Any: ...
def parameter(declared: Declaration | float, /, *, default: bool = True, **about: Any) -> Any:
    """Declare a field of an Equinox module as a parameter.

    The value is converted to a strongly typed array of the default floating-point type, because a
    weakly typed scalar would compile every program twice.

    Arguments:
        declared: a declaration from `giajax.schema`; or, for your own model, a default (SI), with
            the rest of the declaration as keywords.
        default: True if the field has a default; otherwise a value must be given.
        about: the rest of a declaration; `unit` and `doc` are required.

    Example:
        >>> import equinox as eqx
        >>> import jax
        >>> from giajax.schema.parameters import parameter
        >>> from giajax.schema import AIR
        >>> class Ball(eqx.Module):
        ...     density: jax.Array = parameter(AIR.density)
        ...     radius: jax.Array = parameter(0.1, unit="m", lower=0, doc="radius of the ball")
        >>> float(Ball().density)
        1.204
    """
    if not isinstance(declared, Declaration):
        declared = Declaration(declared, **about)
    about = {"converter": _converter(declared), "metadata": {DECLARED: declared}}
    if default:
        about["default"] = None if declared.optional else declared.default
    return eqx.field(**about)


def _converter(declaration: Declaration) -> Callable[[Any], Any]:
    def convert(value: Any) -> Any:
        if value is None and declaration.optional:
            return None
        dtype = jnp.result_type(float)
        if not any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(value)):
            # Converted by numpy, because JAX would compile a program to convert a list or integers.
            value = jax.device_put(np.array(value, dtype))
        array = jnp.asarray(value, dtype=dtype)
        shape = declaration.shape
        return jnp.broadcast_to(array, shape) if shape and array.ndim == 0 else array

    return convert


HELD = "giajax.held"
"""Metadata key of a field whose parameters are fitted only on request."""


def held(*, inline: bool = False, **options: Any) -> Any:
    """Declare a field whose parameters are all frozen in this owner.

    `inline` has the meaning of the function `inline`; `options` are those of `equinox.field`.
    """
    return eqx.field(metadata={HELD: True, INLINE: inline}, **options)


def inline(**options: Any) -> Any:
    """Declare a field whose own name does not appear in the paths of its parameters.

    `options` are those of `equinox.field`, such as `default_factory`.
    """
    return eqx.field(metadata={INLINE: True}, **options)


def declaration(module: type[eqx.Module], field: str) -> Declaration:
    """Return the declaration of a field of a module class."""
    return module.__dataclass_fields__[field].metadata[DECLARED]


Module = TypeVar("Module", bound=eqx.Module)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A declared parameter of one model: its path, its declaration and how to access it.

    Parts of a model that declare the same path share the parameter, which then has several places.
    """

    path: str
    declaration: Declaration
    getters: tuple[Callable[[Any], Any], ...]
    index: int | None = None

    def value(self, model: eqx.Module) -> Array:
        """Return the array of the parameter in a model (one element if the path has an index)."""
        array = next(array for get in self.getters if (array := get(model)) is not None)
        return array if self.index is None else array[self.index]

    def is_on(self, model: eqx.Module) -> bool:
        """Return whether the model has this parameter, rather than leaving its part out."""
        return any(get(model) is not None for get in self.getters)

    @property
    def is_shared(self) -> bool:
        """Whether several parts of the model have this parameter."""
        return len(self.getters) > 1

    @property
    def any_number(self) -> bool:
        """Whether the number of elements may be changed."""
        return self.declaration.any_number and self.index is None

    def set(self, model: Module, value: Any) -> Module:
        """Return the model with this parameter replaced; differentiable in `value`.

        A parameter that was left out is switched on.
        """
        for getter in self.getters:
            model = self._set(model, getter, value)
        return model

    def _set(self, model: Module, getter: Callable[[Any], Any], value: Any) -> Module:
        old = getter(model)
        if old is None:
            value = jnp.asarray(value, dtype=jnp.result_type(float))
            if value.ndim == 0:
                value = jnp.broadcast_to(value, self.declaration.shape)
            return checked(eqx.tree_at(getter, model, value, is_leaf=lambda leaf: leaf is None))
        value = jnp.asarray(value, dtype=old.dtype)
        if self.index is not None:
            new = old.at[self.index].set(value)
        elif (self.declaration.each and value.ndim > old.ndim) or (self.any_number and value.ndim):
            new = value
        else:
            new = jnp.broadcast_to(value, old.shape)
        return eqx.tree_at(getter, model, new)


def declared(model: eqx.Module) -> dict[str, Parameter]:
    """Return all parameters of a model by dotted path, in the order of their fields.

    Optional parameters that the model leaves out are not included; see `left_out`.
    """
    return {path: p for path, p in _by_path(model).items() if p.is_on(model)}


def left_out(model: eqx.Module) -> dict[str, Parameter]:
    """Return the optional parameters that a model leaves out, by dotted path.

    `replace` switches a parameter on by giving it a value.
    """
    return {path: p for path, p in _by_path(model).items() if not p.is_on(model)}


def default_free(model: eqx.Module, started: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the paths that a fit frees by default: those whose declaration is not frozen.

    A parameter that the model has at a bound, such as the zero stiffness of a pendulum, stays held,
    unless it is among those with a start value (`started`).
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


def parameter_rows(model: eqx.Module) -> dict[str, str]:
    """Return text on the parameters that a fit frees by default, with values, and on held ones."""
    known, free = declared(model), default_free(model)
    shown = []
    for path in free:
        value = format_estimate(np.ravel(known[path].value(model)).tolist(), None)[0]
        shown.append(f"{path} {value} {known[path].declaration.unit}".rstrip())
    return {"free": "; ".join(shown) or "nothing", "held": f"{len(known) - len(free)} parameters"}


def _by_path(model: eqx.Module) -> dict[str, Parameter]:
    """Return all parameters by path, including those left out; shared ones occur once."""
    # They depend on the structure of a model and not on its values, and are cached because fits
    # request them often.
    parts = _parts(model)
    known = _BY_PARTS.get(parts)
    if known is None:
        while len(_BY_PARTS) >= _MOST_KEPT:
            _BY_PARTS.pop(next(iter(_BY_PARTS)), None)
        known = _BY_PARTS[parts] = _found(model)
    return known


_BY_PARTS: dict[Any, dict[str, Parameter]] = {}
_MOST_KEPT = 64


def _parts(node: Any) -> Any:
    """Return the classes of the parts of a model, in order."""
    if isinstance(node, eqx.Module):
        return type(node), tuple(map(_parts, vars(node).values()))
    if isinstance(node, dict):
        return tuple((name, _parts(part)) for name, part in node.items())
    return tuple(map(_parts, node)) if isinstance(node, tuple) else None


def _found(model: eqx.Module) -> dict[str, Parameter]:
    parameters: dict[str, Parameter] = {}
    for found in _walk(model, "", lambda root: root):
        known = parameters.get(found.path)
        if known is not None:
            # A parameter that is held in one part is free if another part's data can determine it.
            freer = found if known.declaration.frozen else known
            getters = (*known.getters, *found.getters)
            found = dataclasses.replace(freer, getters=getters)
        parameters[found.path] = found
    return parameters


def _walk(node: eqx.Module, prefix: str, getter: Callable[[Any], Any]) -> Iterable[Parameter]:
    for field in dataclasses.fields(node):
        reach = _attribute(getter, field.name)
        if DECLARED in field.metadata:
            yield Parameter(prefix + field.name, field.metadata[DECLARED], (reach,))
            continue
        inner = prefix if field.metadata.get(INLINE) else f"{prefix}{field.name}."
        child, held = getattr(node, field.name), field.metadata.get(HELD, False)
        if isinstance(child, eqx.Module):
            for found in _walk(child, inner, reach):
                frozen = dataclasses.replace(found.declaration, frozen=True)
                yield dataclasses.replace(found, declaration=frozen) if held else found
        elif isinstance(child, tuple):
            for index, part in enumerate(child):
                if isinstance(part, eqx.Module):
                    yield from _walk(part, inner, _element(reach, index))
        elif isinstance(child, dict):
            for name, part in child.items():
                if isinstance(part, eqx.Module):
                    yield from _walk(part, f"{inner}{name}.", _element(reach, name))


def checked(model: Module) -> Module:
    """Return the model after the checks of its classes, because not all options are compatible."""
    check = getattr(model, "__check_init__", None)
    if check is not None:
        check()
    for field in dataclasses.fields(model):
        child = getattr(model, field.name)
        several = child.values() if isinstance(child, dict) else child
        for part in several if isinstance(child, tuple | dict) else (child,):
            if isinstance(part, eqx.Module):
                checked(part)
    return model


def _attribute(getter: Callable[[Any], Any], name: str) -> Callable[[Any], Any]:
    return lambda root: getattr(getter(root), name)


def _element(getter: Callable[[Any], Any], index: int | str) -> Callable[[Any], Any]:
    return lambda root: getter(root)[index]


def present_path(model: eqx.Module, path: str) -> str:
    """Return the current path for a former path of a parameter in the model; others unchanged."""
    name, bracket, index = path.partition("[")
    known = _by_path(model)
    if not name or name in known:
        return path
    now = (here for here, parameter in known.items() if parameter.declaration.earlier == name)
    return f"{next(now, name)}{bracket}{index}"


_PATH = re.compile(r"(?P<name>[A-Za-z_][\w.]*?)(?:\[(?P<index>[0-9]{1,9})\])?\Z", re.ASCII)


def find(model: eqx.Module, path: str) -> Parameter:
    """Return the parameter at a path such as `air.drag_coefficient` or `links.mass[2]`.

    Indices start at 0, as in Python.

    Raises:
        InputError: there is no such parameter (the message gives the nearest one), or the index
            is too large.
    """
    known = declared(model)
    path = present_path(model, path)
    match = _PATH.match(path)
    name = match["name"] if match else path
    if match is None or name not in known:
        off = left_out(model)
        if name in off:
            raise InputError(
                f"'{name}' is not part of this model: give it a value to include it (such as"
                f" {off[name].declaration.default:g})"
            )
        raise InputError(f"there is no parameter '{path}': {_suggestion(name, [*known, *off])}")
    parameter = known[name]
    if match["index"] is None:
        return parameter
    index = int(match["index"])
    shape = parameter.value(model).shape
    if len(shape) != 1:
        raise InputError(f"'{name}' is a single number: omit the index in '{path}'")
    if index >= shape[0]:
        raise InputError(
            f"'{path}' is beyond the {shape[0]} elements of '{name}': "
            f"indices run from 0 to {shape[0] - 1}"
        )
    return dataclasses.replace(parameter, path=path, index=index)


def elements(model: eqx.Module, path: str) -> list[Parameter]:
    """Return the scalar parameters of a path: itself, or each element of its array."""
    parameter = find(model, path)
    shape = parameter.value(model).shape
    if shape == ():
        return [parameter]
    return [
        dataclasses.replace(parameter, path=f"{path}[{index}]", index=index)
        for index in range(shape[0])
    ]


def get(model: eqx.Module, path: str) -> Array:
    """Return the value of the parameter at a path."""
    return find(model, path).value(model)


def _suggestion(name: str, known: Iterable[str]) -> str:
    names = list(known)
    last = {path.rsplit(".", 1)[-1]: path for path in names}
    begun = [path for path in names if name and path.startswith(name)]
    closest = functools.partial(difflib.get_close_matches, n=1, cutoff=0.5)
    near = (
        begun or closest(name, names) or [last[n] for n in closest(name.rsplit(".", 1)[-1], last)]
    )
    return f"did you mean '{near[0]}'?" if near else "'giajax parameters' lists them all"


def replace(model: Module, values: Mapping[str, Any]) -> Module:
    """Return the model with the parameters at some paths replaced; the original is unchanged.

    An optional parameter that the model leaves out is switched on.
    Example:
        >>> import giajax
        >>> arm = giajax.takeichi_20m()
        >>> heavier = giajax.replace(arm, {"links.mass": 0.06, "air.drag_coefficient": 1.0})
    """
    counted = False
    for path, value in values.items():
        absent = left_out(model)
        parameter = absent[path] if path in absent else find(model, path)
        counted |= parameter.any_number
        model = parameter.set(model, value)
    # The numbers of elements are checked for consistency after all of them are replaced.
    return checked(model) if counted else model


def as_in(model: Module, other: Module, names: Iterable[str]) -> Module:
    """Return the model with the named parts as in another model of its kind, or left out as there.

    A name is a path, the path of a group (`camera`), or the end of one (`wind` for `air.wind`).

    Raises:
        InputError: neither model has anything of a name.
    """
    unknown = set(names)

    def of(path: str, ours: Any, theirs: Any) -> Any:
        """Return the part or parameter at a path; it is None if a model does not have it."""
        hits = {name for name in names if path and f".{path}".endswith(f".{name}")}
        if hits:
            unknown.difference_update(hits)
            return theirs
        if isinstance(ours, dict) and isinstance(theirs, dict):
            each = {key: (ours.get(key), theirs.get(key)) for key in {**ours, **theirs}}
            both = {key: of(f"{path}.{key}" if path else key, *pair) for key, pair in each.items()}
            kept = {key: part for key, part in both.items() if part is not None}
            same = kept.keys() == ours.keys() and all(kept[key] is ours[key] for key in kept)
            return ours if same else kept
        if not isinstance(ours, eqx.Module) or type(ours) is not type(theirs):
            return ours
        changed: dict[str, Any] = {}
        for field in dataclasses.fields(ours):
            inside = "" if field.metadata.get(INLINE) else field.name
            one, another = getattr(ours, field.name), getattr(theirs, field.name)
            parts = isinstance(one, eqx.Module | dict) or isinstance(another, eqx.Module | dict)
            if DECLARED in field.metadata or parts:
                new = of(".".join(filter(None, (path, inside))), one, another)
                changed |= {} if new is one else {field.name: new}
        # Only if changed: a class with its own `__init__` cannot be made again from its fields.
        return dataclasses.replace(ours, **changed) if changed else ours

    found = of("", model, other)
    if unknown:
        groups = sorted({path.partition(".")[0] for path in {**_by_path(model), **_by_path(other)}})
        raise InputError(
            f"the model has no parameter or group called '{min(unknown)}': give "
            f"{', '.join(groups)}, or a path "
            "that 'giajax parameters' lists"
        )
    return found


def switched_on(model: Module, paths: Iterable[str]) -> Module:
    """Return the model with all these paths; those that were left out have their defaults."""
    for path in paths:
        if (absent := left_out(model).get(path.partition("[")[0])) is not None:
            model = absent.set(model, absent.declaration.default)
    return model


def check_count(model: Module, path: str, value: Any) -> None:
    """Refuse values for a parameter unless there is one, or one for each of its elements.

    Raises:
        InputError: the number is wrong; the message names the parameter and both numbers.
    """
    size, count = np.size(value), len(elements(model, path))
    if size not in (1, count) and not find(model, path).any_number:
        raise InputError(
            f"{path} is set to {size} values, but has {count} element{'s' * (count != 1)}: give "
            "one value, or one for each element"
        )


def check_within_bounds(parameter: Parameter, value: float, *, free: bool) -> None:
    """Refuse a value outside the bounds; a free parameter must be strictly inside.

    Raises:
        InputError: the value is refused; the message names the parameter, value and bounds.
    """
    declaration = parameter.declaration
    lower, upper = declaration.lower, declaration.upper
    inside = lower < value < upper if free else lower <= value <= upper
    if np.isfinite(value) and inside:
        return
    unit = f" {declaration.unit}" if declaration.unit else ""
    between = "strictly between" if free else "between"
    raise InputError(
        f"{parameter.path} = {value:g}{unit} is outside its bounds: "
        f"choose a value {between} {lower:g} and {upper:g}{unit}"
    )


def is_concrete(value: Any) -> bool:
    """Return whether a value is known, rather than traced by JAX."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))
