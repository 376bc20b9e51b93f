"""Example: a user-defined drag law that depends on the Reynolds number and on the fullness."""

import jax
import numpy as np

import giajax
from giajax.mechanics.arm import AbstractDragLaw
from giajax.runtime.arrays import safe_norm, scaled
from giajax.schema.parameters import parameter


@giajax.register
class FullnessDrag(AbstractDragLaw):
    """Cross-flow drag; C_D decreases with the Reynolds number and with the fullness of a link."""

    coefficient: jax.Array = parameter(
        1.0, unit="", lower=0, frozen=False, doc="C_D of a full link at Re = 1e5"
    )
    limp: jax.Array = parameter(
        0.5, unit="", lower=0, upper=10, doc="relative increase in C_D from a full to an empty link"
    )
    points = 3

    def force(self, stream):
        speed = safe_norm(stream.across)
        curve = (1 + stream.reynolds(speed) / 1e5) ** -0.2
        size = self.coefficient * (1 + self.limp * (1 - stream.fullness)) * curve
        return -scaled(0.5 * stream.density * stream.diameter * size * speed, stream.across)


def main():
    jax.config.update("jax_enable_x64", True)
    fill = {"links.fullness": [1.0, 0.5, 0.2]}
    arm = giajax.takeichi_20m(3, drag="FullnessDrag", parameters=fill)
    truth = giajax.ArmModel(giajax.replace(arm, {"air.law.coefficient": 1.3, "air.law.limp": 0.9}))
    times = np.linspace(0.0, 6.0, 121)
    inputs = {f"joint{joint:02d}_command": np.sin(times * joint) for joint in (1, 2, 3)}
    run = giajax.synthesise(
        truth,
        times,
        inputs,
        [f"link{link:02d}_{axis}" for link in (1, 2, 3) for axis in "xyz"],
        noise={"position": 0.002},
        constants=giajax.ArmModel(arm),
    )
    giajax.write_run("fullness.csv", run.times, run.values, definition=run.definition)
    run = giajax.read_run("fullness.csv")
    first = giajax.fit(giajax.model_for([run]), run, check=False)
    suspect = giajax.suspects(first, run, parameters_alone=True).promising[0]
    assert "air.law.limp" in (suspect.path, *suspect.alike)
    free = [*first.config["free"], "air.law.limp"]
    result = giajax.fit(giajax.model_for([run]), run, free=free)
    for path, value in (("air.law.coefficient", 1.3), ("air.law.limp", 0.9)):
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3 * estimate.standard_error
    giajax.write_result(result, run, "fullness", figures=False)


if __name__ == "__main__":
    main()
