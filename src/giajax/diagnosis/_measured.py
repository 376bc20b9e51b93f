"""Fits of one ladder, measured by one likelihood."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np

from ..fitting import FitResult, Response, Suspect, rho
from ..runs import Run
from ..study import begun_as_fitted
from ._ended import Moved, responses_of
from ._rung import Rung
from ._weights import white_noise

Noise = Sequence[Mapping[str, float]]
"""Standard deviation of white noise (SI) of each run, by channel."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """A fit and what it leaves over, to be compared with others under the same noise.

    Minus twice the logarithm of the likelihood is, up to a constant, the sum of what the loss
    makes of each residual over its noise, which must be that of all fits that are compared: what
    each fit would take for noise, or for an outlier, is larger where it describes less.

    Attributes:
        suspect, removed: as of a `Rung`.
        result: the fit.
        at: what it predicts for each run.
        noise: white noise, as stated or as this fit's residuals show it.
        moved: its coordinates, and what was known of them.
        apart: of what was held out, by run and channel: the noise that is stated, and the errors.
    """

    suspect: Suspect | None
    removed: bool
    result: FitResult
    at: list[Response]
    noise: Noise
    moved: Moved
    apart: list[tuple[str, float | None, np.ndarray]]

    @classmethod
    def of(
        cls,
        result: FitResult,
        runs: Sequence[Run],
        apart: Sequence[Run],
        suspect: Suspect | None = None,
        *,
        removed: bool = False,
    ) -> Self:
        """A fit of some runs, and what it makes of those that were held out."""
        at = responses_of(result, runs, result.model)
        noise = white_noise(result, runs, at)
        moved = Moved.of(result)
        return cls(suspect, removed, result, at, noise, moved, _errors(result, apart))

    def rung(self, noise: Noise) -> Rung:
        """The fit under a noise that may be another one's."""
        chi_square, values, loss = self.moved.squares, 0, self.result.config.get("loss", "linear")
        for response, deviations in zip(self.at, noise, strict=True):
            sigma = [_deviation(deviations, name) for name in response.channels]
            rest = (response.predicted - response.observed) / np.asarray(sigma)
            rest = rest[~np.isnan(response.observed)]
            chi_square += float(np.sum(rho(loss, rest)))
            values += len(rest)
        squares = [
            (rest / (stated or _deviation(_nearest(noise, name), name))) ** 2
            for name, stated, rest in self.apart
        ]
        return Rung(
            suspect=self.suspect,
            chi_square=chi_square,
            parameters=self.moved.size,
            values=values,
            held_out=float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None,
            result=self.result,
            removed=self.removed,
        )


def _nearest(noise: Noise, name: str) -> Mapping[str, float]:
    """That of a run with the channel; of one that none has, the first one's."""
    return next((deviations for deviations in noise if name in deviations), noise[0])


def _deviation(deviations: Mapping[str, float], name: str) -> float:
    """That of a channel; of one that had another name, or was not fitted, the mean of its kind."""
    if known := deviations.get(name):
        return known
    kind = name.rpartition("_")[0]
    alike = [one for other, one in deviations.items() if other.rpartition("_")[0] == kind]
    return float(np.mean(alike or list(deviations.values())))


def _errors(result: FitResult, runs: Sequence[Run]) -> list[tuple[str, float | None, np.ndarray]]:
    errors = []
    for run in runs:
        for name, predicted in result.predict(begun_as_fitted(result, run)).items():
            rest = predicted - run.observations[name]
            errors.append((name, run.noise(name), rest[~np.isnan(rest)]))
    return errors
