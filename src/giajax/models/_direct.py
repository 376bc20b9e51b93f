"""Models without a solver to choose, whose runs have no state of their own."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ..runs import Run
from ._protocol import AbstractModel, Integration


class AbstractDirectModel(AbstractModel):
    """A model without a solver to choose, whose runs have no state of their own.

    Says for all such models what they would say alike; the arm is the one that has both.
    """

    def unseen(self, inputs: Any, channels: tuple[str, ...]) -> dict[str, npt.NDArray[np.bool_]]:
        """None: whatever it has can be recorded at any time."""
        return {}

    def variants(self) -> dict[str, Self]:
        """None: it has no choice that parameters do not make."""
        return {}

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """None: a run has no state of its own."""
        return ()

    def initial_section(self, inputs: Any) -> dict[str, Any]:
        """Nothing: a run has no state of its own."""
        return {}

    def integration(self) -> Integration | None:
        """None: there is no solver to choose."""
        return None

    def with_integration(self, *, solver: str | None, tolerance: float | None) -> Self:
        """Refused: there is no solver to choose.

        Raises:
            InputError: always.
        """
        raise InputError(
            f"the {self.kind} model has neither a solver nor a tolerance: leave both out"
        )

    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """The same: no step of it depends on what is differentiated."""
        return self
