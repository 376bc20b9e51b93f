"""A model that is linear in its parameters, so all results have closed forms."""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from giajax.models import Channels
from giajax.recordings import Run
from giajax.runtime.arrays import Array, Scalar
from giajax.schema.parameters import parameter
from toy_model import Plain

SIGMA = 0.02
FREE = ["height", "slope", "bend"]
TRUTH = {"height": 0.4, "slope": -0.3, "bend": 0.1}


class Line(Plain):
    """tip_z = height + slope t + bend t^2, and tip_y = slope sin t + bend."""

    kind: ClassVar[str] = "line"

    height: Scalar = parameter(0.0, unit="m", doc="at the start", frozen=False)
    slope: Scalar = parameter(0.1, unit="m/s", doc="at the start", frozen=False)
    bend: Scalar = parameter(0.0, unit="m/s^2", doc="half of the acceleration", frozen=False)

    def failure(self, inputs: Array) -> str:
        return "it never fails"

    def prepare(self, run: Run) -> Any:
        return jnp.asarray(run.times)

    def predict(self, inputs: Array, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        z = self.height + self.slope * inputs + self.bend * inputs**2
        y = self.slope * jnp.sin(inputs) + self.bend
        axes = {"tip_z": z, "tip_y": y}
        return {name: axes[name] for name in channels}, jnp.all(jnp.isfinite(z))

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        return []


def columns(times: np.ndarray) -> dict[str, np.ndarray]:
    """Return the derivatives of each channel by the parameters, shape (sample, parameter)."""
    one, zero = np.ones_like(times), np.zeros_like(times)
    z = np.stack([one, times, times**2], axis=-1)
    y = np.stack([zero, np.sin(times), one], axis=-1)
    return {"tip_z": z, "tip_y": y}


def recorded(seed: int, *, gap: slice = slice(0), noise: dict[str, Any] | None = None) -> Run:
    """Simulate a recording with stated noise, and a gap in tip_y."""
    times = np.linspace(0.0, 3.0, 40)
    random = np.random.default_rng(seed)
    values = {
        name: column @ np.array(list(TRUTH.values())) + SIGMA * random.normal(size=40)
        for name, column in columns(times).items()
    }
    values["tip_y"][gap] = np.nan
    section = noise or {"position_m": SIGMA}
    definition = {"free_motion": True, "noise": section}
    return Run.from_arrays(times, values, name=f"line{seed}", definition=definition)
