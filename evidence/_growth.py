"""A model of two numbers, whose posterior a bound cuts or a valley bends."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import jax.numpy as jnp

from giajax.models import AbstractDirectModel, Channels, Derived
from giajax.recordings import Run
from giajax.runtime.arrays import Array, Scalar
from giajax.schema.parameters import parameter


class Growth(AbstractDirectModel):
    """tip_z = amplitude (1 - exp(-rate t)): over a short time only the product counts."""

    kind: ClassVar[str] = "growth"

    amplitude: Scalar = parameter(2.0, unit="m", lower=0, doc="height at the end", frozen=False)
    rate: Scalar = parameter(1.0, unit="1/s", lower=0, doc="of growth", frozen=False)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        return cls()

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        return cls()

    def definition(self) -> dict[str, Any]:
        return {}

    def scene(self, run: Run) -> None:
        return None

    def refined(self, factor: float) -> Self:
        return self

    def at_start(self, runs: Sequence[Run], free: Sequence[str]) -> Self:
        return self

    def derived(self) -> dict[str, Derived]:
        return {}

    def failure(self, inputs: Array) -> str:
        return "the growth is not finite: start with a smaller rate"

    def prepare(self, run: Run) -> Array:
        assert run.times is not None
        return jnp.asarray(run.times)

    def predict(self, inputs: Array, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        height = -self.amplitude * jnp.expm1(-self.rate * inputs)
        return dict.fromkeys(channels, height), jnp.all(jnp.isfinite(height))

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        return []
