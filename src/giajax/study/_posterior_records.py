"""What a posterior is made of, as data; `posterior.json` is its summary."""

import dataclasses
import json
import math
from typing import Any, Self

import numpy as np

from .._errors import InputError
from .._typing import Float
from ..fitting import FitResult
from ._arviz import as_arviz
from ._marginal import Marginal

FORMAT = 1

# Where a normal variable is by 95 %, in deviations.
NORMAL = 1.959964


@dataclasses.dataclass(frozen=True)
class Band:
    """Where a channel of a run is predicted to be, SI, each of shape (sample,).

    Attributes:
        median: of the predictions of draws.
        low, high: 2.5 and 97.5 % of them: what the parameters leave open.
        noise: standard deviation of a recorded cell, as the fit left it: more than is stated where
            residuals exceed that.
        within: share of the recorded cells that are where noise and parameters together put 95 %;
            None where nothing was recorded.
    """

    median: Float[np.ndarray, " sample"]
    low: Float[np.ndarray, " sample"]
    high: Float[np.ndarray, " sample"]
    noise: float
    within: float | None

    def with_noise(self) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, " sample"]]:
        """Where 95 % of recorded cells are to be: both as if they were normal."""
        reach = NORMAL * self.noise
        low = self.median - np.hypot(self.median - self.low, reach)
        return low, self.median + np.hypot(self.high - self.median, reach)


@dataclasses.dataclass(frozen=True)
class PosteriorSummary:
    """What `posterior.json` says of a posterior.

    Attributes:
        parameters: by label, those of single runs with the run.
        chains, draws, warmup: how many chains there are, and transitions of each.
        asked: how many chains were asked for.
        seed: of the random numbers.
        divergences: draws at which the sampler lost the energy, or met where the model fails.
        scale: what the cost of the measured values was divided by.
        cost: of the fit that it is of.
        held: labels of what was free and is not drawn, because no channel responds to it.
        within: by run, each by another name, and channel, the share of the recorded cells within
            their 95 % band.
        warnings: sentences on what is wrong with the draws; empty where nothing is.
    """

    parameters: dict[str, Marginal]
    chains: int
    draws: int
    warmup: int
    asked: int
    seed: int
    divergences: int
    scale: float
    cost: float | None
    held: tuple[str, ...]
    within: dict[str, dict[str, float | None]]
    warnings: tuple[str, ...]

    def is_of(self, result: FitResult) -> bool:
        """Whether it is of this fit, and not of another one that was in its place."""
        return self.cost == result.cost

    def to_json(self) -> str:
        """As JSON; what is not finite is null."""
        record = {"giajax_posterior": FORMAT, **dataclasses.asdict(self)}
        return json.dumps(_plain(record), indent=2, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Self:
        """What `to_json` wrote.

        Raises:
            InputError: it is something else.
        """
        try:
            record = json.loads(text)
            if record.pop("giajax_posterior") != FORMAT:
                raise ValueError
            marginals = {
                name: Marginal.of_json(each) for name, each in record["parameters"].items()
            }
            words = {key: tuple(record[key]) for key in ("held", "warnings")}
            return cls(**{**record, **words, "parameters": marginals})
        except (ValueError, LookupError, TypeError, AttributeError):
            raise InputError(
                "this is no posterior.json of this version of giajax: run giajax posterior again"
            ) from None


@dataclasses.dataclass(frozen=True, repr=False)
class Posterior:
    """Draws from what is known of the free parameters of a fit; made by `giajax.posterior`.

    Attributes:
        summary: of each parameter, and of how the chains have mixed.
        samples: SI, shape (chain, draw, parameter), in the order of `summary.parameters`.
        energy: minus the logarithm of their density, up to a constant, shape (chain, draw).
        diverging, steps, acceptance: of each draw; the same shape.
        bands: of each run, by channel.
    """

    summary: PosteriorSummary
    samples: Float[np.ndarray, "chain draw parameter"]
    energy: Float[np.ndarray, "chain draw"]
    diverging: np.ndarray
    steps: np.ndarray
    acceptance: Float[np.ndarray, "chain draw"]
    bands: tuple[dict[str, Band], ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.summary.parameters)

    def draws_of(self, label: str) -> Float[np.ndarray, "chain draw"]:
        """The draws of one parameter, SI.

        Raises:
            InputError: there is none of this name.
        """
        if label not in self.labels:
            raise InputError(f"'{label}' was not free in this fit: use one of {self.labels}")
        return self.samples[..., self.labels.index(label)]

    def to_arviz(self) -> Any:
        """The draws as ArviZ takes them: `InferenceData` of ArviZ 0, `DataTree` of ArviZ 1.

        Raises:
            InputError: ArviZ is not installed.
        """
        posterior = {label: self.draws_of(label) for label in self.labels}
        statistics = {
            "lp": -self.energy,
            "diverging": self.diverging,
            "n_steps": self.steps,
            "acceptance_rate": self.acceptance,
        }
        return as_arviz(posterior, statistics)

    def __repr__(self) -> str:
        known = self.summary
        return f"<Posterior: {len(self.labels)} parameters, {known.chains} x {known.draws} draws>"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
