"""Models that predict the channels of a run."""

from typing import TYPE_CHECKING

from ..runtime.aliases import earlier as _earlier
from . import capabilities as capabilities
from ._arm import ArmInputs as ArmInputs, ArmModel as ArmModel, wind_of as wind_of
from ._arm_conditions import SCALE as SCALE, arm_variants as arm_variants
from ._arm_definition import (
    arm_from_definition as arm_from_definition,
    arm_to_definition as arm_to_definition,
    preset_of as preset_of,
    sensors_from_definition as sensors_from_definition,
)
from ._arm_sensors import (
    AbstractSensor as AbstractSensor,
    Camera as Camera,
    Landmark as Landmark,
    Marker as Marker,
    Picture as Picture,
    Sensors as Sensors,
    camera_of as camera_of,
    check_sensor as check_sensor,
    clock_of as clock_of,
    recorded_channels as recorded_channels,
)
from ._cameras import NEAR as NEAR, Pinhole as Pinhole, Projection as Projection, View as View
from ._hysteresis import (
    Columns as Columns,
    HysteresisInputs as HysteresisInputs,
    HysteresisModel as HysteresisModel,
    comparable as comparable,
    hysteresis_keys as hysteresis_keys,
    input_channel as input_channel,
    output_channel as output_channel,
)
from ._inertial import (
    Accelerometer as Accelerometer,
    CurvatureSensor as CurvatureSensor,
    Gyroscope as Gyroscope,
    Inclinometer as Inclinometer,
    TensionSensor as TensionSensor,
)
from ._joint import (
    JointInputs as JointInputs,
    JointModel as JointModel,
    joint_from_section as joint_from_section,
)
from ._muscle import MuscleInputs as MuscleInputs, MuscleModel as MuscleModel
from ._oscillator import OscillatorInputs as OscillatorInputs, OscillatorModel as OscillatorModel
from ._protocol import (
    AbstractModel as AbstractModel,
    Arrows as Arrows,
    Block as Block,
    Channels as Channels,
    Line as Line,
    Scene as Scene,
    build_model as build_model,
    model_class as model_class,
    model_for as model_for,
    parameter_values as parameter_values,
    predicted_channels as predicted_channels,
)
from ._scenes import (
    arm_scene as arm_scene,
    joint_scene as joint_scene,
    recorded_markers as recorded_markers,
)
from ._several import SeveralModels as SeveralModels, as_stated as as_stated
from .capabilities import Derived as Derived, Integration as Integration

# Type checkers must report names that do not exist.
if not TYPE_CHECKING:
    __getattr__ = _earlier(__name__)
