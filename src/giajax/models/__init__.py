"""What predicts channels for a run."""

from ._arm import ArmInputs as ArmInputs, ArmModel as ArmModel
from ._build import (
    build_model as build_model,
    model_for as model_for,
    parameter_values as parameter_values,
)
from ._compensate import (
    Compensator as Compensator,
    compensator_for_loop as compensator_for_loop,
    compensator_for_model as compensator_for_model,
    wanted_channel as wanted_channel,
)
from ._definition import (
    arm_from_definition as arm_from_definition,
    arm_to_definition as arm_to_definition,
    sensors_from_definition as sensors_from_definition,
)
from ._drive import Drive as Drive, Move as Move, joint_moves as joint_moves, sampled as sampled
from ._hysteresis import HysteresisInputs as HysteresisInputs, HysteresisModel as HysteresisModel
from ._hysteresis_definition import hysteresis_keys as hysteresis_keys
from ._joint import (
    JointInputs as JointInputs,
    JointModel as JointModel,
    joint_from_section as joint_from_section,
)
from ._muscle import MuscleInputs as MuscleInputs, MuscleModel as MuscleModel
from ._protocol import (
    AbstractModel as AbstractModel,
    Channels as Channels,
    Derived as Derived,
    Integration as Integration,
)
from ._recording import (
    RecordingErrors as RecordingErrors,
    recorded_again as recorded_again,
    with_errors as with_errors,
)
from ._synthesise import synthesise as synthesise
