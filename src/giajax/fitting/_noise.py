"""The noise that a fit weights its residuals with, run by run and channel by channel."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Self

import numpy as np

from ..noise import ChannelNoise, Stated, from_differences
from ..runs import Run

NoiseModel = Literal["correlated", "white"]

# Names of the models, for a message.
NOISE_MODELS: tuple[NoiseModel, ...] = ("correlated", "white")


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of each channel of each run, SI.

    Attributes:
        stated: what the sidecar of each run says, by channel.
        values: what the channels are weighted with.
        keys: of each channel of each run: those of the same key have the same noise.
        memory: whether noise may be correlated.
        weights: what robust statistics leave of each sample, by channel; None where outliers
            are not weighted that way.
        estimated: whether what the sidecars leave out comes from the residuals of a fit.
    """

    stated: tuple[Mapping[str, Stated], ...]
    values: tuple[Mapping[str, ChannelNoise], ...]
    keys: tuple[Mapping[str, str], ...]
    memory: bool
    weights: tuple[Mapping[str, np.ndarray], ...] | None = None
    estimated: bool = False

    @classmethod
    def of(cls, runs: Sequence[Run], model: NoiseModel = "correlated", *, per_run: bool) -> Self:
        """What the sidecars say; else white, from the differences of neighbouring samples.

        Arguments:
            runs: what is fitted to.
            model: whether noise may be correlated.
            per_run: whether a channel has another noise in every run, instead of one in all.
        """
        stated = tuple({name: _stated(run, name) for name in run.observations} for run in runs)
        several = len({run.model for run in runs}) > 1
        keys = tuple(
            {
                # A load cell of a joint's bench is not that of a stand for muscles.
                name: _key(f"{run.model} {name}" if several else name, number, known, per_run)
                for name, known in of_run.items()
            }
            for number, (run, of_run) in enumerate(zip(runs, stated, strict=True))
        )
        guesses: dict[str, list[float]] = {}
        for run, names in zip(runs, keys, strict=True):
            for name, key in names.items():
                guesses.setdefault(key, []).append(from_differences(run.observations[name]))
        values = tuple(
            {
                name: known.noise_of(memory=model == "correlated")
                or ChannelNoise(float(np.median(guesses[names[name]])))
                for name, known in of_run.items()
            }
            for of_run, names in zip(stated, keys, strict=True)
        )
        return cls(stated, values, keys, memory=model == "correlated")

    @property
    def complete(self) -> bool:
        """Whether the sidecars say the size of all of it."""
        return all(s.deviation is not None for of_run in self.stated for s in of_run.values())

    @property
    def is_white(self) -> bool:
        """Whether no channel has a memory."""
        return all(noise.is_white for of_run in self.values for noise in of_run.values())

    def by_key(self) -> dict[str, ChannelNoise]:
        """The noise of each key."""
        pairs = zip(self.keys, self.values, strict=True)
        return {keys[name]: noise for keys, of_run in pairs for name, noise in of_run.items()}

    def stated_by_key(self) -> dict[str, Stated]:
        """What is known beforehand of each key."""
        pairs = zip(self.keys, self.stated, strict=True)
        return {keys[name]: known for keys, of_run in pairs for name, known in of_run.items()}

    def with_values(
        self,
        by_key: Mapping[str, ChannelNoise],
        weights: tuple[Mapping[str, np.ndarray], ...] | None = None,
    ) -> Self:
        """With the noise that a fit showed."""
        values = tuple({name: by_key[key] for name, key in names.items()} for names in self.keys)
        return dataclasses.replace(self, values=values, weights=weights, estimated=True)

    def to_plain(self) -> dict[str, Any]:
        """What a fit changes of it, as numbers, for `with_plain`."""
        return {
            "estimated": self.estimated,
            "values": [
                {name: dataclasses.asdict(noise) for name, noise in of_run.items()}
                for of_run in self.values
            ],
            "weights": None
            if self.weights is None
            else [{name: w.tolist() for name, w in of_run.items()} for of_run in self.weights],
        }

    def with_plain(self, plain: Mapping[str, Any]) -> Self:
        """The noise that `to_plain` gave the numbers of."""
        values = tuple(
            {name: ChannelNoise(**noise) for name, noise in of_run.items()}
            for of_run in plain["values"]
        )
        weights = plain["weights"]
        if weights is not None:
            weights = tuple(
                {name: np.asarray(w) for name, w in of_run.items()} for of_run in weights
            )
        return dataclasses.replace(
            self, values=values, weights=weights, estimated=plain["estimated"]
        )


def _stated(run: Run, name: str) -> Stated:
    deviation = run.noise(name)
    part = run.correlated_noise(name)
    if part is None:
        return Stated(deviation)
    return Stated(deviation, correlated=part[0], time_s=part[1])


def _key(name: str, number: int, stated: Stated, per_run: bool) -> str:
    """Runs that state different noise, or none, do not share what is not stated either."""
    said = (
        ""
        if stated.deviation is None
        else f" {stated.deviation!r} {stated.correlated!r} {stated.time_s!r}"
    )
    return f"{name}{said}" + (f" of run {number}" if per_run else "")
