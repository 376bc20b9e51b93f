"""Example: a user-defined law of a joint that hardens beyond an angle, fitted and detected."""

import jax
import jax.numpy as jnp
import numpy as np

import giajax
from giajax.mechanics.arm import AbstractJointLaw
from giajax.schema.parameters import parameter
from giajax.testing import check_joint_law


@giajax.register
class HardeningJoint(AbstractJointLaw):
    """Fabric that is slack up to an angle; beyond it, its torque is quadratic in the excess."""

    strength: jax.Array = parameter(
        1.0, unit="N m/rad^2", lower=0, frozen=False, doc="torque coefficient of the taut fabric"
    )
    loss: jax.Array = parameter(0.2, unit="s", lower=0, upper=10, doc="damping per unit of torque")
    slack: jax.Array = parameter(0.1, unit="rad", lower=0, upper=1, doc="slack angle of the fabric")

    def beyond(self, at):
        return jnp.maximum(jnp.abs(at.angles) - self.slack, 0)

    def torque(self, at):
        pull = self.strength * self.beyond(at) ** 2
        return -pull * (jnp.sign(at.angles) + self.loss * at.rates)

    def energy(self, at):
        return self.strength * self.beyond(at) ** 3 / 3


def main():
    jax.config.update("jax_enable_x64", True)
    check_joint_law(HardeningJoint())
    arm = giajax.takeichi_20m(2, joint_laws=["HardeningJoint"])
    true = {"joints.laws.HardeningJoint.strength": 6.0, "joints.laws.HardeningJoint.loss": 0.8}
    truth = giajax.ArmModel(giajax.replace(arm, true))
    times = np.linspace(0.0, 6.0, 121)
    inputs = {f"joint{joint:02d}_command": np.sin(times * joint) for joint in (1, 2)}
    outputs = [f"link{link:02d}_{axis}" for link in (1, 2) for axis in "xyz"]
    run = giajax.synthesise(
        truth, times, inputs, outputs, noise={"position": 0.002}, constants=giajax.ArmModel(arm)
    )
    giajax.write_run("hardening.csv", run.times, run.values, definition=run.definition)
    run = giajax.read_run("hardening.csv")
    first = giajax.fit(giajax.model_for([run]), run, check=False)
    suspect = giajax.suspects(first, run, parameters_alone=True).promising[0]
    assert "joints.laws.HardeningJoint.loss" in (suspect.path, *suspect.alike)
    free = [*first.config["free"], "joints.laws.HardeningJoint.loss"]
    result = giajax.fit(giajax.model_for([run]), run, free=free)
    for path, value in true.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3 * estimate.standard_error
    giajax.write_result(result, run, "hardening", figures=False)


if __name__ == "__main__":
    main()
