"""Example: a user-defined loss and Student-t; one cell in ten of the recording is an outlier."""

import jax
import jax.numpy as jnp
import numpy as np

import giajax
from giajax.fitting import AbstractLoss, StudentT

TRUTH = 1.4


@giajax.register
class CauchyLoss(AbstractLoss):
    """Cauchy loss; a residual beyond `width` noise standard deviations has little influence."""

    width: float = 2.0

    def rho(self, r):
        return self.width**2 * jnp.log1p((r / self.width) ** 2)


def recording():
    """Simulate a swinging arm; outliers displace one cell in ten in the positive direction."""
    arm = giajax.takeichi_20m(3, drag="strip")
    times = np.linspace(0.0, 6.0, 121)
    run = giajax.synthesise(
        giajax.ArmModel(giajax.replace(arm, {"air.drag_coefficient": TRUTH})),
        times,
        {f"joint{joint:02d}_command": np.sin(times * joint) for joint in (1, 2, 3)},
        [f"link{link:02d}_{axis}" for link in (1, 2, 3) for axis in "xyz"],
        noise={"position": 0.002},
        constants=giajax.ArmModel(arm),
    )
    rng = np.random.default_rng(1)
    spoiled = {
        name: values + (rng.random(len(times)) < 0.1) * rng.exponential(0.2, len(times))
        for name, values in run.observations.items()
    }
    return giajax.Run.from_arrays(run.times, {**run.commands, **spoiled}, definition=run.definition)


def main():
    jax.config.update("jax_enable_x64", True)
    made = recording()
    giajax.write_run("outliers.csv", made.times, made.values, definition=made.definition)
    run = giajax.read_run("outliers.csv")
    model, start = giajax.model_for([run]), {"air.drag_coefficient": 0.7}
    for loss in ("linear", StudentT(degrees_of_freedom=4.0), CauchyLoss()):
        result = giajax.fit(model, run, start=start, loss=loss, check=type(loss) is CauchyLoss)
        drag = result.parameters["air.drag_coefficient"]
        if loss == "linear":
            assert abs(drag.value / TRUTH - 1) > 0.3
        else:
            assert abs(drag.value - TRUTH) < 3 * drag.standard_error < 0.02 * TRUTH
    giajax.write_result(result, run, "robust", figures=False)


if __name__ == "__main__":
    main()
