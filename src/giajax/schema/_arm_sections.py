"""Sections of an arm: constants, motion, obstacles, sensors and cameras."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator

from ..runtime.limits import LINKS as MOST_LINKS
from ..runtime.plugins import registered
from ..runtime.text import shown
from ._declaration import (
    Count,
    Finite,
    Name,
    Positive,
    Section,
    Vector,
    each_of,
    flat,
    key,
    with_keys,
)
from ._joint import ALPHA, BETA, BRAIDED, DRIVE, EMPIRICAL, GEOMETRY, LOAD, PISTON
from ._kind import CAMERA_NAME
from ._quantities_arm import (
    AIR,
    BASE,
    BUOYANCY,
    CAMERA,
    CONTACT,
    ENCODER,
    FILM,
    GAS,
    HAND,
    INITIAL,
    JOINT_MEMORY,
    JOINT_STOPS,
    JOINTS,
    LANDMARK,
    LINKS,
    MARKER,
    PINHOLE,
    POINT_MASSES,
    PORTS,
    ROLL,
    SKIN,
    SUPPLY,
)

_PLACES = re.compile("room|tip|link([0-9]{2,})")
_MOST_PIXELS = 1_000_000


@with_keys(PINHOLE)
class PinholeSection(Section):
    """`[camera.NAME]`: a camera with a lens, which records pixels."""

    mount: Annotated[str, Field(pattern=_PLACES.pattern)] | None = key(
        '"room", "tip" or a link such as "link06"',
        "body to which the camera is fixed",
        preset="room",
    )
    size_px: (
        Annotated[
            list[Annotated[int, Field(ge=1, le=_MOST_PIXELS)]], Field(min_length=2, max_length=2)
        ]
        | None
    ) = key(
        "a list of two whole numbers of pixels",
        "width and height of the image",
        example=[1920, 1080],
    )

    @field_validator("mount")
    @classmethod
    def _a_place(cls, mount: str | None) -> str | None:
        place = None if mount is None else _PLACES.fullmatch(mount)
        digits = None if place is None else place[1]
        whole = digits is None or (0 < int(digits) <= MOST_LINKS and digits == f"{int(digits):02d}")
        if mount is not None and not (place and whole):
            raise ValueError(f'is {mount!r}: give "room", "tip" or a link such as "link06"')
        return mount

    @property
    def link(self) -> int | None:
        """Number of the link that the camera is mounted on, or None."""
        return int(self.mount[4:]) if self.mount and self.mount.startswith("link") else None


@with_keys(LANDMARK)
class LandmarkSection(Section):
    """`[landmark.markNN]`: a fixed point of the room that cameras record."""


class _Named(Section):
    """A table of sections by name."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow", strict=True, frozen=True)


class CamerasSection(_Named):
    """`[camera]`: the cameras that record pixels, by name."""

    entries: ClassVar[type[Section] | None] = PinholeSection
    __pydantic_extra__: dict[str, PinholeSection] = Field(init=False)

    @model_validator(mode="after")
    def _names_are_usable(self) -> "CamerasSection":
        taken = [each.path.rpartition(".")[2] for each in CAMERA]
        for name in self.named():
            if not re.fullmatch(CAMERA_NAME, name, re.ASCII) or name in taken:
                raise ValueError(
                    f"has a camera {name!r}, but its name may contain only letters, digits and _, "
                    f"must begin with a letter and must not be one of {', '.join(taken)}: rename "
                    "it"
                )
        return self

    def check_mounts(self, links: int | None) -> None:
        """Raise `ValueError` if a camera is on a link beyond `links`; None skips the check."""
        for name, camera in self.named().items():
            if links is not None and (camera.link or 0) > links:
                raise ValueError(
                    f"{name}.mount is link {camera.link}, but the arm has only {links} links: "
                    "correct the number, or set links in [arm]"
                )


