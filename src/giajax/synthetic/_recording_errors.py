"""What goes wrong between a motion and its file: noise, gaps and outliers, added to a run."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._typing import Float
from ..runs import Definition, Run


@dataclasses.dataclass(frozen=True)
class RecordingErrors:
    """What goes wrong between a motion and its file.

    Standard deviations and sizes are SI, by quantity (`position`, `angle`, `rate`) or by channel.
    A turned, shifted or late camera is no error of this kind: it is a parameter of the model.

    Attributes:
        white: standard deviation of noise that each sample has by itself.
        correlated: standard deviation of noise that drifts (Ornstein-Uhlenbeck).
        correlation_time: in which the correlation of the drift falls to 1/e, s.
        missing: fraction of cells that are empty here and there, in [0, 1).
        bursts: fraction of the samples of each link or joint that is lost in whole stretches.
        burst_duration: of each stretch, s.
        outliers: fraction of cells that are far off, in [0, 1).
        outlier_size: how far, to either side.
    """

    white: Mapping[str, float] = dataclasses.field(default_factory=dict)
    correlated: Mapping[str, float] = dataclasses.field(default_factory=dict)
    correlation_time: float = 0.5
    missing: float = 0.0
    bursts: float = 0.0
    burst_duration: float = 1.0
    outliers: float = 0.0
    outlier_size: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("missing", "bursts", "outliers"):
            if not 0 <= getattr(self, name) < 1:
                raise InputError(
                    f"the fraction {name} is {getattr(self, name):g}: give at least 0 and "
                    "less than 1"
                )
        for name in ("correlation_time", "burst_duration"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} is {getattr(self, name):g} s: give a positive time")
        if (self.outliers > 0) != bool(self.outlier_size):
            raise InputError("outliers need a fraction and a size: give both or none")


def with_errors(run: Run, errors: RecordingErrors, *, seed: int = 0) -> Run:
    """A run with errors added to what it recorded, and the noise in its sidecar.

    Raises:
        InputError: correlated noise or bursts in a run without times.
    """
    white, drift, size = (
        _by_channel(run, of) for of in (errors.white, errors.correlated, errors.outlier_size)
    )
    if run.times is None and (errors.correlated or errors.bursts):
        raise InputError(
            f"'{run.name}' has no times, so that its errors are neither correlated nor in "
            "bursts: leave these out"
        )
    values: dict[str, Any] = dict(run.values)
    for name, exact in run.observations.items():
        recorded = exact + white[name] * _stream(seed, "white", name).standard_normal(len(exact))
        if drift[name]:
            assert run.times is not None
            random = _stream(seed, "correlated", name)
            recorded += drift[name] * drifting(run.times, errors.correlation_time, random)
        random = _stream(seed, "outliers", name)
        far = _some(len(exact), errors.outliers, random)
        recorded[far] += size[name] * random.choice([-1.0, 1.0], len(far))
        recorded[_some(len(exact), errors.missing, _stream(seed, "missing", name))] = np.nan
        if errors.bursts:
            assert run.times is not None
            channel = run.channels[name]
            random = _stream(seed, "bursts", f"{channel.kind}{channel.index}")
            recorded[_stretches(run.times, errors.bursts, errors.burst_duration, random)] = np.nan
        if np.all(np.isnan(recorded)):
            raise InputError(f"no value of {name} is left: lower the fractions that are lost")
        values[name] = recorded
    kept = {key: value for key, value in run.definition.contents().items() if key != "noise"}
    total = {
        key: float(np.hypot(errors.white.get(key, 0.0), errors.correlated.get(key, 0.0)))
        for key in {**errors.white, **errors.correlated}
    }
    # A channel with a key of its own in one of them has the other by its quantity.
    for name in set(total) & set(run.observations):
        total[name] = float(np.hypot(white[name], drift[name]))
    return Run.from_arrays(
        run.times,
        values,
        name=run.name,
        noise={key: value for key, value in total.items() if value > 0},
        definition=Definition.parse(kept, run.name),
    )


def drifting(
    times: Float[np.ndarray, " sample"], correlation_time: float, random: np.random.Generator
) -> Float[np.ndarray, " sample"]:
    """Stationary Ornstein-Uhlenbeck noise of unit variance: <x(s) x(t)> = exp(-|s - t| / tau).

    Exact for any spacing of the samples.
    """
    kept = np.exp(-np.diff(times) / correlation_time)
    kicks = random.standard_normal(len(times))
    values = np.empty(len(times))
    values[0] = kicks[0]
    for row, (keep, kick) in enumerate(zip(kept, kicks[1:], strict=True), start=1):
        values[row] = keep * values[row - 1] + np.sqrt(1 - keep**2) * kick
    return values


def _by_channel(run: Run, deviations: Mapping[str, float]) -> dict[str, float]:
    """Deviations by measured channel, from those by quantity or channel; 0 where there is none."""
    bare = {key: value for key, value in run.definition.contents().items() if key != "noise"}
    positive = {key: value for key, value in deviations.items() if value > 0}
    if any(not np.isfinite(value) or value < 0 for value in deviations.values()):
        raise InputError("a standard deviation or size is negative or infinite: correct it")
    plan = Run.from_arrays(run.times, run.values, noise=positive, definition=bare)
    return {name: plan.noise(name) or 0.0 for name in run.observations}


def _stream(seed: int, kind: str, name: str) -> np.random.Generator:
    return np.random.default_rng([seed, *kind.encode(), 0, *name.encode()])


def _some(count: int, fraction: float, random: np.random.Generator) -> npt.NDArray[Any]:
    """An exact number of rows, rounded down."""
    return random.permutation(count)[: int(fraction * count)]


def _stretches(
    times: Float[np.ndarray, " sample"],
    fraction: float,
    duration: float,
    random: np.random.Generator,
) -> npt.NDArray[np.bool_]:
    """Rows in stretches of a duration, as many as the fraction needs, the last one cut."""
    lost = np.zeros(len(times), bool)
    count = int(fraction * len(times))
    while (left := count - int(lost.sum())) > 0:
        begin = random.uniform(times[0] - duration / 2, times[-1])
        rows = np.flatnonzero((times >= begin) & (times < begin + duration) & ~lost)
        lost[rows[:left]] = True
        # A duration below the spacing may hit no row.
        if duration < np.min(np.diff(times)) and not len(rows):
            lost[random.integers(len(times))] = True
    return lost
