"""A model with two parameters, whose posterior is truncated by a bound or a curved valley."""

from typing import Any, ClassVar, Self

import jax.numpy as jnp

from giajax.models import AbstractModel, Channels
from giajax.recordings import Run
from giajax.runtime.arrays import Array, Scalar
from giajax.schema.parameters import parameter


class Growth(AbstractModel):
    """tip_z = amplitude (1 - exp(-rate t)); a short recording determines only the product."""

    kind: ClassVar[str] = "growth"

    amplitude: Scalar = parameter(2.0, unit="m", lower=0, doc="height at the end", frozen=False)
    rate: Scalar = parameter(1.0, unit="1/s", lower=0, doc="of growth", frozen=False)

    def definition(self) -> dict[str, Any]:
        return {}

    def refined(self, factor: float) -> Self:
        return self

    def failure(self, inputs: Array) -> str:
        return "the growth became infinite or NaN: start with a smaller rate"

    def prepare(self, run: Run) -> Array:
        assert run.times is not None
        return jnp.asarray(run.times)

    def predict(self, inputs: Array, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        height = -self.amplitude * jnp.expm1(-self.rate * inputs)
        return dict.fromkeys(channels, height), jnp.all(jnp.isfinite(height))
