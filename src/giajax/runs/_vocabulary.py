"""The one TOML vocabulary of sidecars, fit definitions and a user's own arm."""

import tomllib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from .._errors import InputError
from ._channels import parse_column
from ._complaints import complaint, plain
from ._toml import to_toml

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Name = Annotated[str, Field(min_length=1)]


def key(must: str, meaning: str, *, preset: Any = None, default: Any = None) -> Any:
    """Declare a key once: what it must be (errors), what it means (`giajax init`).

    `preset` is its value in the preset `takeichi_20m`, for the template of a sidecar.
    """
    extra = {"must": must, "preset": preset}
    return Field(default=default, description=meaning, json_schema_extra=extra)


class _Section(BaseModel):
    # Strict: "0.3" and true are not numbers here. An int where a float is meant is one.
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, frozen=True)

    def given(self) -> dict[str, Any]:
        """The keys that were given, with their values."""
        return self.model_dump(exclude_unset=True)


_PER_LINK = "or a list of them, one a link"


class PointMass(_Section):
    """An entry of `[[arm.point_masses]]`: a small body fixed to a link."""

    link: Annotated[int, Field(ge=1)] = key(
        "a whole number of at least 1", "link that carries it", default=...
    )
    mass_kg: Positive = key("a positive number", "its mass", default=...)
    position_m: Finite = key(
        "a number", "its distance from the link's joint, along the link", default=...
    )
    left_m: Finite = key("a number", "its distance to the left of the link's axis", default=0.0)
    up_m: Finite = key("a number", "its distance above the link's axis", default=0.0)


