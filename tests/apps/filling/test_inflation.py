"""The inflation state: declared once, computed by a filling, and used by an arm."""

import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax import InputError, fill, replace, schema, takeichi_20m
from giajax.apps.filling import inflation_toml
from giajax.mechanics.arm import Contact, net_lift
from giajax.mechanics.inflation import Filling, bending_stiffness
from giajax.mechanics.obstacles import Plane
from giajax.models import arm_from_definition, parameter_values
from giajax.recordings import Definition
from giajax.schema.parameters import declared, get

AROUND = Contact(obstacles=(Plane(centre=[0.0, 0.0, -0.5]),))


def definition(tmp_path, text):
    path = tmp_path / "arm.toml"
    path.write_text(text)
    return Definition.load(path)


def test_one_declaration_is_the_pressure_of_links():
    """Check all declared quantities, and all parameters of an arm and its filling."""
    groups = [group for group in vars(schema).values() if isinstance(group, schema.Group)]
    everything = {each.path: each for group in groups for each in group}
    made = Filling(arm=takeichi_20m(2, contact=AROUND, muscles="all", buoyancy=True))
    everything |= {path: each.declaration for path, each in declared(made).items()}
    pressures = {path for path, each in everything.items() if each.unit == "Pa"}
    assert {path for path in pressures if everything[path].per == "link"} == {"links.pressure"}
    # The others belong to muscles, the room and the supply of the first bag.
    # A single joint has no links; the default pressure of its neck is that of links.
    assert everything["neck.pressure"].default == everything["links.pressure"].default
    assert "neck.pressure" not in declared(made)
    whole = pressures - {"links.pressure", "neck.pressure"}
    assert len(whole) > 3
    assert {path.partition(".")[0] for path in whole} <= {"gas", "supply", "muscle", "friction"}


def test_it_is_what_contact_stiffness_and_the_force_on_the_ends_follow_from():
    arm, skin = takeichi_20m(3, contact=AROUND), Filling().skin
    pressure = np.array([25.0, 500.0, 2000.0])
    stated = replace(arm, {"links.pressure": pressure})
    line = stated.contact.line(stated.links)
    np.testing.assert_allclose(line, np.pi * pressure, rtol=1e-15)
    np.testing.assert_allclose(stated.links.end_force, pressure * np.pi * 0.15**2, rtol=1e-14)
    stiffness = bending_stiffness(stated, skin)
    full = 1e4 * np.pi * 0.15**3
    assert 0 < stiffness[0] < full
    np.testing.assert_allclose(stiffness[1:], full, rtol=1e-12)
    np.testing.assert_allclose(bending_stiffness(arm, skin, pressure), stiffness)
    # The default is unchanged: 1 kPa in every link.
    np.testing.assert_allclose(arm.contact.line(arm.links), 1000 * np.pi)


def test_an_arm_takes_the_state_that_filling_ends_in():
    """Its lift equals that of the filling, apart from compressed helium of at most 0.1 g."""
    filled = fill(Filling(arm=takeichi_20m(3, buoyancy=True, gravity=9.81)))
    arm = replace(filled.filling.arm, filled.inflation)
    np.testing.assert_array_equal(arm.links.pressure, filled.pressure[-1])
    np.testing.assert_allclose(arm.links.fullness, filled.fullness[-1], rtol=1e-15)
    pressed = filled.gas[-1] * filled.pressure[-1] / (101325.0 + filled.pressure[-1])
    np.testing.assert_allclose(net_lift(arm), filled.net_lift[-1] + pressed, rtol=1e-9)
    assert pressed.max() < 1e-4
    np.testing.assert_allclose(bending_stiffness(arm, Filling().skin), filled.stiffness[-1])
    # The stretched skin displaces more air than the skin of the arm as it is cut.
    assert net_lift(arm)[0] - net_lift(filled.filling.arm)[0] > 1e-4


def test_its_file_is_a_definition_of_the_same_arm(tmp_path):
    own = takeichi_20m(3, muscles="pitch", parameters={"joints.damping": 0.2})
    filled = fill(Filling(arm=own))
    read = arm_from_definition(definition(tmp_path, inflation_toml(filled)))
    expected = parameter_values(replace(own, filled.inflation))
    found = parameter_values(read)
    assert found.keys() == expected.keys()
    for path, value in expected.items():
        np.testing.assert_allclose(found[path], value, rtol=1e-12, err_msg=path)


