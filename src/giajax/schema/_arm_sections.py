"""The sections of an arm: constants, motion, obstacles, sensors and cameras."""

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
    """`[camera.NAME]`: a camera with a lens, which shows pixels."""

    mount: Annotated[str, Field(pattern=_PLACES.pattern)] | None = key(
        '"room", "tip" or a link such as "link06"',
        "what the camera is fixed to, and moves with",
        preset="room",
    )
    size_px: (
        Annotated[
            list[Annotated[int, Field(ge=1, le=_MOST_PIXELS)]], Field(min_length=2, max_length=2)
        ]
        | None
    ) = key(
        "a list of two whole numbers of pixels",
        "width and height of the picture",
        example=[1920, 1080],
    )

    @field_validator("mount")
    @classmethod
    def _a_place(cls, mount: str | None) -> str | None:
        place = None if mount is None else _PLACES.fullmatch(mount)
        digits = None if place is None else place[1]
        whole = digits is None or (0 < int(digits) <= MOST_LINKS and digits == f"{int(digits):02d}")
        if mount is not None and not (place and whole):
            raise ValueError(
                f'is {mount!r}, but must be "room", "tip" or a link such as "link06": correct it'
            )
        return mount

    @property
    def link(self) -> int | None:
        """The number of the link that it is fixed to, where it is one."""
        return int(self.mount[4:]) if self.mount and self.mount.startswith("link") else None


@with_keys(LANDMARK)
class LandmarkSection(Section):
    """`[landmark.markNN]`: a point of the room that cameras see."""


class _Named(Section):
    """A table of sections by name."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow", strict=True, frozen=True)


class CamerasSection(_Named):
    """`[camera]`: the cameras that show pixels, by name."""

    entries: ClassVar[type[Section] | None] = PinholeSection
    __pydantic_extra__: dict[str, PinholeSection] = Field(init=False)

    @model_validator(mode="after")
    def _names_are_usable(self) -> "CamerasSection":
        taken = [each.path.rpartition(".")[2] for each in CAMERA]
        for name in self.named():
            if not re.fullmatch(CAMERA_NAME, name, re.ASCII) or name in taken:
                raise ValueError(
                    f"has a camera {name!r}, but a name has letters, digits and _, begins with a "
                    f"letter and is not one of {', '.join(taken)}: rename it"
                )
        return self

    def check_mounts(self, links: int | None) -> None:
        """Raise `ValueError` if a camera is on a link beyond `links`, where that is known."""
        for name, camera in self.named().items():
            if links is not None and (camera.link or 0) > links:
                raise ValueError(
                    f"{name}.mount is link {camera.link}, but the arm has {links} links: correct "
                    "the number, or state links in [arm]"
                )


class LandmarksSection(_Named):
    """`[landmark]`: points of the room that cameras see, by name: mark01, mark02, ..."""

    entries: ClassVar[type[Section] | None] = LandmarkSection
    __pydantic_extra__: dict[str, LandmarkSection] = Field(init=False)

    @model_validator(mode="after")
    def _names_are_numbered(self) -> "LandmarksSection":
        for name, mark in self.named().items():
            number = re.fullmatch("mark([0-9]{2,3})", name, re.ASCII)
            if not number or name != f"mark{int(number[1]) or 1:02d}":
                raise ValueError(
                    f"has a landmark {name!r}, but they are called mark01, mark02, and so on: "
                    "rename it"
                )
            if "position_m" not in mark.contents():
                raise ValueError(f"does not say where {name} is: give {name}.position_m")
        return self


def sections_of_cameras(values: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of cameras and landmarks, as files have them, of values (SI) by path.

    It is section -> name -> key -> value: the inverse of the sections' `values`.
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
    """`[initial]`: joint angles and rates at the first sample. By default: straight, at rest."""

    first_row: bool | None = key(
        "true or false",
        "true: as in the first row of the joint angle and rate columns",
        example=True,
    )
    free: bool | None = key(
        "true or false",
        "true: parameters of this run, which a fit finds; the others are a start",
        example=True,
    )

    @model_validator(mode="after")
    def _stated_once(self) -> "InitialSection":
        if self.first_row and self.values():
            raise ValueError(
                "says first_row = true and angle_deg or rate_deg_per_s, but must say the state "
                "once: remove one or the other"
            )
        return self


Interpolation = Literal["zoh", "linear"]
_BETWEEN_ROWS = '"linear" or "zoh" (held until the next row)'


class CommandSection(Section):
    """`[command]`: how the joint commands run between two rows."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS, "between two rows", default="linear", example="linear"
    )


