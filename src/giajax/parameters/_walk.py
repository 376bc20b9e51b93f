"""The parameters of a model: how to reach each, and which there are."""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._typing import Array
from ..quantities import Declaration
from ._field import DECLARED, HELD, INLINE

Module = TypeVar("Module", bound=eqx.Module)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A declared parameter of one model: its path, its declaration and how to reach it.

    Parts of a model that declare the same path share it: it is then in several places.
    """

    path: str
    declaration: Declaration
    getters: tuple[Callable[[Any], Any], ...]
    index: int | None = None

    def value(self, model: eqx.Module) -> Array:
        """The parameter's array in a model (one element where the path has an index)."""
        array = next(array for get in self.getters if (array := get(model)) is not None)
        return array if self.index is None else array[self.index]

    def is_on(self, model: eqx.Module) -> bool:
        """Whether the model has this parameter, or leaves its part out."""
        return any(get(model) is not None for get in self.getters)

    @property
    def is_shared(self) -> bool:
        """Whether several parts of the model have it."""
        return len(self.getters) > 1

    @property
    def any_number(self) -> bool:
        """Whether it may get another number of elements than it has."""
        return self.declaration.any_number and self.index is None

    def set(self, model: Module, value: Any) -> Module:
        """The model with this parameter replaced; differentiable in `value`.

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
            model = eqx.tree_at(getter, model, value, is_leaf=lambda leaf: leaf is None)
            _check(model)
            return model
        value = jnp.asarray(value, dtype=old.dtype)
        if self.index is not None:
            new = old.at[self.index].set(value)
        elif (self.declaration.each and value.ndim > old.ndim) or (self.any_number and value.ndim):
            new = value
        else:
            new = jnp.broadcast_to(value, old.shape)
        return eqx.tree_at(getter, model, new)


def declared(model: eqx.Module) -> dict[str, Parameter]:
    """All parameters of a model by dotted path, in the order of their fields.

    Optional ones that the model leaves out are not among them; see `left_out`.
    """
    return {path: p for path, p in _by_path(model).items() if p.is_on(model)}


def left_out(model: eqx.Module) -> dict[str, Parameter]:
    """The optional parameters that a model leaves out, by dotted path.

    `replace` switches one on, by giving it a value.
    """
    return {path: p for path, p in _by_path(model).items() if not p.is_on(model)}


def default_free(model: eqx.Module, started: Iterable[str] = ()) -> tuple[str, ...]:
    """Paths that a fit frees by default: those whose declaration is not frozen.

    What the model holds at a bound, such as the spring of a pendulum at zero, is left out of it
    on purpose, and stays so, unless it is among those that have a start.
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


def _by_path(model: eqx.Module) -> dict[str, Parameter]:
    """All parameters, those that are left out too; of those that parts share, one."""
    parameters: dict[str, Parameter] = {}
    for found in _walk(model, "", lambda root: root):
        known = parameters.get(found.path)
        if known is not None:
            # Held in one part, it is free where another part's recordings tell it.
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
            yield from (
                map(_frozen, _walk(child, inner, reach)) if held else _walk(child, inner, reach)
            )
        elif isinstance(child, tuple):
            for index, part in enumerate(child):
                if isinstance(part, eqx.Module):
                    yield from _walk(part, inner, _element(reach, index))
        elif isinstance(child, dict):
            for name, part in child.items():
                if isinstance(part, eqx.Module):
                    yield from _walk(part, f"{inner}{name}.", _element(reach, name))


def _frozen(parameter: Parameter) -> Parameter:
    declaration = dataclasses.replace(parameter.declaration, frozen=True)
    return dataclasses.replace(parameter, declaration=declaration)


def checked(model: Module) -> Module:
    """The model, after what its classes check when it is built."""
    _check(model)
    return model


def _check(node: eqx.Module) -> None:
    """What the classes of a model check when it is built: not every option suits every model."""
    check = getattr(node, "__check_init__", None)
    if check is not None:
        check()
    for field in dataclasses.fields(node):
        child = getattr(node, field.name)
        several = child.values() if isinstance(child, dict) else child
        for part in several if isinstance(child, tuple | dict) else (child,):
            if isinstance(part, eqx.Module):
                _check(part)


def _attribute(getter: Callable[[Any], Any], name: str) -> Callable[[Any], Any]:
    return lambda root: getattr(getter(root), name)


def _element(getter: Callable[[Any], Any], index: int | str) -> Callable[[Any], Any]:
    return lambda root: getter(root)[index]
