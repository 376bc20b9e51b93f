"""What may have differed between the paper's model and the arm that it was compared with."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from .._typing import Array
from ._unknown_experiment import UNKNOWNS

_SHARED = ("stiffness", "damping", "drag")


@dataclasses.dataclass(frozen=True)
class Reading:
    """What is taken to differ between the arm and the paper's model.

    Attributes:
        label: in words.
        free: names of `UNKNOWNS` that are looked for.
        shared: names of those that the model has from the arm.
    """

    label: str
    free: tuple[str, ...]
    shared: tuple[str, ...] = ()

    def spread(self) -> np.ndarray:
        """Changes of all logarithms by those that are free, shape (unknown, free)."""
        names = list(UNKNOWNS)
        table = np.zeros((len(names), len(self.free)))
        for column, name in enumerate(self.free):
            table[names.index(name), column] = 1
            if name in self.shared:
                table[names.index(f"model_{name}"), column] = 1
        return table

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the ends of the ranges of what is free, SI, each of shape (free,)."""
        free = [UNKNOWNS[name] for name in self.free]
        low = np.log([unknown.lower * unknown.unit for unknown in free])
        return low, np.log([unknown.upper * unknown.unit for unknown in free])

    def all(self, free: np.ndarray) -> Array:
        """All logarithms, of those that are free; of what is neither free nor shared it is 0."""
        return jnp.asarray(self.spread() @ free)


_APART = ("reach", *(f"model_{name}" for name in _SHARED))
READINGS = {
    "memory": Reading(
        "only its joints remember",
        tuple(name for name in UNKNOWNS if name not in _APART),
        shared=_SHARED,
    ),
    "own": Reading("all of it may differ", tuple(UNKNOWNS)),
}
"""The paper's own explanation of its errors, and one that allows for any."""
