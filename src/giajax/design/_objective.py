"""The error to expect of a command, over what is uncertain, as a function with a gradient."""

import dataclasses
from typing import Literal, get_args

import numpy as np

from .._errors import InputError
from .._typing import Float
from ._command import CommandSeries, Numbers
from ._criterion import Criterion
from ._information import Experiment, Informed, informed
from ._markers import check_count, chosen_markers

Over = Literal["mean", "worst"]
_OVER: tuple[str, ...] = get_args(Over)


@dataclasses.dataclass
class RobustError:
    """Logarithm of the error to expect: its mean over draws, or the worst of them.

    Arguments:
        experiment: what is recorded.
        series: of the command.
        draws: values of the parameters that may be true, SI, shape (draw, parameter).
        known: information that priors are, in the scales of the experiment.
        criterion: what is to be small.
        count: how many bodies may be recorded.
        over: "mean" or "worst".
        markers: positions of the bodies that are recorded at present.

    Raises:
        InputError: another word for `over`, or more bodies than there are.
    """

    experiment: Experiment
    series: CommandSeries
    draws: Float[np.ndarray, "draw parameter"]
    known: Float[np.ndarray, "parameter parameter"]
    criterion: Criterion
    count: int
    over: str = "mean"
    markers: tuple[int, ...] = ()
    _seen: tuple[bytes, Informed] | None = None

    def __post_init__(self) -> None:
        check_count(self.count, 1 + max(self.experiment.bodies))
        if self.over not in _OVER:
            raise InputError(f"there is no robust '{self.over}': use one of: {', '.join(_OVER)}")

    def __call__(self, numbers: Numbers) -> tuple[float, Float[np.ndarray, " number"]]:
        """The logarithm and its gradient; NaN where a draw cannot be simulated."""
        found = self._informed(numbers)
        if not np.all(found.successful):
            return np.nan, np.full(len(numbers), np.nan)
        some = list(self.markers)
        values, slopes = [], []
        for information, slope in zip(found.values, found.slopes, strict=True):
            value, by_information = self._error(information[some].sum(axis=0))
            values.append(value)
            slopes.append(np.einsum("ij,nij->n", by_information, slope[:, some].sum(axis=1)))
        if self.over == "worst":
            worst = int(np.argmax(values))
            return values[worst], slopes[worst]
        return float(np.mean(values)), np.mean(slopes, axis=0)

    def leave_out_failing(self, numbers: Numbers) -> None:
        """Leave out the draws with which a command cannot be simulated; the first one stays."""
        successful = np.asarray(self._informed(numbers).successful).astype(bool).ravel()
        if not np.all(successful[1:]):
            self.draws = self.draws[[True, *successful[1:]]]
            self._seen = None

    def choose(self, numbers: Numbers) -> None:
        """Change to the bodies that tell most of a command."""
        found = self._informed(numbers)
        if np.all(found.successful):
            self.markers = self.chosen(found.values)
        elif not self.markers:
            self.markers = tuple(range(self.count))

    def chosen(
        self, informations: Float[np.ndarray, "draw body parameter parameter"]
    ) -> tuple[int, ...]:
        """The bodies that tell most."""
        return chosen_markers(self._over_draws, informations.swapaxes(0, 1), self.count)

    def each(self, numbers: Numbers) -> np.ndarray:
        """Logarithm of the error of each draw, shape (draw,)."""
        informations = self._informed(numbers).values[:, list(self.markers)].sum(axis=1)
        return np.asarray([self._error(one)[0] for one in informations])

    def _over_draws(self, informations: np.ndarray) -> float:
        values = [self._error(one)[0] for one in informations]
        return float(np.max(values) if self.over == "worst" else np.mean(values))

    def _error(self, information: np.ndarray) -> tuple[float, np.ndarray]:
        return self.criterion.of_information(information + self.known)

    def _informed(self, numbers: Numbers) -> Informed:
        key = np.asarray(numbers, dtype=float).tobytes()
        if self._seen is None or self._seen[0] != key:
            self._seen = key, informed(self.experiment, self.series.at(numbers), self.draws)
        return self._seen[1]
