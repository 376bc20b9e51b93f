"""A pendulum with Coulomb friction, aerodynamic drag and damping, in fixed steps: quick to fit.

Its fit has the difficulties of real ones: curved valleys, a parameter with an optimum of zero, one
that has an effect only together with another, and an initial state for each window.
"""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from giajax.models import Channels
from giajax.recordings import Run, windows
from giajax.runtime.arrays import Array, Scalar
from giajax.schema.parameters import parameter
from toy_model import Plain

TRUTH = {"friction": 5e-4, "drag": 1.2, "length": 1.0, "centre": 0.6}
OFF = {"friction": 3.0, "drag": 3.0, "length": 1.5, "centre": 1.5}
NOISE_DEG = 0.05


class State(eqx.Module):
    angle: Scalar = parameter(0.0, unit="rad", doc="angle at the first sample")
    rate: Scalar = parameter(0.0, unit="rad/s", doc="rate at the first sample")


class Inputs(eqx.Module):
    times: Array
    initial: State


class Pendulum(Plain):
    """joint01_angle of a rod in air, which depends only on drag times length^4."""

    kind: ClassVar[str] = "arm"

    friction: Scalar = parameter(
        5e-4, unit="N m", lower=0, upper=1e3, doc="Coulomb friction", frozen=False
    )
    drag: Scalar = parameter(1.2, unit="", lower=0, upper=50, doc="C_D", frozen=False)
    length: Scalar = parameter(1.0, unit="m", lower=0, doc="length", frozen=False)
    centre: Scalar = parameter(0.6, unit="m", doc="centre of mass", frozen=False)
    damping: Scalar = parameter(
        0.0, unit="N m s/rad", lower=0, upper=1e2, doc="viscous damping", frozen=False
    )

    def failure(self, inputs: Inputs) -> str:
        return "the pendulum is too fast: choose other values"

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        return ("initial.angle", "initial.rate")

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        return []

    def prepare(self, run: Run) -> Inputs:
        times, angle = run.times, run.values["joint01_angle"]
        rate = np.polyfit(times[:8] - times[0], angle[:8], 1)[0]
        return Inputs(jnp.asarray(times), State(jnp.asarray(angle[0]), jnp.asarray(rate)))

    def predict(self, inputs: Inputs, channels: tuple[str, ...]) -> tuple[Channels, Array]:
        inertia = 0.025 + 0.3 * self.centre**2
        air = 0.5 * 1.204 * 0.05 * self.drag * self.length**4 / 4

        def slope(state: Array) -> Array:
            angle, rate = state
            torque = 0.3 * 9.80665 * self.centre * jnp.sin(angle) + self.damping * rate
            torque = torque + self.friction * jnp.tanh(rate / 0.01) + air * rate * jnp.abs(rate)
            return jnp.stack([rate, -torque / inertia])

        def step(state: Array, h: Array) -> tuple[Array, Array]:
            a = slope(state)
            b = slope(state + h / 2 * a)
            c = slope(state + h / 2 * b)
            state = state + h / 6 * (a + 2 * b + 2 * c + slope(state + h * c))
            return state, state[0]

        first = jnp.stack([inputs.initial.angle, inputs.initial.rate])
        _, angles = jax.lax.scan(step, first, jnp.diff(inputs.times))
        angles = jnp.concatenate([first[:1], angles])
        return dict.fromkeys(channels, angles), jnp.all(jnp.isfinite(angles))


def swing(*, seconds: float = 120.0, window: float = 3.0, seed: int = 3) -> list[Run]:
    """Simulate windows of a recording at 25 Hz without damping, with 1 ms of clock jitter."""
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, seconds, int(25 * seconds) + 1)
    seen = times + np.where(times > 0, rng.normal(scale=1e-3, size=len(times)), 0)
    state = State(jnp.asarray(np.deg2rad(20.0)), jnp.asarray(0.0))
    predicted, _ = Pendulum().predict(Inputs(jnp.asarray(seen), state), ("angle",))
    noise = np.deg2rad(NOISE_DEG) * rng.normal(size=len(times))
    run = Run.from_arrays(
        times,
        {"joint01_angle": np.asarray(predicted["angle"]) + noise},
        definition={
            "initial": {"free": True, "first_row": True},
            "noise": {"angle_deg": NOISE_DEG},
        },
    )
    return windows(run, window)


def start(corner: Sequence[int]) -> dict[str, float]:
    """Return an initial guess that is off by all of `OFF`; the damping is not scaled."""
    off = {p: TRUTH[p] * OFF[p] ** up for p, up in zip(TRUTH, corner, strict=True)}
    return {**off, "damping": 0.01}
