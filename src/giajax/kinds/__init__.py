"""The kinds of models: what their runs hold and what their files say. Imports no JAX.

A kind is a file here, which declares it, one in `giajax.models`, which computes, and the line that
imports it below. Readers, commands, fits and reports ask the kind, and know none by name.
"""

from ._arm import ARM as ARM, check_obstacles as check_obstacles
from ._arm_channels import DEFAULT_PRESET as DEFAULT_PRESET
from ._arm_inputs import (
    CommandSection as CommandSection,
    InitialSection as InitialSection,
    WindSection as WindSection,
)
from ._arm_sections import (
    MUSCLE_KEYS as MUSCLE_KEYS,
    ArmSection as ArmSection,
    Obstacle as Obstacle,
    PointMass as PointMass,
    SensorsSection as SensorsSection,
)
from ._camera_sections import (
    CamerasSection as CamerasSection,
    LandmarksSection as LandmarksSection,
    PinholeSection as PinholeSection,
    sections_of_cameras as sections_of_cameras,
)
from ._content import (
    Content as Content,
    RecordedChannel as RecordedChannel,
    Sections as Sections,
    Wording as Wording,
)
from ._filling import FillingSection as FillingSection
from ._hysteresis import HYSTERESIS as HYSTERESIS, HysteresisSection as HysteresisSection
from ._joint import JOINT as JOINT, JointSection as JointSection
from ._keys import with_keys as with_keys
from ._kind import ChannelKind as ChannelKind, Kind as Kind, Offer as Offer
from ._mission import MissionSection as MissionSection
from ._muscle import MUSCLE as MUSCLE, MuscleSection as MuscleSection
from ._oscillator import OSCILLATOR as OSCILLATOR, OscillatorSection as OscillatorSection
from ._pad import PadFile as PadFile, PadSection as PadSection
from ._section import (
    Finite as Finite,
    Name as Name,
    Positive as Positive,
    Section as Section,
    flat as flat,
    key as key,
)

KINDS: dict[str, Kind] = {kind.name: kind for kind in vars().values() if isinstance(kind, Kind)}
"""The kinds by name; nothing else in the toolkit knows which there are."""
