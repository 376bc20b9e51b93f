"""Which way a simulation can be differentiated, and a sentence for the way it cannot."""

from typing import TYPE_CHECKING, Any, Literal, TypeVar

import equinox as eqx
import equinox.internal as eqxi
import jax

from .._errors import InputError

if TYPE_CHECKING:
    from diffrax import AbstractAdjoint

T = TypeVar("T")

Derivatives = Literal["forward", "reverse"]


def adjoint(derivatives: str) -> "AbstractAdjoint":
    """The diffrax adjoint that offers a mode of differentiation.

    Raises:
        InputError: neither "forward" nor "reverse".
    """
    # Slow to import, and needed only where a program is traced.
    import diffrax

    if derivatives == "forward":
        return diffrax.ForwardMode()
    if derivatives == "reverse":
        return diffrax.RecursiveCheckpointAdjoint()
    raise InputError(
        f"derivatives={derivatives!r} is unknown: use 'forward' (few parameters: jax.jvp, "
        "jax.jacfwd) or 'reverse' (many parameters: jax.grad, jax.vjp)"
    )


def guard_outputs(tree: T, derivatives: str) -> T:
    """The same values; a cotangent that enters a forward-mode simulation raises a sentence.

    Arguments:
        tree: outputs of a simulation.
        derivatives: "forward" or "reverse".
    """
    if derivatives != "forward":
        return tree
    return eqxi.nondifferentiable_backward(
        tree,
        msg="simulate(derivatives='forward') was differentiated in reverse mode (jax.grad, "
        "jax.vjp): call it with derivatives='reverse', or use jax.jvp or jax.jacfwd",
    )


def guard_inputs(tree: T, derivatives: str) -> T:
    """The same values; a tangent that enters a reverse-mode simulation raises a sentence.

    Arguments:
        tree: inputs of a simulation.
        derivatives: "forward" or "reverse".
    """
    if derivatives != "reverse":
        return tree
    arrays, rest = eqx.partition(tree, eqx.is_inexact_array)
    try:
        arrays = _reverse_only(arrays)
    except TypeError:
        raise TypeError(
            "simulate(derivatives='reverse') was differentiated in forward mode (jax.jvp, "
            "jax.jacfwd): call it with derivatives='forward', or use jax.grad or jax.vjp"
        ) from None
    return eqx.combine(arrays, rest)


@jax.custom_vjp
def _reverse_only(tree: Any) -> Any:
    return tree


# JAX refuses to push a tangent through a function with a custom vjp: that is the guard.
_reverse_only.defvjp(lambda tree: (tree, None), lambda _, cotangent: (cotangent,))
