"""Prepared runs of several lengths as one pytree with a leading run axis."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from .._maths import on_device
from .._typing import Array


def stacked(trees: Sequence[Any]) -> Any:
    """Stack pytrees, repeating last rows where the first axes differ (see `prepare`)."""

    def stack(*leaves: Array) -> Array:
        # By numpy: each shape would be a program of its own, compiled before the fit begins.
        rows = [np.asarray(leaf) for leaf in leaves]
        length = max(row.shape[0] if row.ndim else 0 for row in rows)
        return on_device(
            np.stack(
                [
                    np.concatenate([row, np.repeat(row[-1:], length - row.shape[0], axis=0)])
                    if row.ndim and row.shape[0] < length
                    else row
                    for row in rows
                ]
            )
        )

    return jax.tree.map(stack, *trees)
