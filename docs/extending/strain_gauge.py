"""Example: a user-defined sensor (strain gauges at joints), fitted together with a stiffness."""

import jax
import numpy as np

import giajax
from giajax.models import AbstractSensor
from giajax.schema import ChannelKind
from giajax.schema.parameters import parameter


@giajax.register
class StrainGauge(AbstractSensor):
    """Strain of the fabric at each joint, proportional to the joint torque."""

    channel = ChannelKind("strain", "gaugeNN", "ratio", "output")

    gain: jax.Array = parameter(
        1e-3, unit="1/(N m)", lower=0, frozen=False, doc="strain per unit of torque"
    )
    zero: jax.Array = parameter(0.0, unit="", optional=True, doc="strain at zero torque")

    def values(self, motion):
        strain = self.gain * motion.torques
        return strain if self.zero is None else strain + self.zero


def main():
    jax.config.update("jax_enable_x64", True)
    arm = giajax.takeichi_20m(1, parameters={"gravity": 9.80665})
    zero = "sensor.StrainGauge.zero"
    true = {"joints.pitch_stiffness": 5.0, "sensor.StrainGauge.gain": 2e-3, zero: 3e-3}
    sensors = giajax.models.Sensors(sensor={"StrainGauge": StrainGauge()})
    start = giajax.ArmModel(arm, sensors=sensors)
    times = np.linspace(0.0, 4.0, 81)
    run = giajax.synthesise(
        giajax.replace(start, true),
        times,
        {"joint01_command": np.sin(2 * times)},
        ["link01_x", "link01_z", "gauge01"],
        noise={"position": 0.002, "gauge01": 1e-3},
        constants=start,
    )
    giajax.write_run("strain.csv", run.times, run.values, definition=run.definition)
    run = giajax.read_run("strain.csv")
    first = giajax.fit(giajax.model_for([run]), run, check=False)
    assert giajax.suspects(first, run, parameters_alone=True).promising[0].path == zero
    result = giajax.fit(giajax.model_for([run]), run, free=[*first.config["free"], zero])
    for path, value in true.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3 * estimate.standard_error
    giajax.write_result(result, run, "strain", figures=False)


if __name__ == "__main__":
    main()