class Arm(_Section):
    """`[arm]`: the known constants of the arm. A number holds for all links."""

    preset: Name | None = key(
        "the name of a preset", "arm that the other keys change", preset="takeichi_20m"
    )
    links: Annotated[int, Field(ge=1)] | None = key(
        "a whole number of at least 1", "number of links; joint i precedes link i", preset=20
    )
    link_length_m: Positive | list[Positive] | None = key(
        f"a positive number {_PER_LINK}", "length of a link", preset=0.99
    )
    link_diameter_m: NotNegative | list[NotNegative] | None = key(
        f"zero or a positive number {_PER_LINK}", "diameter that meets the air", preset=0.3
    )
    link_mass_kg: Positive | list[Positive] | None = key(
        f"a positive number {_PER_LINK}", "mass that moves with a link", preset=0.047
    )
    link_inertia_transverse_kg_m2: NotNegative | list[NotNegative] | None = key(
        f"zero or a positive number {_PER_LINK}",
        "about the centre of mass, across the link",
        preset=0.004367475,
    )
    link_inertia_axial_kg_m2: NotNegative | list[NotNegative] | None = key(
        f"zero or a positive number {_PER_LINK}", "about the link's own axis", preset=0.0010575
    )
    link_centre_of_mass_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}", "distance of the centre of mass from the joint", preset=0.495
    )
    joint_axes: Literal["pitch_yaw"] | list[Literal["pitch", "yaw"] | Vector] | None = key(
        '"pitch_yaw" or a list of "pitch", "yaw" or [x, y, z], one a joint',
        "axes of the joints in the straight arm; pitch_yaw alternates, pitch first",
        preset="pitch_yaw",
    )
    base_rotation_deg: Vector | None = key(
        "a list of three numbers", "rotation vector of the base", preset=[0.0, 0.0, 0.0]
    )
    air_density_kg_per_m3: NotNegative | None = key(
        "zero or a positive number", "density of the air", preset=1.204
    )
    gravity_m_per_s2: NotNegative | None = key(
        "zero or a positive number (it acts along -z)",
        "acceleration of gravity; 0 when buoyancy balances weight",
        preset=0.0,
    )
    drag: Literal["centre", "strip"] | None = key(
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
    buoyancy: bool | None = key(
        "true or false", "displaced air, helium and trim weights count", preset=False
    )
    trim: bool | None = key(
        "true or false", "hang the trim weights that make each link float", preset=False
    )
    point_masses: list[PointMass] | None = key(
        "a list of tables with link, mass_kg and position_m", "bodies fixed to links"
    )
    parameters: dict[Name, Finite | list[Finite]] | None = key(
        "a table of parameter paths and numbers",
        "any other parameter by its path, SI ('giajax parameters' lists them)",
    )

    @field_validator("parameters", mode="before")
    @classmethod
    def _unquoted_paths_are_paths(cls, table: Any) -> Any:
        return _flat(table) if isinstance(table, Mapping) else table

    @field_validator("joint_axes")
    @classmethod
    def _axes_have_a_direction(cls, axes: Any) -> Any:
        if isinstance(axes, list) and [0.0, 0.0, 0.0] in axes:
            raise ValueError("has the axis [0, 0, 0], but must have a direction: correct it")
        return axes

    @model_validator(mode="after")
    def _lists_agree(self) -> "Arm":
        # Without `links` the lists must still agree with each other; the run checks the rest.
        self.check_lists(self.links)
        return self

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if a list has another length than `links` (None: than another)."""
        said = f"links is {links}" if links is not None else ""
        for name in type(self).model_fields:
            value = getattr(self, name)
            if not isinstance(value, list) or name in ("base_rotation_deg", "point_masses"):
                continue
            if links is None:
                links, said = len(value), f"{name} has {len(value)}"
            elif len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each link and "
                    f"{said}: correct the list or give links"
                )


Delay = Annotated[float, Field(ge=-5, le=5, allow_inf_nan=False)]
_DELAY = "a number from -5 to 5"


class Sensors(_Section):
    """`[sensors]`: what is known of camera, markers and angle sensors. Unless given: exact."""

    camera_rotation_deg: Vector | None = key(
        "a list of three numbers", "rotation vector of the camera frame in the base frame"
    )
    camera_origin_m: Vector | None = key(
        "a list of three numbers", "origin of the camera frame in the base frame"
    )
    camera_scale: Positive | None = key("a positive number", "recorded over true distances")
    camera_delay_s: Delay | None = key(_DELAY, "how long before its time stamp a position was true")
    marker_along_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}", "distance of a link's marker from its centre, along the link"
    )
    marker_left_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}", "distance of a link's marker to the left of its centre"
    )
    marker_up_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}", "distance of a link's marker above its centre"
    )
    marker_tip_m: Vector | None = key(
        "a list of three numbers", "offset of the tip's marker from the tip: along, left, up"
    )
    encoder_offset_deg: Finite | list[Finite] | None = key(
        "a number or a list of them, one a joint", "what an angle sensor shows at the angle 0"
    )
    encoder_scale: Positive | list[Positive] | None = key(
        "a positive number or a list of them, one a joint", "shown over true changes of an angle"
    )
    encoder_delay_s: Delay | None = key(
        _DELAY, "how long before its time stamp a joint's angle was true"
    )


class Initial(_Section):
    """`[initial]`: joint angles and rates at the first sample. Unless given: straight, at rest."""

    angle_deg: Finite | list[Finite] | None = key(
        "a number or a list of them, one a joint", "joint angles at the first sample"
    )
    rate_deg_per_s: Finite | list[Finite] | None = key(
        "a number or a list of them, one a joint", "joint rates at the first sample"
    )
    first_row: bool | None = key(
        "true or false", "true: as in the first row of the joint angle and rate columns"
    )
    free: bool | None = key(
        "true or false", "true: parameters of this run, which a fit finds; the others are a start"
    )

    @model_validator(mode="after")
    def _stated_once(self) -> "Initial":
        if self.first_row and (self.angle_deg is not None or self.rate_deg_per_s is not None):
            raise ValueError(
                "says first_row = true and angle_deg or rate_deg_per_s, but must say the state "
                "once: remove one or the other"
            )
        return self


Interpolation = Literal["zoh", "linear"]
_BETWEEN_ROWS = '"linear" or "zoh" (held until the next row)'


class Command(_Section):
    """`[command]`: how the joint commands run between two rows."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS, "between two rows: linear, or zoh (held)", default="linear"
    )


