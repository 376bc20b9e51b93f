"""A quantity is declared once, and models, files and tables use this declaration."""

import re
from pathlib import Path
from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
import pytest

import giajax
from giajax import InputError, Run, schema as quantities
from giajax.models import ArmModel, model_for
from giajax.recordings import complaint
from giajax.recordings._definition import _line
from giajax.schema import (
    KINDS,
    Declaration,
    FillingSection,
    Group,
    Key,
    Section,
    UnrollingSection,
    key_factor,
    with_keys,
)
from giajax.schema.parameters import declared, left_out, parameter, replace

GROUPS = {name: group for name, group in vars(quantities).items() if isinstance(group, Group)}
ROOT = Path(__file__).resolve().parents[2]
STATED = [
    stated
    for kind in KINDS.values()
    for stated in (*kind.sections.values(), *kind.run_sections.values())
]
KEYED = [
    (section, name, part)
    for stated in (*STATED, FillingSection, UnrollingSection)
    for section in (stated.entries or stated,)
    for name, parts in section.quantities.items()
    for part in parts
]


@pytest.mark.quick
@pytest.mark.parametrize("name", GROUPS)
def test_every_declaration_says_what_it_is(name):
    for quantity in GROUPS[name]:
        assert quantity.lower < quantity.upper, quantity.path
        assert quantity.lower <= quantity.default <= quantity.upper, quantity.path
        assert quantity.doc, quantity.path
        assert not quantity.doc.endswith("."), quantity.path


@pytest.mark.quick
def test_every_key_belongs_to_a_section():
    """A file could not give a key of a group that belongs to no section."""
    read = {part.path for _, _, part in KEYED} | {part.path for part in quantities.POINT_MASSES}
    keyed = {q.path for group in GROUPS.values() for q in group if q.key is not None}
    assert keyed == read
    assert len(keyed) > 30


@pytest.mark.quick
@pytest.mark.parametrize(
    ("section", "name", "part"), KEYED, ids=[f"{s.__name__}.{n}-{p.path}" for s, n, p in KEYED]
)
def test_the_default_goes_to_the_key_and_back(section, name, part):
    parts = section.quantities[name]
    values = {p.path: np.full(p.shape, p.default) for p in parts}
    stated = section.keys_of(values)
    again = section.model_validate(stated).values()
    np.testing.assert_allclose(again[part.path], values[part.path], rtol=1e-15)
    shown = section.model_fields[name].json_schema_extra["preset"]
    assert (shown is None) == part.optional
    if shown is not None and len({p.default for p in parts if p.path == part.path}) == 1:
        np.testing.assert_allclose(shown, stated[name], rtol=1e-11)


def models():
    """Return a model of each kind and variant, with all options enabled."""
    history = {"input": np.sin(np.arange(20.0)), "output": np.sin(np.arange(20.0))}
    for operator in ("prandtl_ishlinskii", "modified_prandtl_ishlinskii", "preisach", "bouc_wen"):
        about = {"model": "hysteresis", "hysteresis": {"operator": operator}}
        yield operator, Run.from_arrays(None, history, definition=about)
    yield (
        "oscillator",
        Run.from_arrays(np.arange(20.0), history, definition={"model": "oscillator"}),
    )
    for law in ("braided", "empirical", "piston"):
        about = {"muscle": {"law": law, "friction": "coulomb"}}
        columns = {"pressure": [1e5], "contraction": [0.1], "phase": ["fill"], "force": [1.0]}
        yield law, Run.from_arrays(None, columns, definition=about)
    yield "joint", Run.from_arrays(None, {"angle": [0.1], "side": ["inner"], "force": [1.0]})


def check_paths(model):
    known = {**declared(model), **left_out(model)}
    assert known
    assert {path: p.declaration.path for path, p in known.items()} == {path: path for path in known}


@pytest.mark.parametrize("run", [pytest.param(run, id=name) for name, run in models()])
def test_a_declaration_knows_its_path_in_the_model(run):
    check_paths(model_for([run]))


def test_an_arm_with_everything_is_declared_by_path():
    check_paths(ArmModel(giajax.mechanics.arm.preset("takeichi_20m_full", 2)))


def paths_of(group):
    """Return the paths of a group that belong to a part of a model."""
    return [quantity.path for quantity in group if "." in quantity.path]


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PARTS = {path.partition(".")[0] for group in GROUPS.values() for path in paths_of(group)}


@pytest.mark.quick
def test_the_paths_that_pages_name_are_declared():
    known = {path for group in GROUPS.values() for path in paths_of(group)}
    sections = {name: of for kind in KINDS.values() for name, of in kind.all_sections.items()}
    known |= {f"{name}.{key}" for name, of in sections.items() for key in of.model_fields}
    # Records and the page of former names contain former paths.
    known |= {each.earlier for group in GROUPS.values() for each in group}
    # The name of a camera is part of its paths, and pages choose a name.
    named_by_files = "|".join(name for name, of in sections.items() if of.entries)
    named = {
        (page.name, re.sub(rf"^({named_by_files})\.\w+\.", r"\1.NAME.", path))
        for page in PAGES
        for path in re.findall(
            rf"(?<![\w./\[])(?:{'|'.join(sorted(PARTS))})\.(?!csv|toml|md)[a-z_]+(?:\.[a-z_]+)*\b",
            page.read_text(encoding="utf-8"),
        )
    }
    assert len(named) > 100
    # A user-defined law has its own parameters.
    own = ("air.law.", "air.wind_field.", "joints.laws")
    assert {path for _, path in named if path not in known and not path.startswith(own)} == set()


