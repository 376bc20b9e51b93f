"""Example: a tethered balloon in a steady wind, a different robot with a user-defined drag law."""

import jax
import numpy as np

import giajax
from giajax.mechanics.arm import AbstractDragLaw, net_lift
from giajax.runtime.arrays import safe_norm, scaled
from giajax.schema.parameters import parameter


@giajax.register
class SphereDrag(AbstractDragLaw):
    """Drag of a sphere, for a link as long as it is wide, based on the sphere's frontal area."""

    coefficient: jax.Array = parameter(0.6, unit="", lower=0, frozen=False, doc="C_D of a sphere")
    points = 0

    def force(self, stream):
        size = 0.5 * stream.density * self.coefficient * np.pi / 4 * stream.diameter
        return -scaled(size * safe_norm(stream.velocity), stream.velocity)


def main():
    jax.config.update("jax_enable_x64", True)
    wind, ball, tether = 5.0, 2.0, 10.0
    none = dict.fromkeys(("joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping"), 0.0)
    # A thin tether stands upright on the ground. The ball fills two thirds of its cylinder.
    arm = giajax.chain(
        2,
        length=[tether, ball],
        diameter=[0.004, ball],
        mass=[0.05, 1.0],
        joint_axes=["pitch", "pitch"],
        base_rotation=(0.0, -np.pi / 2, 0.0),
        gravity=9.80665,
        buoyancy=True,
        drag="SphereDrag",
        parameters=none | {"links.fullness": [1.0, 2 / 3], "air.wind": [wind, 0.0, 0.0]},
    )
    truth = giajax.ArmModel(giajax.replace(arm, {"air.law.coefficient": 0.47}))
    times = np.linspace(0.0, 20.0, 101)
    still = {"joint01_command": 0 * times, "joint02_command": 0 * times}
    names = ["link02_x", "link02_y", "link02_z"]
    run = giajax.synthesise(truth, times, still, names, noise={"position": 0.02})
    giajax.write_run("leaning.csv", run.times, run.values, definition=run.definition)
    run = giajax.read_run("leaning.csv")
    # The tether points along the sum of drag and net lift. Its own drag and weight are small.
    drag = 0.5 * 1.204 * 0.47 * np.pi / 4 * ball**2 * wind**2
    expected = np.arctan2(drag, 9.80665 * float(net_lift(arm)[1]))
    x, _, z = (np.mean(run.values[name][-20:]) for name in names)
    assert abs(np.arctan2(x, z) / expected - 1) < 0.05
    result = giajax.fit(giajax.model_for([run]), run)
    estimate = result.parameters["air.law.coefficient"]
    assert abs(estimate.value - 0.47) < 3 * estimate.standard_error
    giajax.write_result(result, run, "balloon", figures=False)


if __name__ == "__main__":
    main()