class Wind(_Section):
    """`[wind]`: how the wind columns run between two rows, or a constant wind instead."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS, "between two rows: linear, or zoh (held)", default="linear"
    )
    velocity_m_per_s: Vector | None = key(
        "a list of three numbers", "constant wind (x, y, z), instead of wind columns"
    )


_NOISE = "a positive number, the standard deviation"


class Noise(_Section):
    """`[noise]`: standard deviations of white noise, by quantity or by column."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow", strict=True, frozen=True)
    __pydantic_extra__: dict[str, Positive] = Field(init=False)

    position_m: Positive | None = key(_NOISE, "standard deviation of every position")
    angle_deg: Positive | None = key(_NOISE, "standard deviation of every angle")
    rate_deg_per_s: Positive | None = key(_NOISE, "standard deviation of every joint rate")

    @property
    def columns(self) -> dict[str, float]:
        """The standard deviations given by column name, in the column's unit."""
        return dict(self.__pydantic_extra__ or {})

    @model_validator(mode="after")
    def _extra_keys_are_columns(self) -> "Noise":
        for name in self.columns:
            try:
                parse_column(name)
            except InputError:
                raise ValueError(
                    f"key {name!r} must be {', '.join(type(self).model_fields)} or a column of "
                    "the run: correct or remove it"
                ) from None
        return self


Count = Annotated[int, Field(ge=1)]
CountOrPositive = Count | Annotated[list[Positive], Field(min_length=1)]
_EITHER = "a whole number of at least 1, or a list of positive numbers"


class Hysteresis(_Section):
    """`[hysteresis]`: which operator, and what of it is no parameter. Values in SI units."""

    operator: (
        Literal[
            "prandtl_ishlinskii",
            "modified_prandtl_ishlinskii",
            "preisach",
            "bouc_wen",
            "bouc_wen_oscillator",
        ]
        | None
    ) = key(
        "one of prandtl_ishlinskii, modified_prandtl_ishlinskii, preisach, bouc_wen and "
        "bouc_wen_oscillator",
        "the operator; bouc_wen_oscillator is a mass on a spring with a Bouc-Wen element",
        preset="prandtl_ishlinskii",
    )
    elements: Literal["play", "stop"] | None = key(
        '"play" or "stop"', "what a Prandtl-Ishlinskii operator is made of", preset="play"
    )
    thresholds: CountOrPositive | None = key(
        _EITHER,
        "thresholds of its elements (SI), or how many there are, evenly up to half the input",
        preset=10,
    )
    upper_dead_zones: CountOrPositive | None = key(
        _EITHER,
        "dead zones of the modified form above 0 (SI), or how many, densest at 0",
        preset=5,
    )
    lower_dead_zones: CountOrPositive | None = key(
        _EITHER, "the same below 0, as distances from it", preset=5
    )
    rows: Annotated[int, Field(ge=2)] | None = key(
        "a whole number of at least 2", "rows of the Preisach mesh", preset=40
    )
    input_range: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None = key(
        "a list of two numbers, the lower one first",
        "range of the input (SI) that the operator covers; that of the runs unless stated",
        preset=[-1.0, 1.0],
    )
    previous_extremes: Count | Annotated[list[Finite], Field(min_length=1)] | None = key(
        "a whole number of at least 1, or a list of numbers",
        "turning points of the input before the run (SI), or how many a fit may find",
        preset=1,
    )
    interpolation: Literal["linear", "band_limited"] | None = key(
        '"linear" or "band_limited" (one period of evenly sampled rows)',
        "force between two rows of an oscillator's run",
        preset="linear",
    )

    @field_validator("input_range")
    @classmethod
    def _range_is_one(cls, ends: Any) -> Any:
        if ends is not None and not ends[0] < ends[1]:
            raise ValueError(f"is {ends}, but must have the lower number first: correct it")
        return ends


Point = Annotated[list[Finite], Field(min_length=2, max_length=2)]
_POINT = "a list of two numbers: along the link, and off its axis towards the muscle"


class Joint(_Section):
    """`[joint]`: one joint with its muscle. Points are in the frame of their link."""

    correction: Literal["continuous", "printed", "none"] | None = key(
        '"continuous", "printed" or "none"',
        "alpha and beta read with the size of the angle, as printed (an erratum), or zero",
        preset="continuous",
    )
    blend_deg: Annotated[float, Field(ge=0, le=30, allow_inf_nan=False)] | None = key(
        "a number from 0 to 30", "half-width about 0 in which alpha and beta join", preset=0.0
    )
    torque_N_m: Positive | None = key(  # noqa: N815
        "a positive number", "torque on the joint where no column gives it", preset=0.3
    )
    anchor_m: Point | None = key(_POINT, "ends A, C, M, N of the muscle", preset=[0.9, 0.18])
    wire_m: Point | None = key(_POINT, "ends B, D of the wire", preset=[0.03, 0.04])
    contact_m: Point | None = key(_POINT, "shoulders P, Q of the balloon", preset=[0.055, 0.15])
    wire_length_m: Positive | None = key("a positive number", "length of the wire", preset=0.34)
    muscle_length_m: Positive | None = key(
        "a positive number", "length of the muscle at rest", preset=1.96
    )


