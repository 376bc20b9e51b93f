"""Prepared runs of several lengths as one pytree with a leading run axis."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from .._typing import Array


def stacked(trees: Sequence[Any]) -> Any:
    """Stack pytrees, repeating last rows where the first axes differ (see `prepare`)."""

    def stack(*leaves: Array) -> Array:
        length = max(leaf.shape[0] if leaf.ndim else 0 for leaf in leaves)
        return jnp.stack(
            [
                jnp.concatenate([leaf, jnp.repeat(leaf[-1:], length - leaf.shape[0], axis=0)])
                if leaf.ndim and leaf.shape[0] < length
                else leaf
                for leaf in leaves
            ]
        )

    return jax.tree.map(stack, *trees)
