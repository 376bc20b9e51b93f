"""A model with every kind of suspect; it compiles quickly."""

import dataclasses
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from giajax.models import AbstractModel, Channels
from giajax.recordings import Run
from giajax.runtime.arrays import Array, Float, Scalar
from giajax.schema.parameters import inline, parameter, replace
from toy_model import Decay

NOISE = 0.01
WAVE = 0.05
TRUTH = {"amplitude": 2.0, "decay": 0.7}


class Curve(Decay):
    """tip_x, tip_y, tip_z of a decay, with parts that are disabled, at a bound, or a choice."""

    late: Scalar | None = parameter(0.5, unit="s", optional=True, doc="delay")
    rub: Scalar = parameter(0.0, unit="m", lower=0, doc="a part that is held at its bound")
    shift: Float[Array, "3"] = parameter(0.0, unit="m", shape=(3,), doc="of all positions")
    weights: Float[Array, " each"] = parameter(1.0, unit="", lower=0, per="link", doc="of parts")
    wavy: bool = eqx.field(static=True, default=False)

    def predict(self, inputs: Array, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        times = inputs if self.late is None else inputs - self.late
        z = self.twin * self.amplitude * jnp.exp(-self.decay * times) + self.offset
        parts = jnp.stack([jnp.cos(times), jnp.sin(2 * times)])
        x = jnp.sum(self.weights[:, None] * parts, axis=0) + self.rub * jnp.tanh(times - 2)
        y = jnp.sin(times) * self.amplitude + (WAVE * jnp.sin(9 * times) if self.wavy else 0)
        axes = {"tip_x": x, "tip_y": y, "tip_z": z}
        shifted = {name: axes[name] + self.shift["xyz".index(name[-1])] for name in axes}
        return {name: shifted[name] for name in channels}, jnp.all(jnp.isfinite(z))

    def variants(self) -> dict[str, Self]:
        return {} if self.wavy else {"wavy = true": dataclasses.replace(self, wavy=True)}


class Begun(eqx.Module):
    """Times of a run, and its own height."""

    times: Array
    height: Scalar = parameter(0.0, unit="m", doc="of one run")


class OwnHeights(AbstractModel):
    """tip_z and tip_y of the curve, with a height of z that is free in each run."""

    kind: ClassVar[str] = "own"
    curve: Curve = inline()

    from_definition = classmethod(lambda cls, _: cls(curve()))
    refined = lambda self, _: self  # noqa: E731
    definition = lambda self: {}  # noqa: E731
    free_inputs = lambda self, run: ("height",)  # noqa: E731

    def prepare(self, run: Run) -> Begun:
        return Begun(jnp.asarray(run.times))

    def predict(self, inputs: Begun, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        predicted, fine = self.curve.predict(inputs.times, channels)
        return {
            name: row + inputs.height if name == "tip_z" else row for name, row in predicted.items()
        }, fine


def curve(**values: Any) -> Curve:
    return replace(Curve(weights=jnp.ones(2)), {**TRUTH, **values})


AXES = ("tip_x", "tip_y", "tip_z")


def recorded(*, channels=AXES, seed=0, noise=True, wave=0.0, **values: Any) -> Run:
    """Simulate a noisy recording of the model with these values."""
    times = np.linspace(0.0, 4.0, 120)
    predicted, _ = curve(**values).predict(jnp.asarray(times), tuple(channels))
    predicted["tip_y" if "tip_y" in predicted else channels[0]] += wave * np.sin(9 * times)
    random = np.random.default_rng(seed)
    return Run.from_arrays(
        times,
        {
            name: np.asarray(row) + NOISE * random.normal(size=len(times))
            for name, row in predicted.items()
        },
        name=f"curve{seed}",
        noise={"position": NOISE} if noise else None,
        definition={"free_motion": True},
    )
