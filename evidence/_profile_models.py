"""Two models in closed form for the study of profiles."""

from typing import Any, ClassVar, Self

import jax.numpy as jnp

from giajax.models import AbstractModel, Channels
from giajax.recordings import Run
from giajax.runtime.arrays import Array, Scalar
from giajax.schema.parameters import parameter


class _Curve(AbstractModel):
    """tip_z as a function of time, with only the required methods of a model."""

    def definition(self) -> dict[str, Any]:
        return {}

    def refined(self, factor: float) -> Self:
        return self

    def failure(self, inputs: Array) -> str:
        return "the prediction became infinite or NaN: choose other values"

    def prepare(self, run: Run) -> Array:
        return jnp.asarray(run.times)

    def predict(self, inputs: Array, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        values = {name: getattr(self, name) for name in self.names}
        height = self.height(inputs, **values)
        return dict.fromkeys(channels, height), jnp.all(jnp.isfinite(height))

    names: ClassVar[tuple[str, ...]]

    @staticmethod
    def height(times: Any, **values: Any) -> Any:
        raise NotImplementedError


class Bend(_Curve):
    """A parabola with non-negative curvature; linear in its parameters."""

    kind: ClassVar[str] = "bend"
    names: ClassVar[tuple[str, ...]] = ("offset", "slope", "bend")

    offset: Scalar = parameter(0.1, unit="m", doc="height", frozen=False)
    slope: Scalar = parameter(0.1, unit="m/s", doc="rate", frozen=False)
    bend: Scalar = parameter(0.1, unit="m/s^2", lower=0, doc="bend", frozen=False)

    @staticmethod
    def height(times: Any, **values: Any) -> Any:
        return values["offset"] + values["slope"] * times + values["bend"] * times**2


class Decay(_Curve):
    """An exponential decay and its limit, which are correlated in a short record."""

    kind: ClassVar[str] = "decay"
    names: ClassVar[tuple[str, ...]] = ("amplitude", "rate", "offset")

    amplitude: Scalar = parameter(1.0, unit="m", lower=0, doc="height at the start", frozen=False)
    rate: Scalar = parameter(1.0, unit="1/s", lower=0, upper=9, doc="rate", frozen=False)
    offset: Scalar = parameter(0.1, unit="m", doc="height at the end", frozen=False)

    @staticmethod
    def height(times: Any, **values: Any) -> Any:
        return values["amplitude"] * jnp.exp(-values["rate"] * times) + values["offset"]
