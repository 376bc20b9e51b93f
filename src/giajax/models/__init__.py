"""What predicts channels for a run."""

from ._arm import ArmModel as ArmModel
from ._arm_inputs import ArmInputs as ArmInputs
from ._arm_scene import arm_scene as arm_scene
from ._arm_sensors import recorded_channels as recorded_channels
from ._build import (
    build_model as build_model,
    model_for as model_for,
    parameter_values as parameter_values,
)
from ._definition import (
    arm_from_definition as arm_from_definition,
    arm_to_definition as arm_to_definition,
)
from ._direct import AbstractDirectModel as AbstractDirectModel
from ._hysteresis import (
    HysteresisInputs as HysteresisInputs,
    HysteresisModel as HysteresisModel,
)
from ._hysteresis_definition import hysteresis_keys as hysteresis_keys
from ._joint import (
    JointInputs as JointInputs,
    JointModel as JointModel,
    joint_from_section as joint_from_section,
)
from ._joint_scene import joint_scene as joint_scene
from ._muscle import MuscleModel as MuscleModel
from ._muscle_inputs import MuscleInputs as MuscleInputs
from ._oscillator import OscillatorInputs as OscillatorInputs, OscillatorModel as OscillatorModel
from ._pinhole import NEAR as NEAR, Pinhole as Pinhole, Projection as Projection, View as View
from ._pixels import camera_of as camera_of, clock_of as clock_of
from ._protocol import (
    AbstractModel as AbstractModel,
    Channels as Channels,
    Derived as Derived,
    Integration as Integration,
)
from ._recorded_markers import recorded_markers as recorded_markers
from ._response import (
    Columns as Columns,
    comparable as comparable,
    input_channel as input_channel,
    output_channel as output_channel,
)
from ._scene import Arrows as Arrows, Block as Block, Line as Line, Scene as Scene
from ._sensors import Sensors as Sensors
from ._sensors_definition import sensors_from_definition as sensors_from_definition
from ._several import SeveralModels as SeveralModels