class Muscle(_Section):
    """`[muscle]`: which law, what is known of the muscle, and whether it has friction."""

    law: Literal["braided", "empirical", "piston"] | None = key(
        '"braided", "empirical" or "piston"',
        "statics of a braid, a normalised shape for any length, or a cylinder",
        preset="braided",
    )
    length_m: Positive | None = key("a positive number", "length at rest", preset=1.96)
    diameter_m: Positive | None = key(
        "a positive number", "diameter of a braided muscle at rest", preset=0.0035
    )
    braid_angle_deg: Annotated[float, Field(gt=0, lt=54.7)] | None = key(
        "a number between 0 and 54.7", "angle of the braid from the axis at rest", preset=18.0
    )
    pressure_limit_kPa: Positive | None = key(  # noqa: N815
        "a positive number", "highest pressure", preset=300.0
    )
    pressure: Literal["measured", "mean"] | None = key(
        '"measured" or "mean"',
        "the pressure at each row, or its mean: what was set, where friction moves the gauge",
        preset="measured",
    )
    friction: Literal["coulomb", "none"] | None = key(
        '"coulomb" or "none"',
        "force between filling and exhausting; needs phase or time",
        preset="none",
    )
    friction_pressures_kPa: Annotated[list[NotNegative], Field(min_length=1)] | None = key(  # noqa: N815
        "a list of increasing numbers",
        "pressures at which friction has its half-widths, linear between them",
        preset=[0.0],
    )

    @field_validator("friction_pressures_kPa")
    @classmethod
    def _pressures_increase(cls, pressures: Any) -> Any:
        if pressures is not None and any(a >= b for a, b in pairwise(pressures)):
            raise ValueError(f"is {pressures}, but must increase: sort it, each pressure once")
        return pressures


class Fit(_Section):
    """`[fit]`: what to fit to what. Only in a fit definition."""

    data: list[Name] | None = key("a list of file names", "runs, relative to this file")
    free: list[Name] | None = key("a list of parameter paths", "parameters to fit")
    start: dict[Name, Finite] | None = key("a table of parameter paths and numbers", "start values")
    fix: dict[Name, Finite] | None = key(
        "a table of parameter paths and numbers", "parameters held at a value"
    )
    channels: list[Name] | None = key(
        "a list of channel names, without unit", "channels to fit; all that were measured"
    )
    window_s: Positive | None = key(
        "a positive number", "cut each run into windows of this length, each with its own start"
    )
    starts: Annotated[int, Field(ge=1)] | None = key(
        "a whole number of at least 1", "how many starts; the best end is the result"
    )
    spread: Positive | None = key(
        "a positive number", "how far the other starts are from the first: 0.3 is 30 %"
    )
    seed: Annotated[int, Field(ge=0)] | None = key(
        "zero or a positive whole number", "of the other starts"
    )
    validation: list[Name] | None = key(
        "a list of file names", "runs that the result must predict and is not fitted to"
    )
    loss: Literal["linear", "huber", "soft_l1"] | None = key(
        '"linear", "huber" or "soft_l1"', "how a large residual counts"
    )
    out: Name | None = key("the name of a folder", "where the result goes")

    @field_validator("start", "fix", mode="before")
    @classmethod
    def _unquoted_paths_are_paths(cls, table: Any) -> Any:
        # `air.drag_coefficient = 1.2` without quotes is a nested table in TOML, and means the same.
        return _flat(table) if isinstance(table, Mapping) else table


class Figure(_Section):
    """One entry of `[figures]`: what the fit of a shipped definition must reach."""

    value: Finite | None = key("a number", "expected value")
    standard_errors: Positive | None = key(
        "a positive number", "how many standard errors the result may be away from it"
    )
    relative_error: Positive | None = key(
        "a positive number", "largest standard error, relative to the fitted value"
    )
    within: Positive | None = key(
        "a positive number", "how far the result may be from the value, relative to it"
    )
    determined: bool | None = key("true or false", "false: the run must not determine it")

    @model_validator(mode="after")
    def _says_one_thing(self) -> "Figure":
        distances = [self.standard_errors, self.within]
        stated = [self.value, *distances, self.relative_error]
        if self.determined is False:
            if any(item is not None for item in stated):
                raise ValueError(
                    "says determined = false and a figure to reach, but must say one of them: "
                    "remove the other"
                )
        elif (self.value is None) != (distances == [None, None]) or stated == [None] * 4:
            raise ValueError(
                "must have value and standard_errors (or within), or relative_error, or all: "
                "add what is missing"
            )
        return self