@pytest.mark.quick
@pytest.mark.parametrize(
    ("key", "unit", "factor"),
    [
        ("link_mass_kg", "kg", 1.0),
        ("link_inertia_axial_kg_m2", "kg m^2", 1.0),
        ("air_density_kg_per_m3", "kg/m^3", 1.0),
        ("gravity_m_per_s2", "m/s^2", 1.0),
        ("camera_scale", "", 1.0),
        ("thickness_mm", "m", 1e-3),
        ("torque_N_m", "N m", 1.0),
        ("base_rotation_deg", "rad", np.pi / 180),
        ("rate_deg_per_s", "rad/s", np.pi / 180),
        ("pressure_limit_kPa", "Pa", 1e3),
    ],
)
def test_the_end_of_a_key_is_its_unit(key, unit, factor):
    assert key_factor(key, unit) == factor


@pytest.mark.quick
def test_a_key_without_its_unit_is_refused():
    with pytest.raises(ValueError, match="link_mass does not end in a unit of kg: end its name"):
        key_factor("link_mass", "kg")
    with pytest.raises(ValueError, match="end its name in"):
        key_factor("length_kPa", "m")


class _Sail(Group):
    area = Declaration(2.0, unit="m^2", lower=0, doc="area of the sail", key=Key("sail_area_m2"))
    pitch = Declaration(
        np.deg2rad(30),
        unit="rad",
        lower=0,
        upper=np.pi / 2,
        optional=True,
        doc="angle of the sail",
        key=Key("sail_pitch_deg", closed=True, remark=" (level is 0)"),
    )
    slack = Declaration(0.0, unit="m", each=True, per="link", doc="slack", key=Key("slack_mm"))
    x = Declaration(1.0, unit="m", doc="x of the mast", key=Key("mast_m", place=0, meaning="mast"))
    y = Declaration(0.5, unit="m", doc="y of the mast", key=Key("mast_m", place=1, meaning="mast"))
    colour = Declaration(0.0, unit="", doc="has no key")


SAIL = _Sail("sail")


@with_keys(SAIL)
class SailSection(Section):
    """`[sail]`: declared only here."""

    name: ClassVar[str] = "sail"


class Sail(eqx.Module):
    area: jax.Array = parameter(SAIL.area)
    pitch: jax.Array | None = parameter(SAIL.pitch)
    slack: jax.Array = parameter(SAIL.slack)
    x: jax.Array = parameter(SAIL.x)
    y: jax.Array = parameter(SAIL.y)


class Boat(eqx.Module):
    sail: Sail = eqx.field(default_factory=Sail)


@pytest.mark.quick
def test_one_declaration_makes_the_template_and_the_schema():
    lines = [_line(SailSection, name) for name in SailSection.model_fields]
    assert lines == [
        "# sail_area_m2 = 2.0  # area of the sail",
        "# sail_pitch_deg = 30.0  # angle of the sail",
        "# slack_mm = 0.0  # slack",
        "# mast_m = [1.0, 0.5]  # mast",
    ]
    schema = SailSection.model_json_schema()["properties"]
    assert schema["sail_area_m2"]["anyOf"][0] == {"exclusiveMinimum": 0.0, "type": "number"}
    assert schema["sail_pitch_deg"]["anyOf"][0]["maximum"] == pytest.approx(90.0)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("stated", "sentence"),
    [
        ({"sail_area_m2": 0}, "sail_area_m2 = 0 must be a positive number:"),
        ({"sail_pitch_deg": 91}, "= 91 must be a number from 0 to 90 (level is 0):"),
        ({"slack_mm": "much"}, "= 'much' must be a number or a list of them, one for each link:"),
        ({"mast_m": [1.0]}, "must be a list of two numbers:"),
        ({"colour": 1}, "unknown key colour"),
    ],
)
def test_one_declaration_says_what_a_file_may_state(stated, sentence):
    with pytest.raises(ValueError) as refused:
        SailSection.model_validate(stated)
    assert sentence in str(complaint(SailSection, refused.value, "boat.toml"))


def test_one_declaration_converts_between_file_and_model():
    stated = {"sail_pitch_deg": 45.0, "slack_mm": [1.0, 2.0], "mast_m": [0.3, 0.2]}
    boat = replace(Boat(), SailSection.model_validate(stated).values())
    assert float(boat.sail.pitch) == pytest.approx(np.pi / 4, rel=1e-15)
    np.testing.assert_allclose(boat.sail.slack, [1e-3, 2e-3])
    assert (float(boat.sail.x), float(boat.sail.y), float(boat.sail.area)) == (0.3, 0.2, 2.0)
    back = SailSection.keys_of({path: p.value(boat) for path, p in declared(boat).items()})
    assert list(back) == ["sail_area_m2", "sail_pitch_deg", "slack_mm", "mast_m"]
    assert back.pop("sail_area_m2") == 2.0
    assert {name: pytest.approx(value) for name, value in back.items()} == stated
    slack = declared(boat)["sail.slack"].declaration
    assert slack.meaning == "slack (one number, or one for each link)"
    assert left_out(Boat())["sail.pitch"].declaration is SAIL.pitch


def test_a_model_of_your_own_declares_at_its_field():
    class Ball(eqx.Module):
        radius: jax.Array = parameter(0.1, unit="m", lower=0, doc="radius of the ball")

    known = declared(Ball())["radius"].declaration
    assert (known.default, known.unit, known.lower, known.key) == (0.1, "m", 0, None)
    with pytest.raises(InputError, match="there is no parameter 'size'"):
        replace(Ball(), {"size": 1.0})
