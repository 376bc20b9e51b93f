"""Example: a user-defined gusty wind that increases with height, acting on a hanging rope."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import giajax
from giajax.mechanics.arm import AbstractWind
from giajax.schema.parameters import parameter


@giajax.register
class PowerLaw(AbstractWind):
    """Wind along x: a power of the height above the ground, times a periodic gust."""

    speed: jax.Array = parameter(6.0, unit="m/s", lower=0, doc="mean speed at a height of 10 m")
    exponent: jax.Array = parameter(
        0.14, unit="", lower=0, upper=1, frozen=False, doc="exponent of the height (open land: 1/7)"
    )
    base: jax.Array = parameter(6.0, unit="m", lower=0, doc="height of the arm's base")

    def __call__(self, position, time):
        share = jnp.maximum(self.base + position[..., 2], 0.01) / 10
        along = self.speed * (1 + 0.3 * jnp.sin(0.8 * time)) * share**self.exponent
        return along[..., None] * jnp.array([1.0, 0.0, 0.0])


def main():
    jax.config.update("jax_enable_x64", True)
    shape = {"length": 5.0, "diameter": 0.3, "mass": 20.0, "drag": "strip", "strip_points": 8}
    arm = giajax.pendulum(**shape, wind_field="PowerLaw", parameters={"air.drag_coefficient": 1.2})
    truth = giajax.ArmModel(giajax.replace(arm, {"air.wind_field.exponent": 0.3}))
    times = np.linspace(0.0, 20.0, 101)
    command = {"joint01_command": 0 * times}
    run = giajax.synthesise(truth, times, command, ["joint01_angle"], noise={"angle": 1e-4})
    giajax.write_run("hanging.csv", run.times, run.values, definition=run.definition)
    # Independent model: drag across the rope, integrated over the relative air speed along it.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s, weights = 2.5 * (nodes + 1), 2.5 * weights
    inertia = 20 * (5**2 / 3 + 0.15**2 / 2)

    def rates(time, state):
        wind = 6 * (1 + 0.3 * np.sin(0.8 * time)) * (0.6 - s / 10 * np.cos(state[0])) ** 0.3
        past = s * state[1] - wind * np.cos(state[0])
        drag = -0.5 * 1.204 * 1.2 * 0.3 * np.abs(past) * past
        return state[1], (np.sum(weights * s * drag) - 500 * 0.980665 * np.sin(state[0])) / inertia

    expected = solve_ivp(rates, (0, 20), (0, 0), t_eval=times, rtol=1e-9, atol=1e-9).y[0]
    run = giajax.read_run("hanging.csv")
    assert np.max(np.abs(run.values["joint01_angle"] - expected)) < 5e-4 < np.ptp(expected) / 100
    result = giajax.fit(giajax.model_for([run]), run, free=["air.wind_field.exponent"])
    estimate = result.parameters["air.wind_field.exponent"]
    assert abs(estimate.value - 0.3) < 3 * estimate.standard_error < 0.003
    giajax.write_result(result, run, "profile", figures=False)


if __name__ == "__main__":
    main()
