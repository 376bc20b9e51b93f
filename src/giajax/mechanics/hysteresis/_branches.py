"""Compensation of the paper, eq. (12), from the two inverse branches of a measured loop."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError
from ...schema import BRANCH_COMPENSATOR
from ...schema.parameters import is_concrete, parameter
from ._operator import AbstractExactOperator, clip, play

_LEAST = 4  # smallest number of samples of a branch


class MonotoneCurve(eqx.Module):
    """Piecewise linear curve that never decreases and is constant beyond its ends.

    Attributes:
        x: increasing positions of the points.
        y: values at the points, which never decrease.
    """

    x: Float[Array, " point"]
    y: Float[Array, " point"]

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the value of the curve at x."""
        return jnp.interp(x, self.x, self.y)


class BranchCompensator(AbstractExactOperator):
    """Compensator E = xi F + (1 - xi) T (eq. 12): the command for a desired output.

    F and T are the inverse rising and falling branches of a measured loop, which map the desired
    output to the command. After a reversal, xi changes linearly and continuously from its current
    value towards 1 (rising) or 0 (falling). A change from 0 to 1 takes the distance `travel`. xi is
    therefore a stop operator with a threshold of half the travel, scaled to the range from 0 to 1.

    Arguments:
        rising: inverse rising branch F.
        falling: inverse falling branch T.
        travel: change of the desired output that moves the command from one branch to the
            other, in the unit of the desired output; positive.

    Raises:
        InputError: the travel is not positive.
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
        """Lowest and highest output that both branches reach."""
        return (
            float(jnp.maximum(self.rising.x[0], self.falling.x[0])),
            float(jnp.minimum(self.rising.x[-1], self.falling.x[-1])),
        )

    def reset(self) -> Scalar:
        """Return the memory for a command midway between the branches at a desired output of 0."""
        return jnp.zeros_like(self.travel)

    def step(self, state: Scalar, value: Scalar) -> tuple[Scalar, Scalar]:
        """Return memory and command after the desired output has changed to a value."""
        half = self.travel / 2
        state = clip(state, value - half, value + half)
        return state, self._command(value, state)

    def history(
        self, inputs: Float[Array, " sample"], state: Scalar | None = None
    ) -> tuple[Float[Array, " sample"], Scalar]:
        """Return the commands for a history of desired outputs, and the final memory."""
        memory = None if state is None else state[None]
        plays = play(inputs, self.travel[None] / 2, memory)[:, 0]
        return self._command(inputs, plays), plays[-1]

    def transition(self, inputs: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """Return xi for a history of desired outputs, between 0 and 1."""
        return self._xi(inputs, play(inputs, self.travel[None] / 2)[:, 0])

    def _xi(self, value: Array, memory: Array) -> Array:
        return (value - memory) / self.travel + 0.5

    def _command(self, value: Array, memory: Array) -> Array:
        xi = self._xi(value, memory)
        return xi * self.rising(value) + (1 - xi) * self.falling(value)


def branches_from_loop(
    inputs: npt.ArrayLike, outputs: npt.ArrayLike, travel: float
) -> BranchCompensator:
    """Create the compensator of a measured loop, which maps a desired output to a command.

    Isotonic regression (pool adjacent violators) makes each branch monotone, so the curve has an
    inverse even if noise or a fold makes the measurement non-monotone.

    Arguments:
        inputs: command at each sample, shape (sample,).
        outputs: measured output, NaN where it is missing, shape (sample,).
        travel: see `BranchCompensator`.

    Raises:
        InputError: a branch is missing or too short, or its output decreases with the input.

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
                "few for a curve: give a loop that rises and falls over the whole range"
            )
        if np.cov(u[on], y[on])[0, 1] < 0:
            raise InputError(
                f"on the {name} branch the output decreases where the input increases: change the "
                "sign of one column"
            )
        curves.append(_inverse_curve(u[on], y[on]))
    rising, falling = curves
    return BranchCompensator(rising, falling, jnp.asarray(travel, dtype=jnp.result_type(float)))


def _directions(u: np.ndarray) -> np.ndarray:
    """Return the sign of the last change of the input at each sample."""
    steps = np.sign(np.diff(u, prepend=u[:1]))
    moved = np.flatnonzero(steps)
    if moved.size == 0:
        return steps
    last = np.maximum.accumulate(np.where(steps != 0, np.arange(len(u)), moved[0]))
    return steps[last]


def _inverse_curve(u: np.ndarray, y: np.ndarray) -> MonotoneCurve:
    order = np.argsort(u, kind="stable")
    levels = isotonic(y[order])
    # If several inputs have the same output, the inverse is their mean.
    x, first, counts = np.unique(levels, return_index=True, return_counts=True)
    sums = np.add.reduceat(u[order], first)
    dtype = jnp.result_type(float)
    return MonotoneCurve(jnp.asarray(x, dtype), jnp.asarray(sums / counts, dtype))


def isotonic(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the non-decreasing sequence nearest to values in least squares.

    The method is the pool-adjacent-violators algorithm.
    """
    pools: list[tuple[float, int]] = []
    for value in values:
        mean, count = float(value), 1
        while pools and pools[-1][0] > mean:
            before, size = pools.pop()
            mean = (before * size + mean * count) / (size + count)
            count += size
        pools.append((mean, count))
    return np.repeat([mean for mean, _ in pools], [count for _, count in pools])
