"""Roots of a scalar function between two points where its sign differs."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from .._typing import Array, Scalar

if TYPE_CHECKING:
    from optimistix import Solution

# Halvings after which 90 deg are less than the rounding of a double.
_HALVINGS = 56
_NEWTON_STEPS = 8


def bisect(
    function: Callable[[Array], Array],
    lower: Scalar,
    upper: Scalar,
    signs: tuple[Scalar, Scalar] | None = None,
) -> Scalar:
    """A point between `lower` and `upper` where the sign changes; NaN where it does not.

    Arguments:
        function: of one point.
        lower, upper: the two points.
        signs: of the function at both, where they are known. A root at one of them is lost where
            another evaluation rounds to the other sign.

    Returns:
        The point.
    """
    start, end = signs or (jnp.sign(function(lower)), jnp.sign(function(upper)))
    differs = start * end <= 0

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        same = jnp.sign(function(middle)) == start
        return jnp.where(same, middle, low), jnp.where(same, high, middle)

    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (lower, upper))
    return jnp.where(differs, (low + high) / 2, jnp.nan)


def polish(
    function: Callable[[Array, Any], Array], guess: Scalar, arguments: Any
) -> tuple[Scalar, Array]:
    """The root near a guess by Newton's method, differentiable in `arguments` (implicitly).

    Returns:
        The root, and whether the method converged.
    """
    # Slow to import, and needed only where a program is traced.
    import optimistix as optx

    tolerance = 8 * float(jnp.finfo(guess.dtype).eps)
    solution: Solution = optx.root_find(
        function,
        optx.Newton(rtol=tolerance, atol=tolerance),
        jax.lax.stop_gradient(guess),
        args=arguments,
        max_steps=_NEWTON_STEPS,
        throw=False,
    )
    return solution.value, jnp.asarray(solution.result == optx.RESULTS.successful)
