"""Fields of modules that are parameters."""

from collections.abc import Callable
from typing import Any, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._maths import on_device
from ..quantities import Declaration

DECLARED = "giajax.parameter"
"""Metadata of a field that is a parameter: its declaration."""

INLINE = "giajax.inline"
"""Metadata of a field whose own name is not in the paths of its parameters."""


@overload
def parameter(declared: Declaration, /) -> Any: ...
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
def parameter(declared: Declaration | float, /, **about: Any) -> Any:
    """Field of an Equinox module that is a parameter.

    The value is converted to an array of the default floating-point type, strongly typed: a
    weakly typed scalar would compile every program twice.

    Arguments:
        declared: the declaration, of `giajax.quantities`; or a default (SI), for a model of
            your own, with the rest of its declaration as keywords.
        about: the rest of a declaration; `unit` and `doc` are needed.

    Example:
        >>> import equinox as eqx
        >>> import jax
        >>> from giajax.parameters import parameter
        >>> from giajax.quantities import AIR
        >>> class Ball(eqx.Module):
        ...     density: jax.Array = parameter(AIR.density)
        ...     radius: jax.Array = parameter(0.1, unit="m", lower=0, doc="radius of the ball")
        >>> float(Ball().density)
        1.204
    """
    if not isinstance(declared, Declaration):
        declared = Declaration(declared, **about)
    return eqx.field(
        converter=_converter(declared),
        default=None if declared.optional else declared.default,
        metadata={DECLARED: declared},
    )


def _converter(declaration: Declaration) -> Callable[[Any], Any]:
    def convert(value: Any) -> Any:
        if value is None and declaration.optional:
            return None
        dtype = jnp.result_type(float)
        if not any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(value)):
            # By numpy: JAX would compile a program to convert a list, or integers.
            value = on_device(np.array(value, dtype))
        array = jnp.asarray(value, dtype=dtype)
        shape = declaration.shape
        return jnp.broadcast_to(array, shape) if shape and array.ndim == 0 else array

    return convert


HELD = "giajax.held"
"""Metadata of a field whose parameters a fit finds only where it is asked for them."""


def held(*, inline: bool = False, **options: Any) -> Any:
    """Field whose parameters are all frozen in this owner, whatever they are elsewhere.

    `inline` is as of the function of that name; `options` are those of `equinox.field`.
    """
    return eqx.field(metadata={HELD: True, INLINE: inline}, **options)


def inline(**options: Any) -> Any:
    """Field whose parameters appear in the paths of its owner without the field's own name.

    `options` are those of `equinox.field`, such as `default_factory`.
    """
    return eqx.field(metadata={INLINE: True}, **options)


def declaration(module: type[eqx.Module], field: str) -> Declaration:
    """The declaration at a field of a module class."""
    return module.__dataclass_fields__[field].metadata[DECLARED]
