"""Example: a user-defined model of a falling coffee filter with quadratic drag."""

import jax
import jax.numpy as jnp
import numpy as np

import giajax
from giajax.schema import ChannelKind
from giajax.schema.parameters import parameter

GRAVITY = 9.80665


@giajax.register
class CoffeeFilter(giajax.AbstractModel):
    """Fall from rest; the speed approaches the terminal speed, at which drag balances weight."""

    kind = "coffee_filter"
    channels = (ChannelKind("height", "height", "length", "output"),)

    release: jax.Array = parameter(2.0, unit="m", frozen=False, doc="release height")
    speed: jax.Array = parameter(1.0, unit="m/s", lower=0, frozen=False, doc="terminal speed")

    def prepare(self, run):
        return jnp.asarray(run.times)

    def predict(self, times, channels):
        x = GRAVITY * times / self.speed
        # log cosh x, without the overflow of cosh.
        fallen = self.speed**2 / GRAVITY * (jnp.logaddexp(x, -x) - jnp.log(2.0))
        return dict.fromkeys(channels, self.release - fallen), jnp.all(jnp.isfinite(fallen))

    def definition(self):
        return {}


def main():
    jax.config.update("jax_enable_x64", True)
    times = np.linspace(0.0, 1.5, 61)
    noise = np.random.default_rng(3).normal(scale=0.004, size=61)
    fallen = 1.4**2 / GRAVITY * np.log(np.cosh(GRAVITY * times / 1.4))
    run = giajax.Run.from_arrays(
        times,
        {"height": 2.1 - fallen + noise},
        noise={"height": 0.004},
        definition={"model": "coffee_filter"},
    )
    giajax.write_run(
        "filter.csv", times, run.values, definition=run.definition, units={"height": "cm"}
    )
    run = giajax.read_run("filter.csv")
    result = giajax.fit(giajax.model_for([run]), run)
    assert result.verdict.status == "adequate"
    speed = result.parameters["speed"]
    assert abs(speed.value - 1.4) < 3 * speed.standard_error


if __name__ == "__main__":
    main()
