"""The modified Prandtl-Ishlinskii operator: dead zones behind, for loops without symmetry.

Reference: K. Kuhnen, Eur. J. Control 9 (2003) 407-418.
"""

from typing import Any

import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import is_concrete, parameter
from ..quantities import MODIFIED_PRANDTL_ISHLINSKII
from ._dead_zones import DeadZones
from ._operator import AbstractExactOperator
from ._play import check_thresholds
from ._prandtl_ishlinskii import PrandtlIshlinskii


class ModifiedPrandtlIshlinskii(AbstractExactOperator):
    """y = S(H[u]): a memoryless curve of the output of a Prandtl-Ishlinskii operator of plays.

    H alone is odd and does not know where 0 is; S is neither: it gives loops without symmetry,
    and a region that is soft at an angle fixed on the joint.

    H = (u + sum of weights times plays) / (1 + sum of weights) has the slope 1 in large loops,
    because its scale and that of S cannot be separated.

    Arguments:
        dead_zones: S.
        weights: of the plays, relative to that of the input, shape (threshold,).
        thresholds: of the plays, in the unit of the input, shape (threshold,).

    Raises:
        InputError: lists of different lengths, or a negative threshold.
    """

    dead_zones: DeadZones
    weights: Float[Array, " threshold"] = parameter(MODIFIED_PRANDTL_ISHLINSKII.weights)
    thresholds: Float[Array, " threshold"] = parameter(MODIFIED_PRANDTL_ISHLINSKII.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)
        if is_concrete(self.weights) and self.weights.shape != self.thresholds.shape:
            raise InputError(
                f"there are weights of shape {self.weights.shape} and thresholds of shape "
                f"{self.thresholds.shape}: give one weight for each threshold"
            )

    @property
    def hysteresis(self) -> PrandtlIshlinskii:
        """H."""
        total = 1 + jnp.sum(self.weights)
        return PrandtlIshlinskii(1 / total, self.weights / total, self.thresholds)

    def reset(self) -> Float[Array, " threshold"]:
        """All plays at 0."""
        return jnp.zeros_like(self.thresholds)

    def step(
        self, state: Float[Array, " threshold"], value: Scalar
    ) -> tuple[Float[Array, " threshold"], Scalar]:
        """Plays and output after the input has moved."""
        state, output = self.hysteresis.step(state, value)
        return state, self.dead_zones(output)

    def history(
        self, inputs: Float[Array, " sample"], state: Float[Array, " threshold"] | None = None
    ) -> tuple[Float[Array, " sample"], Float[Array, " threshold"]]:
        """Outputs at all samples."""
        outputs, state = self.hysteresis.history(inputs, state)
        return self.dead_zones(outputs), state

    def inverse(self) -> "InverseModified":
        """The operator that undoes this one: first the inverse curve, then the inverse of H.

        Raises:
            InputError: H or S does not increase everywhere.
        """
        return InverseModified(self.dead_zones.inverse(), self.hysteresis.inverse())

    def inverse_state(self, state: Float[Array, " threshold"]) -> Float[Array, " threshold"]:
        """Memory of the inverse that belongs to a memory of this operator."""
        return self.hysteresis.inverse_state(state)


class InverseModified(AbstractExactOperator):
    """u = H^-1[S^-1(y)]: the exact inverse of a modified Prandtl-Ishlinskii operator.

    Arguments:
        dead_zones: the inverse of S.
        hysteresis: the inverse of H.
    """

    dead_zones: DeadZones
    hysteresis: PrandtlIshlinskii

    def reset(self) -> Any:
        """All plays at 0."""
        return self.hysteresis.reset()

    def step(self, state: Any, value: Scalar) -> tuple[Any, Scalar]:
        """Plays and output after the input has moved."""
        return self.hysteresis.step(state, self.dead_zones(value))

    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, " sample"], Any]:
        """Outputs at all samples."""
        return self.hysteresis.history(self.dead_zones(inputs), state)