class LandmarksSection(_Named):
    """`[landmark]`: fixed points of the room that cameras record: mark01, mark02, ..."""

    entries: ClassVar[type[Section] | None] = LandmarkSection
    __pydantic_extra__: dict[str, LandmarkSection] = Field(init=False)

    @model_validator(mode="after")
    def _names_are_numbered(self) -> "LandmarksSection":
        for name, mark in self.named().items():
            number = re.fullmatch("mark([0-9]{2,3})", name, re.ASCII)
            if not number or name != f"mark{int(number[1]) or 1:02d}":
                raise ValueError(
                    f"has a landmark {name!r}, but landmarks must be called mark01, mark02, and "
                    "so on: rename it"
                )
            if "position_m" not in mark.contents():
                raise ValueError(f"does not give the position of {name}: add {name}.position_m")
        return self


def sections_of_cameras(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert values (SI) by path to keys of cameras and landmarks, as in files.

    The result is section -> name -> key -> value. It is the inverse of `values` of the sections.
    """
    sections: dict[str, dict[str, Any]] = {}
    for group, of in ((PINHOLE, PinholeSection), (LANDMARK, LandmarkSection)):
        section = next(iter(group)).path.partition(".")[0]
        found: dict[str, dict[str, Any]] = {}
        for path, value in values.items():
            first, *rest = path.split(".")
            if first == section and len(rest) == 2:
                found.setdefault(rest[0], {})[f"{first}.NAME.{rest[1]}"] = value
        if found:
            sections[section] = {name: of.keys_of(parts) for name, parts in found.items()}
    return sections


@with_keys(INITIAL)
class InitialSection(Section):
    """`[initial]`: joint angles and rates at the first sample. Default: straight and at rest."""

    first_row: bool | None = key(
        "true or false",
        "true: the initial state is read from the first row of the joint angle and rate columns",
        example=True,
    )
    free: bool | None = key(
        "true or false",
        "true: a fit estimates the initial state of this run; the other keys are start values",
        example=True,
    )

    @model_validator(mode="after")
    def _stated_once(self) -> "InitialSection":
        if self.first_row and self.values():
            raise ValueError(
                "sets first_row = true and angle_deg or rate_deg_per_s, but the state must be set "
                "only once: remove one of the two"
            )
        return self


Interpolation = Literal["zoh", "linear"]
_BETWEEN_ROWS = '"linear" or "zoh" (held until the next sample)'


class CommandSection(Section):
    """`[command]`: interpolation of the joint commands between two rows."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS,
        "interpolation of the commands between samples",
        default="linear",
        example="linear",
    )