def test_an_arm_that_was_not_filled_is_one_too(tmp_path):
    """Bags without gas have zero pressure, and the file is accepted."""
    filled = fill(Filling(arm=takeichi_20m(3)), limit=60.0)
    assert not filled.finished
    arm = arm_from_definition(definition(tmp_path, inflation_toml(filled)))
    np.testing.assert_allclose(arm.links.pressure[2], 0, atol=1e-9)
    np.testing.assert_allclose(arm.links.fullness[2], 0, atol=1e-9)


def test_links_that_one_muscle_would_fold_are_counted():
    """Compare the force of the muscle at 300 kPa with p pi r^2 by hand."""
    weak = fill(Filling(arm=takeichi_20m(3)))
    angle = np.deg2rad(18)
    ideal = np.pi / 4 * 3.5e-3**2 * (3 / np.tan(angle) ** 2 - 1 / np.sin(angle) ** 2)
    pull = (300e3 - 10e3) * ideal
    carried = weak.pressure[-1] * np.pi * 0.15**2
    assert carried.max() < pull
    assert weak.collapse.startswith(f"3 of 3 links withstand less than the {pull:.1f} N")
    assert f"p pi r^2 of link 3 is {carried[2]:.1f} N" in weak.collapse
    # Gas that is in the bags initially makes them tight, so a weaker muscle folds no link.
    assert fill(Filling(arm=takeichi_20m(3)), share=1.1).collapse is None
    gentle = takeichi_20m(3, muscles="all", parameters={"muscle.pressure_limit": 11e3})
    assert fill(Filling(arm=gentle)).collapse is None


def test_files_and_paths_of_earlier_versions_are_read(tmp_path):
    obstacles = (
        '[[arm.obstacles]]\nshape = "plane"\nname = "ground"\n'
        "centre_m = [0.0, 0.0, -0.5]\nnormal = [0.0, 0.0, 1.0]\n"
    )
    for stated in (
        "[arm]\nlinks = 2\ncontact_pressure_kPa = 0.5\n",
        '[arm]\nlinks = 2\n[arm.parameters]\n"contact.pressure" = 500.0\n',
        "[arm]\nlinks = 2\n[arm.parameters.contact]\npressure = 500.0\n",
    ):
        arm = arm_from_definition(definition(tmp_path, stated + obstacles))
        np.testing.assert_allclose(arm.contact.line(arm.links), 500 * np.pi)
    changed = replace(arm, {"contact.pressure": jnp.array([100.0, 200.0])})
    assert float(get(changed, "contact.pressure[1]")) == 200.0
    assert "contact.pressure" not in declared(changed)
    both = '[arm.parameters]\n"contact.pressure" = 500.0\n"links.pressure" = 300.0\n'
    with pytest.raises(InputError, match=r"gives links\.pressure twice"):
        definition(tmp_path, both)
    twice = "[arm]\nlinks = 2\ncontact_pressure_kPa = 0.5\nlink_pressure_kPa = 0.5\n"
    with pytest.raises(InputError, match="gives link_pressure_kPa twice"):
        definition(tmp_path, twice)


def test_a_pressure_is_not_negative(tmp_path):
    with pytest.raises(InputError, match=r"link_pressure_kPa = -0\.5 must be zero or a positive"):
        definition(tmp_path, "[arm]\nlinks = 2\nlink_pressure_kPa = -0.5\n")
    with pytest.raises(InputError, match="link_pressure_kPa has 2 values, but must have one for"):
        definition(tmp_path, "[arm]\nlinks = 3\nlink_pressure_kPa = [0.5, 0.5]\n")


def test_a_pressure_of_each_link_travels(tmp_path):
    stated = "[arm]\nlinks = 2\nlink_pressure_kPa = [0.5, 0.02]\n"
    arm = arm_from_definition(definition(tmp_path, stated))
    again = giajax.models.arm_to_definition(arm)
    assert again["link_pressure_kPa"] == [0.5, 0.02]
