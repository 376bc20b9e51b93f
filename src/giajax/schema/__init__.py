"""What parameters, files and kinds of models are declared to be. Imports no JAX."""

from ._arm import ARM as ARM, DEFAULT_PRESET as DEFAULT_PRESET, check_obstacles as check_obstacles
from ._arm_sections import (
    MUSCLE_KEYS as MUSCLE_KEYS,
    ArmSection as ArmSection,
    CamerasSection as CamerasSection,
    CommandSection as CommandSection,
    FillingSection as FillingSection,
    InitialSection as InitialSection,
    LandmarksSection as LandmarksSection,
    Obstacle as Obstacle,
    PinholeSection as PinholeSection,
    PointMass as PointMass,
    SensorsSection as SensorsSection,
    WindSection as WindSection,
    sections_of_cameras as sections_of_cameras,
)
from ._declaration import (
    QUANTITIES as QUANTITIES,
    QUANTITY_OF_SUFFIX as QUANTITY_OF_SUFFIX,
    Declaration as Declaration,
    Finite as Finite,
    Group as Group,
    Key as Key,
    Name as Name,
    Positive as Positive,
    Prior as Prior,
    Quantity as Quantity,
    Section as Section,
    flat as flat,
    key as key,
    key_factor as key_factor,
    si_factor as si_factor,
    with_keys as with_keys,
)
from ._expression import Expression as Expression
from ._joint import (
    HYSTERESIS as HYSTERESIS,
    JOINT as JOINT,
    MUSCLE as MUSCLE,
    OSCILLATOR as OSCILLATOR,
    HysteresisSection as HysteresisSection,
    JointSection as JointSection,
    MuscleSection as MuscleSection,
    OscillatorSection as OscillatorSection,
)
from ._kind import (
    ChannelKind as ChannelKind,
    Kind as Kind,
    Naming as Naming,
    RecordedChannel as RecordedChannel,
    RecordedRun as RecordedRun,
    Sections as Sections,
    SectionTemplate as SectionTemplate,
)
from ._mission import MissionSection as MissionSection, PadFile as PadFile, PadSection as PadSection
from ._quantities_arm import (
    AIR as AIR,
    BASE as BASE,
    BUOYANCY as BUOYANCY,
    CAMERA as CAMERA,
    CONTACT as CONTACT,
    ENCODER as ENCODER,
    GAS as GAS,
    INITIAL as INITIAL,
    JOINT_MEMORY as JOINT_MEMORY,
    JOINT_STOPS as JOINT_STOPS,
    JOINTS as JOINTS,
    LANDMARK as LANDMARK,
    LINKS as LINKS,
    MARKER as MARKER,
    PINHOLE as PINHOLE,
    POINT_MASSES as POINT_MASSES,
    PORTS as PORTS,
    SKIN as SKIN,
    SUPPLY as SUPPLY,
)
from ._quantities_joint import (
    ALPHA as ALPHA,
    AT_REST as AT_REST,
    BETA as BETA,
    BOUC_WEN as BOUC_WEN,
    BOUC_WEN_OSCILLATOR as BOUC_WEN_OSCILLATOR,
    BRAIDED as BRAIDED,
    BRANCH_COMPENSATOR as BRANCH_COMPENSATOR,
    DEAD_ZONES as DEAD_ZONES,
    DRIVE as DRIVE,
    EMPIRICAL as EMPIRICAL,
    FRICTION as FRICTION,
    GEOMETRY as GEOMETRY,
    LOAD as LOAD,
    LOOP as LOOP,
    MODIFIED_PRANDTL_ISHLINSKII as MODIFIED_PRANDTL_ISHLINSKII,
    PISTON as PISTON,
    PLAY as PLAY,
    PRANDTL_ISHLINSKII as PRANDTL_ISHLINSKII,
    PREISACH as PREISACH,
    STOP as STOP,
)

KINDS: dict[str, Kind] = {kind.name: kind for kind in vars().values() if isinstance(kind, Kind)}
"""The kinds by name; nothing else in the toolkit knows which there are."""
