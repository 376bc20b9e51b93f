"""A model that is not an arm; a fit requires only the protocol."""

from collections.abc import Sequence
from typing import Any, ClassVar, Self

import jax.numpy as jnp
import numpy as np

from giajax.models import AbstractModel, Channels
from giajax.recordings import Run
from giajax.runtime.arrays import Array, Scalar
from giajax.schema.parameters import parameter

TRUTH = {"amplitude": 2.0, "decay": 0.7, "offset": 0.3}


class Plain(AbstractModel):
    """A closed-form model that is built from its parameters alone."""

    def definition(self) -> dict[str, Any]:
        return {}

    def refined(self, factor: float) -> Self:
        return self


class Decay(Plain):
    """tip_z = amplitude exp(-decay t) + offset; `idle` and `twin` are difficult for a fit."""

    kind: ClassVar[str] = "decay"

    amplitude: Scalar = parameter(1.0, unit="m", lower=0, doc="height at the start", frozen=False)
    decay: Scalar = parameter(1.0, unit="1/s", lower=0, upper=9, doc="rate", frozen=False)
    offset: Scalar = parameter(0.1, unit="m", doc="height at the end", frozen=False)
    idle: Scalar = parameter(4.0, unit="m", lower=0, doc="no channel responds to it")
    twin: Scalar = parameter(1.0, unit="", lower=0, doc="only amplitude times twin counts")

    def failure(self, inputs: Array) -> str:
        return "the decay is too fast: choose a smaller one"

    def prepare(self, run: Run) -> Any:
        return jnp.asarray(run.times)

    def predict(self, inputs: Array, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        height = self.twin * self.amplitude * jnp.exp(-self.decay * inputs) + self.offset
        # Beyond this, the "simulation" fails, like that of a stiff chain at its step limit.
        failed = self.decay > 8
        height = jnp.where(failed, jnp.nan, height)
        return dict.fromkeys(channels, height), ~failed

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        return [f"about {path}" for path in free]


def height(times: np.ndarray, **changed: float) -> np.ndarray:
    """Return the closed form, by NumPy."""
    values = {**TRUTH, **changed}
    return values["amplitude"] * np.exp(-values["decay"] * times) + values["offset"]


def run(*, sigma: float = 0.01, seed: int = 0, samples: int = 60, state_noise: bool = True) -> Run:
    """Simulate a noisy recording of the true model."""
    times = np.linspace(0.0, 4.0, samples)
    noise = np.random.default_rng(seed).normal(scale=sigma, size=samples)
    return Run.from_arrays(
        times,
        {"tip_z": height(times) + noise},
        name=f"run{seed}",
        noise={"position": sigma} if state_noise else None,
        definition={"free_motion": True},
    )
