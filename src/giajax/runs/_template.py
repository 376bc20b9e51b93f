"""A sidecar to fill in, made from the declarations of the vocabulary."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ._arm_sections import Arm, Command, Initial, Sensors, Wind
from ._checks import DEFAULT_LINKS, DEFAULT_PRESET
from ._definition import Definition
from ._fit_sections import Noise
from ._model import GIVEN, PREDICTED, infer_model
from ._part_sections import Hysteresis, Joint, Muscle
from ._table import Table, read_table
from ._toml import key_path, toml_value

# Sections of one model, all of whose keys are offered.
_SECTIONS: dict[str, type[BaseModel]] = {
    "hysteresis": Hysteresis,
    "joint": Joint,
    "muscle": Muscle,
}

# A value to show where the preset has none.
_EXAMPLES: dict[str, Any] = {
    "model": "arm",
    "origin": "who recorded this, with what, when",
    "licence": "CC0-1.0",
    "free_motion": True,
    "angle_deg": 0.0,
    "rate_deg_per_s": 0.0,
    "first_row": True,
    "free": True,
    "point_masses": [{"link": 20, "mass_kg": 0.003, "position_m": 0.99}],
    "parameters": {"air.added_mass_coefficient": 1.0},
    "camera_rotation_deg": [0.0, 5.0, 0.0],
    "camera_origin_m": [0.0, 0.1, 0.0],
    "camera_scale": 1.0,
    "camera_delay_s": 0.05,
    "marker_along_m": 0.0,
    "marker_left_m": 0.0,
    "marker_up_m": 0.15,
    "marker_tip_m": [0.0, 0.0, 0.0],
    "encoder_offset_deg": 0.0,
    "encoder_scale": 1.0,
    "encoder_delay_s": 0.05,
    "interpolation": "linear",
    "velocity_m_per_s": [0.0, 0.0, 0.2],
}
_NOISE = {
    "position_m": (("link_position", "tip_position"), 0.01),
    "angle_deg": (("joint_angle", "link_angle"), 0.5),
    "rate_deg_per_s": (("joint_rate",), 1.0),
}


def sidecar_template(path: str | Path, rename: Mapping[str, str] | None = None) -> str:
    """TOML text of a sidecar for the run at `path`.

    It states what the file itself tells (model, checksum, free motion) and offers, as comments
    with unit and meaning, every other key of the vocabulary that applies. An old sidecar is not
    read. Raises `InputError` if the file is not a table of known columns.
    """
    path = Path(path)
    table = read_table(path, rename)
    model = infer_model(table.channels.values())
    lines = [
        f"# Sidecar of {path.name}. Remove the '#' before a key to state it; what is not stated",
        f"# is as in the preset {DEFAULT_PRESET}."
        if model == "arm"
        else "# is assumed or unknown.",
        "schema_version = 1",
        _line(Definition, "model", model),
        _line(Definition, "origin"),
        _line(Definition, "licence"),
        _line(Definition, "sha256", table.sha256),
    ]
    if model == "arm":
        lines += _arm(table)
    if model in _SECTIONS:
        section = _SECTIONS[model]
        lines += ["", f"[{model}]  # unless stated: what giajax assumes"]
        lines += [_line(section, name) for name in section.model_fields]
    lines += _noise(table, model)
    lines += ["", "# [truth]  what you know and a fit should find; no fit reads it"]
    return "\n".join(lines) + "\n"


def _arm(table: Table) -> list[str]:
    kinds = {channel.kind for channel in table.channels.values()}
    largest = max((channel.index or 0 for channel in table.channels.values()), default=0)
    lines = []
    if not kinds & set(GIVEN["arm"]):
        lines.append(_line(Definition, "free_motion", True))
    lines += ["", "[arm]  # known constants; a number holds for all links, a list has one a link"]
    for name in Arm.model_fields:
        stated = largest if name == "links" and largest > DEFAULT_LINKS else None
        lines.append(_line(Arm, name, stated))
    lines += ["", "[sensors]  # known errors of the recording; a fit can find them too"]
    lines += [
        _line(Sensors, name)
        for name in Sensors.model_fields
        if _records(name.partition("_")[0], kinds)
    ]
    lines += ["", "[initial]  # at the first sample; a number holds for all joints"]
    angles = {c.index for c in table.channels.values() if c.kind == "joint_angle"}
    recorded = largest > 0 and angles == set(range(1, largest + 1))
    state = ["first_row"] if recorded else ["angle_deg", "rate_deg_per_s"]
    lines += [_line(Initial, name) for name in (*state, "free")]
    if kinds & set(GIVEN["arm"]):
        lines += ["", "[command]", _line(Command, "interpolation")]
    lines += ["", "[wind]"]
    lines.append(_line(Wind, "interpolation" if "wind" in kinds else "velocity_m_per_s"))
    return lines


def _records(sensor: str, kinds: set[str]) -> bool:
    """Whether a sensor records one of these kinds of channels."""
    angles = {"joint_angle", "joint_rate", "link_angle"}
    return bool(kinds & (angles if sensor == "encoder" else {"link_position", "tip_position"}))


def _noise(table: Table, model: str | None) -> list[str]:
    measured = [
        channel
        for channel in table.channels.values()
        if model is not None and channel.kind in PREDICTED[model]
    ]
    lines = []
    for name, (kinds, example) in _NOISE.items():
        if any(channel.kind in kinds for channel in measured):
            lines.append(_line(Noise, name, example=example))
    if measured:
        column = measured[-1].column
        meaning = "one column by its name, in its unit; wins over its quantity"
        lines.append(f"# {column} = 0.01  # {meaning}")
        lines = ["", "[noise]  # not stated: a fit estimates it", *lines]
    return lines


def _line(section: type[BaseModel], name: str, stated: Any = None, *, example: Any = None) -> str:
    """`key = value  # meaning`, commented out unless the value is stated."""
    field = section.model_fields[name]
    value = stated
    if value is None:
        value = example if example is not None else _shown_value(name, field)
    text = f"{key_path((name,))} = {toml_value(value)}  # {field.description}"
    return text if stated is not None else f"# {text}"


def _shown_value(name: str, field: FieldInfo) -> Any:
    extra = field.json_schema_extra
    preset = extra.get("preset") if isinstance(extra, dict) else None
    return preset if preset is not None else _EXAMPLES[name]
