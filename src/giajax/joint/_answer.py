"""Answer to the question which pressure gives a force, and why none does."""

import equinox as eqx

from .._typing import Array, Bool, Float, Int

REACHED, NEEDS_PUSH, NEEDS_PRESSURE, TOO_SHORT, PULLS_ANYWAY = range(5)

_MEANING = {
    REACHED: "reached",
    NEEDS_PUSH: "the muscle would have to push, which it cannot: raise the co-contraction torque",
    NEEDS_PRESSURE: "it takes more than the pressure limit: ask for less, or a wider muscle",
    TOO_SHORT: "the muscle does not shorten so far at any pressure: ask for less contraction",
    PULLS_ANYWAY: "it has more force than that without any pressure: ask for more",
}


class PressureAnswer(eqx.Module):
    """Pressure for a force; arrays of one shape.

    Attributes:
        pressure: within 0 and the muscle's limit, Pa. Where the force is out of reach, the
            pressure that comes nearest to it.
        force: what the muscle pulls with at that pressure, N.
        code: 0 reached, 1 the muscle would have to push, 2 more than the pressure limit, 3 it
            does not shorten so far at any pressure, 4 it has more force without any pressure.
    """

    pressure: Float[Array, "*shape"]
    force: Float[Array, "*shape"]
    code: Int[Array, "*shape"]

    @property
    def reached(self) -> Bool[Array, "*shape"]:
        """Whether the force is what was asked for."""
        return self.code == REACHED

    def message(self, index: int | tuple[int, ...] = ()) -> str:
        """What the code of one element means, and what to do.

        Arguments:
            index: of the element.

        Returns:
            The sentence; "reached" where the force is.
        """
        return _MEANING[int(self.code[index])]
