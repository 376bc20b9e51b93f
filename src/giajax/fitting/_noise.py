"""The standard deviation of a channel's noise, where no sidecar states it."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np

from ..runs import Run

# 1.4826 median(|x|) estimates the standard deviation of a normal variable.
_MAD = 1.4826

# Estimating the noise and fitting with it alternate until the noise changes by less than this.
_NOISE_CHANGE = 0.05


def from_differences(values: np.ndarray) -> float:
    """Noise of a recorded channel from its second differences, before any model is known.

    A motion that is smooth over three samples leaves only noise in x[i-1] - 2 x[i] + x[i+1],
    whose standard deviation is sqrt(6) times that of white noise. The median keeps outliers
    out. A channel without visible noise gets a thousandth of its range.

    Arguments:
        values: recorded values, NaN where not measured, shape (sample,).

    Returns:
        Standard deviation, in the unit of the values; never 0.
    """
    measured = values[~np.isnan(values)]
    second = np.diff(values, 2)
    second = second[~np.isnan(second)]
    if len(second) < 8:
        second = np.diff(measured, 2)
    estimate = _MAD * float(np.median(np.abs(second))) / np.sqrt(6) if len(second) else 0.0
    span = float(np.ptp(np.quantile(measured, [0.05, 0.95])))  # an outlier is no range
    return max(estimate, 1e-3 * span) or 1.0


def from_residuals(residuals: np.ndarray, parameters: float, *, robust: bool) -> float:
    """Noise of a channel from the residuals of a fit.

    Arguments:
        residuals: recorded minus predicted where measured, shape (n,).
        parameters: degrees of freedom that the fit took from this channel.
        robust: use the median, for a loss that lets outliers stand.

    Returns:
        Standard deviation, in the unit of the residuals; never 0.
    """
    residuals = np.asarray(residuals, dtype=float)
    if robust:
        estimate = _MAD * float(np.median(np.abs(residuals)))
    else:
        count = max(len(residuals) - parameters, 1.0)
        estimate = float(np.sqrt(np.sum(residuals**2) / count))
    # Never zero: data without noise would weigh infinitely.
    return max(estimate, 1e-12 * float(np.max(np.abs(residuals), initial=0.0)), 1e-300)


@dataclasses.dataclass(frozen=True)
class Noise:
    """Standard deviation of each channel of each run, SI.

    Attributes:
        declared: what the sidecar of each run says, by channel; None where it says nothing.
        values: what the channels are weighted with.
        estimated: whether what the sidecars leave out comes from the residuals of a fit.
    """

    declared: tuple[Mapping[str, float | None], ...]
    values: tuple[Mapping[str, float], ...]
    estimated: bool = False

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Self:
        """What the sidecars say; else from the differences of neighbouring samples."""
        declared = tuple({name: run.noise(name) for name in run.observations} for run in runs)
        values = tuple(
            {
                name: sigma if sigma is not None else from_differences(run.observations[name])
                for name, sigma in noise.items()
            }
            for run, noise in zip(runs, declared, strict=True)
        )
        return cls(declared, values)

    @classmethod
    def of_plain(cls, runs: Sequence[Run], plain: Mapping[str, Any]) -> Self:
        """The noise of these runs that `to_plain` gave.

        Raises:
            ValueError, LookupError, TypeError: it is not that of these runs.
        """
        begun = cls.of(runs)
        values = tuple(
            {name: float(row[name]) for name in before}
            for before, row in zip(begun.values, plain["values"], strict=True)
        )
        return dataclasses.replace(begun, values=values, estimated=bool(plain["estimated"]))

    def to_plain(self) -> dict[str, Any]:
        """All that a fit has changed of it, as numbers by name."""
        values = [{name: float(value) for name, value in row.items()} for row in self.values]
        return {"values": values, "estimated": self.estimated}

    @property
    def complete(self) -> bool:
        """Whether the sidecars say all of it."""
        return all(sigma is not None for noise in self.declared for sigma in noise.values())

    def reestimated(
        self,
        runs: Sequence[Run],
        predictions: Sequence[Mapping[str, np.ndarray]],
        *,
        parameters: int,
        robust: bool,
    ) -> Self:
        """With what the sidecars leave out from the residuals of a fit.

        It stays the same where no channel changes by as much as a fit would notice.

        Arguments:
            runs: what was recorded.
            predictions: of the fit, SI, by channel of each run.
            parameters: number of fitted parameters.
            robust: use the median, for a loss that lets outliers stand.

        Returns:
            The noise to fit with next.
        """
        if self.complete:
            return self
        # Each channel is taken to have paid for its share of the parameters.
        share = parameters / sum(map(len, self.declared))
        values = []
        change = 0.0
        for run, noise, before, predicted in zip(
            runs, self.declared, self.values, predictions, strict=True
        ):
            after = dict(before)
            for name in (name for name, sigma in noise.items() if sigma is None):
                difference = predicted[name] - run.observations[name]
                difference = difference[~np.isnan(difference)]
                after[name] = from_residuals(difference, share, robust=robust)
                change = max(change, abs(float(np.log(after[name] / before[name]))))
            values.append(after)
        kept = change < _NOISE_CHANGE
        return dataclasses.replace(
            self, values=self.values if kept else tuple(values), estimated=True
        )