class Definition(_Section):
    """A sidecar, a fit definition or a user's own arm. Every section and key is optional.

    A section that was not given is there with its defaults, so `definition.arm.links` is always
    legal; `definition.given()` has only what was given.
    """

    schema_version: Literal[1] = key("1", "version of this vocabulary", default=1)
    model: Literal["arm", "hysteresis", "joint", "muscle"] | None = key(
        '"arm", "hysteresis", "joint" or "muscle"', "what the run is a run of"
    )
    origin: str | None = key("text", "where the run comes from")
    licence: str | None = key("text", "terms under which it may be used")
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = key(
        "64 hexadecimal digits", "checksum of the data file"
    )
    free_motion: bool | None = key("true or false", "true: the arm moves without commands")
    arm: Arm = Field(default_factory=Arm)
    sensors: Sensors = Field(default_factory=Sensors)
    initial: Initial = Field(default_factory=Initial)
    command: Command = Field(default_factory=Command)
    wind: Wind = Field(default_factory=Wind)
    hysteresis: Hysteresis = Field(default_factory=Hysteresis)
    joint: Joint = Field(default_factory=Joint)
    muscle: Muscle = Field(default_factory=Muscle)
    noise: Noise = Field(default_factory=Noise)
    truth: dict[str, Any] = key(
        "a table", "what the maker of the data knows; never read by a fit", default={}
    )
    fit: Fit = Field(default_factory=Fit)
    figures: dict[Name, Figure] = key(
        'a table like [figures."air.drag_coefficient"]', "figures to reach", default={}
    )

    @field_validator("sha256", mode="before")
    @classmethod
    def _lower_case(cls, digits: Any) -> Any:
        return digits.lower() if isinstance(digits, str) else digits

    @classmethod
    def parse(cls, data: Mapping[str, Any], source: str = "definition") -> "Definition":
        """The definition that plain data state; `source` names them in errors.

        Raises `InputError` for an unknown key (with the nearest known one) and for a value that
        is not what its key must be.
        """
        try:
            return cls.model_validate(plain(data))
        except ValidationError as error:
            raise complaint(cls, error, source) from None

    @classmethod
    def load(cls, path: str | Path) -> "Definition":
        """Read a TOML file. Raises `InputError` if it is missing, not TOML or not legal."""
        path = Path(path)
        try:
            text = path.read_bytes().decode("utf-8-sig")
            data = tomllib.loads(text)
        except FileNotFoundError:
            raise InputError(f"{path} does not exist: give the path of a TOML file") from None
        except UnicodeDecodeError:
            raise InputError(f"{path} is not text: it must be TOML in UTF-8") from None
        except tomllib.TOMLDecodeError as error:
            reason = " ".join(str(error).split())
            raise InputError(f"{path} is not valid TOML ({reason}): correct that line") from None
        except OSError as error:
            raise InputError(
                f"{path} cannot be read ({error.strerror}): give a TOML file"
            ) from None
        return cls.parse(data, str(path))

    def merged_with(self, other: "Definition") -> "Definition":
        """This definition with what `other` gives on top, key by key within each section.

        Raises `InputError` if the two together contradict themselves.
        """
        merged = self.given()
        for name, value in other.given().items():
            # An entry of [figures] says one thing, and is replaced as a whole.
            depth = 1 if name == "figures" else 2
            merged[name] = _merge(merged.get(name), value, depth)
        return Definition.parse(merged, "definitions taken together")

    def to_toml(self) -> str:
        """TOML text with what was given, the version first; `load` reads it back."""
        return to_toml({"schema_version": self.schema_version, **self.given()})


def _merge(below: Any, above: Any, depth: int) -> Any:
    if depth == 0 or not isinstance(below, dict) or not isinstance(above, dict):
        return above
    merged = dict(below)
    for name, value in above.items():
        merged[name] = _merge(merged.get(name), value, depth - 1)
    return merged


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{before}{name}."))
        else:
            flat[f"{before}{name}"] = value
    return flat