class WindSection(Section):
    """`[wind]`: how the wind columns run between two rows, or a constant wind instead."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS, "between two rows", default="linear", example="linear"
    )
    velocity_m_per_s: Vector | None = key(
        "a list of three numbers",
        "constant wind (x, y, z), instead of wind columns",
        example=[0.0, 0.0, 0.2],
    )


# Of `[arm.parameters]`, which states by their paths what has no key of its own.
_OF_ARMS = (LINKS, JOINTS, JOINT_MEMORY, JOINT_STOPS, BASE, AIR, BUOYANCY, POINT_MASSES)
_OF_MUSCLES = (GEOMETRY, LOAD, ALPHA, BETA, BRAIDED, EMPIRICAL, PISTON, DRIVE)
_DECLARED = {
    declaration.path: declaration for group in (*_OF_ARMS, *_OF_MUSCLES) for declaration in group
}


@with_keys(POINT_MASSES, required=True)
class PointMass(Section):
    """An entry of `[[arm.point_masses]]`: a small body fixed to a link."""

    link: Annotated[int, Field(ge=1, le=MOST_LINKS)] = key(
        f"a whole number from 1 to {MOST_LINKS}", "link that carries it", default=...
    )
    structural: bool | None = key(
        "true or false",
        "the body is part of the link itself, which link_inertia_kg_m2 replaces; giajax writes it",
        preset=False,
    )


_SIX = Annotated[list[Finite], Field(min_length=6, max_length=6)]
_TWO = Annotated[list[Positive], Field(min_length=2, max_length=2)]
_THREE = Annotated[list[Positive], Field(min_length=3, max_length=3)]
_FOUR = Annotated[list[Positive], Field(min_length=4, max_length=4)]

# The keys that each shape has beside its name and its centre; those that it needs come first.
SHAPES = {
    "box": (("size_m",), ("rotation_deg",)),
    "plane": (("normal",), ()),
    "wall": (("opening_m", "margins_m", "thickness_m"), ("rotation_deg",)),
}


class Obstacle(Section):
    """An entry of `[[arm.obstacles]]`: something rigid that links may touch."""

    shape: Literal["box", "plane", "wall"] = key(
        '"box", "plane" or "wall"', "a box, a half space, or a wall with an opening", default=...
    )
    name: Name = key("a name", "what results call it", default=...)
    centre_m: Vector = key(
        "a list of three numbers",
        "centre of a box or of an opening, or a point of a plane",
        default=...,
    )
    size_m: _THREE | None = key("three positive numbers", "size of a box along x, y and z")
    normal: Vector | None = key("a list of three numbers", "of a plane, away from its solid side")
    opening_m: _TWO | None = key("two positive numbers", "width and height of an opening")
    margins_m: _FOUR | None = key(
        "four positive numbers", "wall to the right of, below, to the left of and above an opening"
    )
    thickness_m: Positive | None = key("a positive number", "thickness of a wall")
    rotation_deg: Vector | None = key(
        "a list of three numbers", "turn against the base frame, as a rotation vector"
    )

    @model_validator(mode="after")
    def _keys_are_those_of_its_shape(self) -> "Obstacle":
        needed, allowed = SHAPES[self.shape]
        for name in needed:
            if getattr(self, name) is None:
                raise ValueError(f"the {self.shape} '{self.name}' has no {name}: add it")
        every = {name for keys in SHAPES.values() for part in keys for name in part}
        for name in sorted(every - {*needed, *allowed}):
            if getattr(self, name) is not None:
                raise ValueError(
                    f"the {self.shape} '{self.name}' has {name}, which is of another shape: "
                    "remove it"
                )
        if self.normal == [0.0, 0.0, 0.0]:
            raise ValueError(f"the normal of '{self.name}' has no direction: correct it")
        return self


@with_keys(SUPPLY, PORTS, GAS, SKIN)
class FillingSection(Section):
    """`[filling]`: gas, bags, the ports between them and the supply. `giajax fill` reads it."""

    supply: Literal["flow", "regulator", "bottle"] | None = key(
        '"flow", "regulator" or "bottle"',
        "a flow meter, or a regulator or a bottle behind a restriction",
        preset="flow",
    )
    shared: list[Annotated[list[Count], Field(min_length=2)]] | None = key(
        "a list of lists of link numbers",
        "neighbouring links that are not welded apart, and share their gas",
        example=[[1, 2], [3, 4]],
    )


@with_keys(ROLL, FILM, HAND)
class UnrollingSection(Section):
    """`[unrolling]`: the roll, its film and what drives it. `giajax unroll` reads it."""

    order: Literal["roll first", "by gas"] | None = key(
        '"roll first" or "by gas"',
        "a hand rolls the arm out, and gas is injected then; or gas rolls it out",
        preset="roll first",
    )
    hand: Literal["speed", "force"] | None = key(
        '"speed" or "force"', "what of a hand is held while it rolls the arm out", preset="speed"
    )
    carried: bool | None = key(
        "true or false",
        "the roll is carried, and does not lie on a floor: its weight does not drive it",
        preset=False,
    )


# Keys that say which muscles, where there are some.
MUSCLE_KEYS = ("muscle_law", "muscle_correction", "muscle_blend_deg")


@with_keys(LINKS)
class _Links(Section):
    """Which arm it is, and its links."""

    preset: Name | None = key(
        "the name of a preset",
        'arm that the other keys change; "chain" has no numbers, and is one of your own',
        preset="takeichi_20m",
    )
    links: Annotated[int, Field(ge=1, le=MOST_LINKS)] | None = key(
        f"a whole number from 1 to {MOST_LINKS}",
        "number of links; joint i precedes link i",
        preset=20,
    )


@with_keys(JOINTS, BASE, AIR, BUOYANCY, CONTACT)
class _Surroundings(_Links):
    """Its joints, how it stands, and the air."""

    joint_axes: Literal["pitch_yaw"] | list[Literal["pitch", "yaw"] | Vector] | None = key(
        '"pitch_yaw" or a list of "pitch", "yaw" or [x, y, z], one a joint',
        "axes of the joints in the straight arm; pitch_yaw alternates, pitch first",
        preset="pitch_yaw",
    )


def _known_law(role: str, *words: str) -> AfterValidator:
    """What a file names by a word of giajax, or as a registered class of the role."""

    def known(word: str) -> str:
        if word not in words and registered(role, word) is None:
            listed = "".join(f'"{each}", ' for each in words).removesuffix(", ")
            raise ValueError(
                f"= {word!r} must be {listed}{' or ' * bool(words)}a registered "
                f"{'law' if words else role}: correct it, or give "
                "--plugin FILE.py"
            )
        return word

    return AfterValidator(known)


class ArmSection(_Surroundings):
    """`[arm]`: the known constants of the arm. A number holds for all links."""

    drag: (
        Annotated[Literal["centre", "strip"] | str, _known_law("drag", "centre", "strip")] | None
    ) = key(
        '"centre" or "strip"',
        "drag at each link's centre (eq. 1), or across the flow along the link",
        preset="centre",
    )
    strip_points: Annotated[int, Field(ge=1, le=20)] | None = key(
        "a whole number from 1 to 20", "Gauss points of strip drag", preset=3
    )
    drag_curve: Literal["constant", "cylinder"] | None = key(
        '"constant" or "cylinder"',
        "C_D is constant, or follows the Reynolds number as that of a cylinder does",
        preset="constant",
    )
    added_mass: Literal["kirchhoff", "inertia"] | None = key(
        '"kirchhoff" or "inertia"',
        "added mass with the products of velocities that belong to it, or without, as in engines "
        "that add it to the mass matrix alone",
        preset="kirchhoff",
    )
    joint_laws: list[Annotated[str, _known_law("joint", "hardening", "end_stops")]] | None = key(
        'a list of "hardening", "end_stops"',
        "laws of the joints beside springs, dampers and hysteresis",
        example=["hardening"],
    )
    wind_field: Annotated[str, _known_law("wind")] | None = key(
        "the name of a registered wind",
        "wind that is a function of place and time, beside that of the run",
    )
    buoyancy: bool | None = key(
        "true or false", "displaced air, helium and trim weights count", preset=False
    )
    trim: bool | None = key(
        "true or false", "hang the trim weights that make each link float", preset=False
    )
    link_inertia_kg_m2: _SIX | list[_SIX] | None = key(
        "six numbers (xx, yy, zz, xy, xz, yz) or a list of such rows, one a link",
        "inertia about the centre of mass of a link that is not round about its axis; wins over "
        "the transverse and the axial one",
        example=[1e-4, 5e-3, 5.1e-3, 1e-4, 0.0, 0.0],
    )
    point_masses: list[PointMass] | None = key(
        "a list of tables with link, mass_kg and position_m",
        "bodies fixed to links",
        example=[{"link": 20, "mass_kg": 0.003, "position_m": 0.99}],
    )
    obstacles: list[Obstacle] | None = key(
        "a list of tables with shape, name and centre_m",
        "what links may touch: boxes, planes, walls with an opening",
        example=[{"shape": "plane", "name": "ground", "centre_m": [0, 0, -8], "normal": [0, 0, 1]}],
    )
    muscles: Literal["pitch", "all"] | list[Annotated[int, Field(ge=1, le=MOST_LINKS)]] | None = (
        key(
            '"pitch", "all" or a list of numbers of joints',
            "joints that pairs of muscles drive, in place of their springs",
            example="pitch",
        )
    )
    muscle_law: Literal["braided", "empirical"] | None = key(
        '"braided" or "empirical"', "law of these muscles, as of [muscle]", preset="braided"
    )
    muscle_correction: Literal["continuous", "none"] | None = key(
        '"continuous" or "none"',
        "alpha and beta of joints with muscles, as of [joint]",
        preset="continuous",
    )
    muscle_blend_deg: Annotated[float, Field(gt=0, le=30, allow_inf_nan=False)] | None = key(
        "a number above 0, and up to 30",
        "half-width about 0 in which alpha and beta join; a motion would stick at a jump",
        preset=1.0,
    )
    parameters: dict[Name, Finite | list[Finite]] | None = key(
        "a table of parameter paths and numbers",
        "any other parameter by its path, SI ('giajax parameters' lists them)",
        example={"air.added_mass_coefficient": 1.0},
    )

    @model_validator(mode="before")
    @classmethod
    def _earlier_names(cls, data: Any) -> Any:
        """Files of earlier versions have other names of keys."""
        if not isinstance(data, Mapping):
            return data
        keys = (part.key for several in cls.quantities.values() for part in several)
        now = {key.earlier: key.name for key in keys if key is not None and key.earlier}
        for before, name in now.items():
            if before in data and name in data:
                raise ValueError(f"states {name} twice, {before} being its earlier name: remove it")
        return {now.get(name, name): value for name, value in data.items()}

    @field_validator("parameters", mode="before")
    @classmethod
    def _unquoted_paths_are_paths(cls, table: Any) -> Any:
        """And those of earlier versions are what they are called now."""
        if not isinstance(table, Mapping):
            return table
        table = flat(table)
        parts = (part for several in cls.quantities.values() for part in several)
        paths = {part.earlier: part.path for part in parts if part.earlier}
        for before, path in paths.items():
            if before in table and path in table:
                raise ValueError(f"states {path} twice, {before} being its earlier name")
        return {
            paths.get(name, name) + bracket + index: value
            for path, value in table.items()
            for name, bracket, index in [path.partition("[")]
        }

    @field_validator("parameters")
    @classmethod
    def _within_bounds(cls, table: dict[str, float | list[float]] | None) -> Any:
        # Which parameters an arm has is known where it is built; what they may be is known here.
        for path, value in (table or {}).items():
            declaration = _DECLARED.get(path.partition("[")[0])
            if declaration is None:
                continue
            lower, upper = declaration.lower, declaration.upper
            for number in value if isinstance(value, list) else [value]:
                if not lower <= number <= upper:
                    unit = f" {declaration.unit}" if declaration.unit else ""
                    raise ValueError(
                        f"has {shown(path)} = {number:g}{unit}, but it must be from {lower:g} to "
                        f"{upper:g}{unit}: correct or remove it"
                    )
        return table

    @field_validator("obstacles")
    @classmethod
    def _obstacles_have_names(cls, obstacles: list[Obstacle] | None) -> Any:
        names = [obstacle.name for obstacle in obstacles or []]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"has two called '{twice}': give each its own name")
        return obstacles

    @field_validator("joint_axes")
    @classmethod
    def _axes_have_a_direction(cls, axes: Any) -> Any:
        if isinstance(axes, list) and [0.0, 0.0, 0.0] in axes:
            raise ValueError("has the axis [0, 0, 0], but must have a direction: correct it")
        return axes

    @model_validator(mode="after")
    def _muscles_are_somewhere(self) -> "ArmSection":
        about = [name for name in MUSCLE_KEYS if getattr(self, name) is not None]
        if about and self.muscles is None:
            raise ValueError(
                f"states {about[0]}, but no joints with muscles: add muscles, or remove it"
            )
        return self

    @model_validator(mode="after")
    def _lists_agree(self) -> "ArmSection":
        # An element, `links.mass[2]`, is another statement than that of the whole, and goes on top.
        for name in self.contents():
            for declaration in self.quantities.get(name, ()):
                if declaration.path in (self.parameters or {}):
                    raise ValueError(
                        f"states {declaration.path} twice, by the key {name} and in "
                        "[arm.parameters]: remove one"
                    )
        # Without `links` the lists must still agree with each other; the run checks the rest.
        self.check_lists(self.links)
        return self

    def lists(self) -> dict[str, list[Any]]:
        """The lists that have one value for each link or joint, by key."""
        lists = {"joint_axes": self.joint_axes, "link_inertia_kg_m2": self.link_inertia_kg_m2}
        own = {
            name: value
            for name, value in lists.items()
            # Six numbers alone are the inertia of all links.
            if isinstance(value, list) and not all(isinstance(x, int | float) for x in value)
        }
        return {**own, **each_of(self)}

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if a list has another length than `links` (None: than another)."""
        count = f"links is {links}" if links is not None else ""
        for name, value in self.lists().items():
            if len(value) > MOST_LINKS:
                raise ValueError(
                    f"key {name} has {len(value)} values, but an arm may have {MOST_LINKS} links "
                    "at most: shorten the list"
                )
            if links is None:
                links, count = len(value), f"{name} has {len(value)}"
            elif len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each link and "
                    f"{count}: correct the list or give links"
                )