class WindSection(Section):
    """`[wind]`: interpolation of the wind columns between two rows, or a constant wind instead."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS,
        "interpolation of the wind between samples",
        default="linear",
        example="linear",
    )
    velocity_m_per_s: Vector | None = key(
        "a list of three numbers",
        "constant wind velocity (x, y, z), used instead of wind columns",
        example=[0.0, 0.0, 0.2],
    )


# Groups for `[arm.parameters]`, which sets by path the parameters without a key.
_OF_ARMS = (LINKS, JOINTS, JOINT_MEMORY, JOINT_STOPS, BASE, AIR, BUOYANCY, POINT_MASSES)
_OF_MUSCLES = (GEOMETRY, LOAD, ALPHA, BETA, BRAIDED, EMPIRICAL, PISTON, DRIVE)
_DECLARED = {
    declaration.path: declaration for group in (*_OF_ARMS, *_OF_MUSCLES) for declaration in group
}


@with_keys(POINT_MASSES, required=True)
class PointMass(Section):
    """An entry of `[[arm.point_masses]]`: a small body fixed to a link."""

    link: Annotated[int, Field(ge=1, le=MOST_LINKS)] = key(
        f"a whole number from 1 to {MOST_LINKS}", "link that carries the body", default=...
    )
    structural: bool | None = key(
        "true or false",
        "true: the body is a part of the link itself, and link_inertia_kg_m2 replaces such "
        "bodies; giajax writes this key",
        preset=False,
    )


_SIX = Annotated[list[Finite], Field(min_length=6, max_length=6)]
_TWO = Annotated[list[Positive], Field(min_length=2, max_length=2)]
_THREE = Annotated[list[Positive], Field(min_length=3, max_length=3)]
_FOUR = Annotated[list[Positive], Field(min_length=4, max_length=4)]

# Keys of each shape besides name and centre: those that are required, and those that are optional.
SHAPES = {
    "box": (("size_m",), ("rotation_deg",)),
    "plane": (("normal",), ()),
    "wall": (("opening_m", "margins_m", "thickness_m"), ("rotation_deg",)),
}


class Obstacle(Section):
    """An entry of `[[arm.obstacles]]`: a rigid body that links may touch."""

    shape: Literal["box", "plane", "wall"] = key(
        '"box", "plane" or "wall"',
        "shape of the obstacle: a box, a half space, or a wall with an opening",
        default=...,
    )
    name: Name = key("a name", "name of the obstacle in results", default=...)
    centre_m: Vector = key(
        "a list of three numbers",
        "centre of a box or of an opening, or a point on a plane",
        default=...,
    )
    size_m: _THREE | None = key("three positive numbers", "size of a box along x, y and z")
    normal: Vector | None = key(
        "a list of three numbers", "normal of a plane, pointing away from its solid side"
    )
    opening_m: _TWO | None = key("two positive numbers", "width and height of an opening")
    margins_m: _FOUR | None = key(
        "four positive numbers",
        "width of the wall to the right of, below, to the left of and above an opening",
    )
    thickness_m: Positive | None = key("a positive number", "thickness of a wall")
    rotation_deg: Vector | None = key(
        "a list of three numbers", "rotation relative to the base frame, as a rotation vector"
    )

    @model_validator(mode="after")
    def _keys_are_those_of_its_shape(self) -> "Obstacle":
        needed, allowed = SHAPES[self.shape]
        for name in needed:
            if getattr(self, name) is None:
                raise ValueError(f"the {self.shape} '{self.name}' lacks the key {name}: add it")
        every = {name for keys in SHAPES.values() for part in keys for name in part}
        for name in sorted(every - {*needed, *allowed}):
            if getattr(self, name) is not None:
                raise ValueError(
                    f"the {self.shape} '{self.name}' has {name}, which belongs to another shape: "
                    f"remove it"
                )
        if self.normal == [0.0, 0.0, 0.0]:
            raise ValueError(f"the normal of '{self.name}' is zero: give a vector other than zero")
        return self


@with_keys(SUPPLY, PORTS, GAS, SKIN)
class FillingSection(Section):
    """`[filling]`: gas, bags, ports between them and supply. `giajax fill` reads it."""

    supply: Literal["flow", "regulator", "bottle"] | None = key(
        '"flow", "regulator" or "bottle"',
        "gas supply: a flow meter, or a regulator or a bottle behind a restriction",
        preset="flow",
    )
    shared: list[Annotated[list[Count], Field(min_length=2)]] | None = key(
        "a list of lists of link numbers",
        "neighbouring links without a weld between them, which share one gas volume",
        example=[[1, 2], [3, 4]],
    )


@with_keys(ROLL, FILM, HAND)
class UnrollingSection(Section):
    """`[unrolling]`: the roll, its film and its drive. `giajax unroll` reads it."""

    order: Literal["roll first", "by gas"] | None = key(
        '"roll first" or "by gas"',
        "roll first: a hand unrolls the arm before gas is injected; by gas: the gas unrolls the "
        "arm",
        preset="roll first",
    )
    hand: Literal["speed", "force"] | None = key(
        '"speed" or "force"',
        "quantity that the hand keeps constant while it unrolls the arm",
        preset="speed",
    )
    carried: bool | None = key(
        "true or false",
        "true: the roll is carried instead of lying on a floor, so its weight does not drive it",
        preset=False,
    )


# Keys that apply only if joints have muscles.
MUSCLE_KEYS = ("muscle_law", "muscle_correction", "muscle_blend_deg")


@with_keys(LINKS)
class _Links(Section):
    """Keys for the preset and the links."""

    preset: Name | None = key(
        "the name of a preset",
        'arm whose values the other keys replace; "chain" has no values and is for your own arm',
        preset="takeichi_20m",
    )
    links: Annotated[int, Field(ge=1, le=MOST_LINKS)] | None = key(
        f"a whole number from 1 to {MOST_LINKS}",
        "number of links; joint i is at the base of link i",
        preset=20,
    )


@with_keys(JOINTS, BASE, AIR, BUOYANCY, CONTACT)
class _Surroundings(_Links):
    """Keys for joints, base and air."""

    joint_axes: Literal["pitch_yaw"] | list[Literal["pitch", "yaw"] | Vector] | None = key(
        '"pitch_yaw" or a list of "pitch", "yaw" or [x, y, z], one for each joint',
        "axes of the joints in the straight arm; pitch_yaw alternates, starting with pitch",
        preset="pitch_yaw",
    )


def _known_law(role: str, *words: str) -> AfterValidator:
    """Return a validator for the name of a built-in law, or of a registered class of the role."""

    def known(word: str) -> str:
        if word not in words and registered(role, word) is None:
            listed = "".join(f'"{each}", ' for each in words).removesuffix(", ")
            raise ValueError(
                f"= {word!r} must be {listed}{' or ' * bool(words)}a registered "
                f"{'law' if words else role}: correct the name, or give "
                "--plugin FILE.py"
            )
        return word

    return AfterValidator(known)


class ArmSection(_Surroundings):
    """`[arm]`: the known constants of the arm. A number applies to all links."""

    drag: (
        Annotated[Literal["centre", "strip"] | str, _known_law("drag", "centre", "strip")] | None
    ) = key(
        '"centre" or "strip"',
        "drag computed from the velocity of the centre of each link (eq. 1), or from the cross "
        "flow at several points along the link",
        preset="centre",
    )
    strip_points: Annotated[int, Field(ge=1, le=20)] | None = key(
        "a whole number from 1 to 20", "number of Gauss points of the strip drag", preset=3
    )
    drag_curve: Literal["constant", "cylinder"] | None = key(
        '"constant" or "cylinder"',
        "drag coefficient C_D, which is constant or depends on the Reynolds number as for a "
        "cylinder",
        preset="constant",
    )
    added_mass: Literal["kirchhoff", "inertia"] | None = key(
        '"kirchhoff" or "inertia"',
        "added mass with its velocity-product terms (kirchhoff), or only as a part of the mass "
        "matrix (inertia)",
        preset="kirchhoff",
    )
    joint_laws: list[Annotated[str, _known_law("joint", "hardening", "end_stops")]] | None = key(
        'a list of "hardening", "end_stops"',
        "joint laws in addition to springs, dampers and hysteresis",
        example=["hardening"],
    )
    wind_field: Annotated[str, _known_law("wind")] | None = key(
        "the name of a registered wind",
        "wind as a function of position and time, added to the wind of the run",
    )
    buoyancy: bool | None = key(
        "true or false", "true: displaced air, helium and trim weights are included", preset=False
    )
    trim: bool | None = key(
        "true or false", "true: add the trim weights that make each link float", preset=False
    )
    link_inertia_kg_m2: _SIX | list[_SIX] | None = key(
        "six numbers (xx, yy, zz, xy, xz, yz) or a list of such rows, one for each link",
        "inertia tensor about the centre of mass of a link that is not axially symmetric; "
        "replaces the transverse and axial moments of inertia",
        example=[1e-4, 5e-3, 5.1e-3, 1e-4, 0.0, 0.0],
    )
    point_masses: list[PointMass] | None = key(
        "a list of tables with link, mass_kg and position_m",
        "bodies fixed to links",
        example=[{"link": 20, "mass_kg": 0.003, "position_m": 0.99}],
    )
    obstacles: list[Obstacle] | None = key(
        "a list of tables with shape, name and centre_m",
        "obstacles that links may touch: boxes, planes, walls with an opening",
        example=[{"shape": "plane", "name": "ground", "centre_m": [0, 0, -8], "normal": [0, 0, 1]}],
    )
    muscles: Literal["pitch", "all"] | list[Annotated[int, Field(ge=1, le=MOST_LINKS)]] | None = (
        key(
            '"pitch", "all" or a list of joint numbers',
            "joints driven by pairs of muscles, which replace their springs",
            example="pitch",
        )
    )
    muscle_law: Literal["braided", "empirical"] | None = key(
        '"braided" or "empirical"', "force law of these muscles, as in [muscle]", preset="braided"
    )
    muscle_correction: Literal["continuous", "none"] | None = key(
        '"continuous" or "none"',
        "torque corrections alpha and beta of joints with muscles, as in [joint]",
        preset="continuous",
    )
    muscle_blend_deg: Annotated[float, Field(gt=0, le=30, allow_inf_nan=False)] | None = key(
        "a number above 0 and up to 30",
        "half-width of the interval of joint angles about 0 in which alpha and beta are blended; "
        "a jump between them would stop a joint at 0",
        preset=1.0,
    )
    parameters: dict[Name, Finite | list[Finite]] | None = key(
        "a table of parameter paths and numbers",
        "any other parameter by its path, in SI units ('giajax parameters' lists them)",
        example={"air.added_mass_coefficient": 1.0},
    )

    @model_validator(mode="before")
    @classmethod
    def _earlier_names(cls, data: Any) -> Any:
        """Replace former names of keys, which files of earlier versions contain."""
        if not isinstance(data, Mapping):
            return data
        keys = (part.key for several in cls.quantities.values() for part in several)
        now = {key.earlier: key.name for key in keys if key is not None and key.earlier}
        for before, name in now.items():
            if before in data and name in data:
                raise ValueError(
                    f"gives {name} twice, because {before} is the former name of this parameter: "
                    "remove the former name"
                )
        return {now.get(name, name): value for name, value in data.items()}

    @field_validator("parameters", mode="before")
    @classmethod
    def _unquoted_paths_are_paths(cls, table: Any) -> Any:
        """Flatten nested tables to paths, and replace former paths by current ones."""
        if not isinstance(table, Mapping):
            return table
        table = flat(table)
        parts = (part for several in cls.quantities.values() for part in several)
        paths = {part.earlier: part.path for part in parts if part.earlier}
        for before, path in paths.items():
            if before in table and path in table:
                raise ValueError(
                    f"gives {path} twice, because {before} is its former name: remove the former "
                    "name"
                )
        return {
            paths.get(name, name) + bracket + index: value
            for path, value in table.items()
            for name, bracket, index in [path.partition("[")]
        }

    @field_validator("parameters")
    @classmethod
    def _within_bounds(cls, table: dict[str, float | list[float]] | None) -> Any:
        # Only bounds are checked here. Whether an arm has a parameter is checked when it is built.
        for path, value in (table or {}).items():
            declaration = _DECLARED.get(path.partition("[")[0])
            if declaration is None:
                continue
            lower, upper = declaration.lower, declaration.upper
            for number in value if isinstance(value, list) else [value]:
                if not lower <= number <= upper:
                    unit = f" {declaration.unit}" if declaration.unit else ""
                    raise ValueError(
                        f"has {shown(path)} = {number:g}{unit}, but the value must be from "
                        f"{lower:g} to {upper:g}{unit}: correct or remove it"
                    )
        return table

    @field_validator("obstacles")
    @classmethod
    def _obstacles_have_names(cls, obstacles: list[Obstacle] | None) -> Any:
        names = [obstacle.name for obstacle in obstacles or []]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"has two obstacles called '{twice}': give each its own name")
        return obstacles

    @field_validator("joint_axes")
    @classmethod
    def _axes_have_a_direction(cls, axes: Any) -> Any:
        if isinstance(axes, list) and [0.0, 0.0, 0.0] in axes:
            raise ValueError("has the axis [0, 0, 0]: give an axis of non-zero length")
        return axes

    @model_validator(mode="after")
    def _muscles_are_somewhere(self) -> "ArmSection":
        about = [name for name in MUSCLE_KEYS if getattr(self, name) is not None]
        if about and self.muscles is None:
            raise ValueError(
                f"sets {about[0]}, but no joint has muscles: add muscles, or remove this key"
            )
        return self

    @model_validator(mode="after")
    def _lists_agree(self) -> "ArmSection":
        # An element such as `links.mass[2]` does not conflict, because it overrides the array.
        for name in self.contents():
            for declaration in self.quantities.get(name, ()):
                if declaration.path in (self.parameters or {}):
                    raise ValueError(
                        f"gives {declaration.path} twice, by the key {name} and in "
                        "[arm.parameters]: remove one"
                    )
        # Without `links` the lists must still have equal lengths; the other checks need the run.
        self.check_lists(self.links)
        return self

    def lists(self) -> dict[str, list[Any]]:
        """Return the lists with one value for each link or joint, by key."""
        lists = {"joint_axes": self.joint_axes, "link_inertia_kg_m2": self.link_inertia_kg_m2}
        own = {
            name: value
            for name, value in lists.items()
            # Six numbers in one list are the inertia of all links.
            if isinstance(value, list) and not all(isinstance(x, int | float) for x in value)
        }
        return {**own, **each_of(self)}

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if the lengths of the lists differ from `links` or from each other."""
        count = f"links is {links}" if links is not None else ""
        for name, value in self.lists().items():
            if len(value) > MOST_LINKS:
                raise ValueError(
                    f"key {name} has {len(value)} values, but an arm may have at most "
                    f"{MOST_LINKS} links: shorten"
                    " the list"
                )
            if links is None:
                links, count = len(value), f"{name} has {len(value)}"
            elif len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each link, and "
                    f"{count}: correct the list or set links"
                )


