"""The command series that lowers a criterion most: sequential quadratic programmes.

The set of series within the limits is convex and its borders are linear, so that each iterate of
SLSQP (Kraft 1988) is an experiment that may be made. Far from convex is what is minimised: several
starts are looked at, and the best few of them followed.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from .._typing import Float
from ._command import CommandSeries, Numbers

# What a command that cannot be simulated is worse by than the best one, in logarithms.
_WORSE = 3.0

# How often markers are chosen again for what was found with others.
_CHOICES = 3

# What SLSQP returns at the iteration limit.
_LIMIT = 9

_SEED = 1

# Change of the logarithm of the error below which a search has ended.
_TOLERANCE = 1e-3


class Objective(Protocol):
    """What is minimised over the numbers of a command, for some choice of markers."""

    markers: tuple[int, ...]

    def __call__(self, numbers: Numbers) -> tuple[float, Float[np.ndarray, " number"]]:
        """The logarithm of the error and its gradient; NaN where nothing can be simulated."""

    def choose(self, numbers: Numbers) -> None:
        """Change to the markers that tell most of a command."""


class Evaluation(NamedTuple):
    """What `progress` hears of.

    Attributes:
        number: of the evaluation, from 1.
        start: number of the start that is followed, from 1; 0 while starts are compared.
        value: logarithm of the error to expect.
        best: the smallest one so far.
    """

    number: int
    start: int
    value: float
    best: float


@dataclasses.dataclass
class Search:
    """A search that can be interrupted, and then has the best so far.

    Attributes:
        objective: what is minimised.
        series: of the command.
        progress: hears of each evaluation; may raise KeyboardInterrupt.
        best: numbers of the best command so far; None before the first evaluation.
        markers: that were chosen for it.
        value: of it.
        evaluations: all of them.
        interrupted: whether it was stopped.
        limited: whether the descent to the best one ended at the iteration limit.
    """

    objective: Objective
    series: CommandSeries
    progress: Callable[[Evaluation], None] | None = None
    best: Numbers | None = None
    markers: tuple[int, ...] = ()
    value: float = np.inf
    evaluations: list[Evaluation] = dataclasses.field(default_factory=list)
    interrupted: bool = False
    limited: bool = False
    _start: int = 0

    def follow(self, starts: Sequence[Numbers], most: int, iterations: int) -> None:
        """Look at all starts, and follow the best ones.

        Arguments:
            starts: numbers of commands within the limits.
            most: how many of them to follow.
            iterations: of the optimiser, from each.

        Raises:
            KeyboardInterrupt: nothing was evaluated yet.
        """
        try:
            values = [self._begin(start) for start in starts]
            order = np.argsort(np.nan_to_num(values, nan=np.inf), kind="stable")
            for number, index in enumerate(order[:most], 1):
                self._start = number
                if np.isfinite(values[index]):
                    self._descend(starts[index], iterations)
        except KeyboardInterrupt:
            if self.best is None:
                raise
            self.interrupted = True

    def _begin(self, numbers: Numbers) -> float:
        self.objective.choose(numbers)
        return self._evaluate(numbers)[0]

    def _descend(self, numbers: Numbers, iterations: int) -> None:
        # Slow to import, and only needed here.
        from scipy.optimize import minimize

        chosen = None
        # Once more where other markers tell more of what was found.
        for _ in range(_CHOICES):
            self.objective.choose(numbers)
            if self.objective.markers == chosen:
                return
            chosen = self.objective.markers
            before = self.value
            end = minimize(
                self._safe,
                numbers,
                jac=True,
                method="SLSQP",
                bounds=[(-1.0, 1.0)] * len(numbers),
                constraints=[self.series.constraint()],
                options={"maxiter": iterations, "ftol": _TOLERANCE},
            )
            numbers = end.x
            if self.value < before:
                self.limited = end.status == _LIMIT

    def _safe(self, numbers: Numbers) -> tuple[float, np.ndarray]:
        value, slope = self._evaluate(numbers)
        if np.isfinite(value) and np.all(np.isfinite(slope)):
            return value, slope
        return self.value + _WORSE, np.zeros_like(numbers)

    def _evaluate(self, numbers: Numbers) -> tuple[float, np.ndarray]:
        # What rounding moved beyond a limit is put back.
        numbers = self.series.within(numbers)
        value, slope = self.objective(numbers)
        if value < self.value:
            self.best, self.value, self.markers = numbers, value, self.objective.markers
        told = Evaluation(len(self.evaluations) + 1, self._start, value, self.value)
        self.evaluations.append(told)
        if self.progress is not None:
            self.progress(told)
        return value, slope


def starts_of(series: CommandSeries, count: int) -> list[Numbers]:
    """Commands to begin from: the paper's base step, swings to and fro, and random ones.

    Half of the angles of a random one are at a limit, as those of good experiments are.

    Arguments:
        series: of the command.
        count: how many; the same ones each time.
    """
    base = series.base_step()
    knots, joints = len(series.times) - 1, len(series.limits.joints)
    # A swing that is as wide as it may be, and takes a knot or two each way.
    swings = [
        np.repeat(np.where(np.arange(knots) // turn % 2 == 0, 1.0, -1.0), joints) for turn in (1, 2)
    ]
    random = np.random.default_rng(_SEED).uniform(-2, 2, (max(count - 3, 0), series.size))
    wanted = [base, *swings, *random]
    return [series.within(numbers) for numbers in wanted[:count]]