_Numbers = dict[Name, Finite | list[Finite]]


_SENSORS = ("gyroscope", "accelerometer", "inclinometer", "tension", "curvature")


def _known_sensor(word: str) -> str:
    if word not in _SENSORS and registered("sensor", word) is None:
        raise ValueError(
            f"{word!r} must be {', '.join(_SENSORS)} or a registered sensor: correct it, or give "
            "--plugin FILE.py"
        )
    return word


@with_keys(CAMERA, MARKER, ENCODER)
class SensorsSection(Section):
    """`[sensors]`: what is known of camera, markers and angle sensors. By default: exact."""

    own: dict[Annotated[str, AfterValidator(_known_sensor)], _Numbers] | None = key(
        "a table of sensors by name, each with its parameters by name and their numbers, SI",
        "other sensors; those of columns that are there have their defaults, unless stated",
        example={"gyroscope": {"offset_z": 0.01}},
        entry="a table of parameters by name and their numbers, SI",
    )

    def values(self) -> dict[str, npt.NDArray[np.float64]]:
        """The quantities that the file has, by path, in SI; those of other sensors, too."""
        own = {
            f"sensor.{name}.{parameter}": np.asarray(value, dtype=float)
            for name, stated in (self.own or {}).items()
            for parameter, value in stated.items()
        }
        return super().values() | own

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if a list has another length than `links`, where that is known."""
        for name, value in each_of(self).items():
            if links is not None and len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each of the "
                    f"{links} links: correct the list"
                )
