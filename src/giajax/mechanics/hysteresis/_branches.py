"""The paper's compensation, eq. (12): between the inverse branches of a measured loop."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError
from ...schema import BRANCH_COMPENSATOR
from ...schema.parameters import is_concrete, parameter
from ._operator import AbstractExactOperator, clip, play

_LEAST = 4  # with fewer rows than this a branch is no curve


class MonotoneCurve(eqx.Module):
    """Piecewise linear curve, x increasing and y never falling; constant beyond its ends."""

    x: Float[Array, " point"]
    y: Float[Array, " point"]

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """The curve at x."""
        return jnp.interp(x, self.x, self.y)


class BranchCompensator(AbstractExactOperator):
    """E = xi F + (1 - xi) T (eq. 12): the command to send for a desired output.

    F and T are the inverse rising and falling branches of a measured loop, from the desired
    output to the command. After a reversal xi goes linearly from 0 (falling) to 1 (rising), or
    back, within the travel, and from wherever it was: it is continuous. So it is a stop of half
    the travel, scaled to 0 .. 1.

    Arguments:
        rising: F.
        falling: T.
        travel: how far the desired output goes between the two, in its unit; positive.

    Raises:
        InputError: a travel that is not positive.
    """

    rising: MonotoneCurve
    falling: MonotoneCurve
    travel: Scalar = parameter(BRANCH_COMPENSATOR.travel)

    def __check_init__(self) -> None:
        if is_concrete(self.travel) and not 0 < float(self.travel) < np.inf:
            raise InputError(
                f"the travel is {float(self.travel):g}: give a positive travel in the unit of the "
                "desired output"
            )

    @property
    def reachable(self) -> tuple[float, float]:
        """Outputs that both branches reach."""
        return (
            float(jnp.maximum(self.rising.x[0], self.falling.x[0])),
            float(jnp.minimum(self.rising.x[-1], self.falling.x[-1])),
        )

    def reset(self) -> Scalar:
        """In the middle between the branches."""
        return jnp.zeros_like(self.travel)

    def step(self, state: Scalar, value: Scalar) -> tuple[Scalar, Scalar]:
        """Memory and command after the desired output has moved."""
        half = self.travel / 2
        state = clip(state, value - half, value + half)
        return state, self._command(value, state)

    def history(
        self, inputs: Float[Array, " sample"], state: Scalar | None = None
    ) -> tuple[Float[Array, " sample"], Scalar]:
        """Commands for a history of desired outputs."""
        memory = None if state is None else state[None]
        plays = play(inputs, self.travel[None] / 2, memory)[:, 0]
        return self._command(inputs, plays), plays[-1]

    def transition(self, inputs: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """xi along a history of desired outputs, between 0 and 1."""
        return self._xi(inputs, play(inputs, self.travel[None] / 2)[:, 0])

    def _xi(self, value: Array, memory: Array) -> Array:
        return (value - memory) / self.travel + 0.5

    def _command(self, value: Array, memory: Array) -> Array:
        xi = self._xi(value, memory)
        return xi * self.rising(value) + (1 - xi) * self.falling(value)


def branches_from_loop(
    inputs: npt.ArrayLike, outputs: npt.ArrayLike, travel: float
) -> BranchCompensator:
    """The compensator, from a desired output to the command, that a measured loop gives.

    Each branch is made monotone by isotonic regression (pool adjacent violators), so that noise
    and a fold of the measurement leave a curve that has an inverse.

    Arguments:
        inputs: the command at each sample, shape (sample,).
        outputs: the measured output, NaN where there is none, shape (sample,).
        travel: see `BranchCompensator`.

    Raises:
        InputError: a history without both branches, too short for them, or with falling ones.

    Example:
        >>> from giajax.mechanics.hysteresis import branches_from_loop
        >>> up, down = [-2.0, -1.0, 0.0, 1.0, 2.0], [2.0, 1.0, 0.0, -1.0, -2.0]
        >>> measured = [-2.0, -1.5, -0.5, 0.5, 2.0, 2.0, 1.5, 0.5, -0.5, -2.0]
        >>> compensator = branches_from_loop(up + down, measured, travel=0.5)
        >>> float(compensator.rising(0.5)), float(compensator.falling(0.5))
        (1.0, 0.0)
    """
    u, y = np.asarray(inputs, dtype=float), np.asarray(outputs, dtype=float)
    direction = _directions(u)
    curves = []
    for sign, name in ((1, "rising"), (-1, "falling")):
        on = (direction == sign) & ~np.isnan(y)
        if np.count_nonzero(on) < _LEAST or np.ptp(u[on]) == 0 or np.ptp(y[on]) == 0:
            raise InputError(
                f"the {name} branch of the loop has {np.count_nonzero(on)} measured samples, too "
                "few for a curve: give a loop that goes up and down over the whole range"
            )
        if np.cov(u[on], y[on])[0, 1] < 0:
            raise InputError(
                f"on the {name} branch the output decreases where the input increases: change the "
                f"sign "
                "of one column"
            )
        curves.append(_inverse_curve(u[on], y[on]))
    rising, falling = curves
    return BranchCompensator(rising, falling, jnp.asarray(travel, dtype=jnp.result_type(float)))


def _directions(u: np.ndarray) -> np.ndarray:
    """1 where the input has last risen, -1 where it has last fallen."""
    steps = np.sign(np.diff(u, prepend=u[:1]))
    moved = np.flatnonzero(steps)
    if moved.size == 0:
        return steps
    last = np.maximum.accumulate(np.where(steps != 0, np.arange(len(u)), moved[0]))
    return steps[last]


def _inverse_curve(u: np.ndarray, y: np.ndarray) -> MonotoneCurve:
    order = np.argsort(u, kind="stable")
    levels = isotonic(y[order])
    # Where the output stays the same over several inputs, the middle of them is the answer.
    x, first, counts = np.unique(levels, return_index=True, return_counts=True)
    sums = np.add.reduceat(u[order], first)
    dtype = jnp.result_type(float)
    return MonotoneCurve(jnp.asarray(x, dtype), jnp.asarray(sums / counts, dtype))


def isotonic(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The nearest sequence that never decreases, in least squares (pool adjacent violators)."""
    pools: list[tuple[float, int]] = []
    for value in values:
        mean, count = float(value), 1
        while pools and pools[-1][0] > mean:
            before, size = pools.pop()
            mean = (before * size + mean * count) / (size + count)
            count += size
        pools.append((mean, count))
    return np.repeat([mean for mean, _ in pools], [count for _, count in pools])