_Numbers = dict[Name, Finite | list[Finite]]


_SENSORS = ("gyroscope", "accelerometer", "inclinometer", "tension", "curvature")


def _known_sensor(word: str) -> str:
    if word not in _SENSORS and registered("sensor", word) is None:
        raise ValueError(
            f"{word!r} must be {', '.join(_SENSORS)} or a registered sensor: correct the name, or "
            "give --plugin FILE.py"
        )
    return word


@with_keys(CAMERA, MARKER, ENCODER)
class SensorsSection(Section):
    """`[sensors]`: errors of camera, markers and angle sensors, which are exact by default."""

    own: dict[Annotated[str, AfterValidator(_known_sensor)], _Numbers] | None = key(
        "a table of sensors by name, each with its parameters by name and their values in SI units",
        "additional sensors; parameters of sensors with recorded columns have their defaults "
        "unless set here",
        example={"gyroscope": {"offset_z": 0.01}},
        entry="a table of parameters by name and their values in SI units",
    )

    def values(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return the quantities in the file by path, in SI, including those of other sensors."""
        own = {
            f"sensor.{name}.{parameter}": np.asarray(value, dtype=float)
            for name, stated in (self.own or {}).items()
            for parameter, value in stated.items()
        }
        return super().values() | own

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if a list has a length other than `links`; None skips the check."""
        for name, value in each_of(self).items():
            if links is not None and len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each of the "
                    f"{links} links: correct the list"
                )
