"""User-defined arms with arbitrary axes and inertias, compared with rigid-body mechanics."""

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax.mechanics import arm as mechanics
from giajax.mechanics.arm import (
    PointMasses,
    bodies,
    six_points,
)
from giajax.models import arm_from_definition, arm_to_definition
from giajax.schema.parameters import default_free

kinetic_energy, mass_matrix, potential_energy = map(
    eqx.filter_jit,
    (mechanics.kinetic_energy, mechanics.mass_matrix, mechanics.potential_energy),
)
LINKS = 3
KNOWN = {"joints.pitch_stiffness": 2.0, "joints.yaw_stiffness": 3.0, "joints.damping": 0.1}
SIZES = {"length": [0.8, 0.5, 0.4], "diameter": 0.06, "mass": [0.3, 0.2, 0.1]}
ARM = {**SIZES, "joint_axes": ["pitch", "yaw", [1.0, 2.0, -1.0]], "parameters": KNOWN}


def tensors(seed=3):
    """Return rows of physical inertias, in which no moment exceeds the sum of the other two."""
    random = np.random.default_rng(seed)
    rows = []
    for _ in range(LINKS):
        spread = random.normal(size=(3, 3)) * [0.2, 0.05, 0.03]
        second = spread.T @ spread / 10
        tensor = np.trace(second) * np.eye(3) - second
        rows.append(tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    return np.array(rows)


CENTRES = np.array([0.3, 0.1, 0.25])
BALL = {"links": (1, 3), "mass": [0.05, 0.02], "position": [0.7, 0.4], "left": [0.1, 0.0]}
BALL |= {"up": [-0.2, 0.05]}


def own(**changes):
    balls = PointMasses(**BALL)
    inertia = {"inertia": tensors(), "centre_of_mass": CENTRES, "point_masses": balls}
    return giajax.chain(LINKS, **ARM | {"base_rotation": [0.3, -0.2, 0.5]} | inertia | changes)


def turn(vector):
    """Return the rotation matrix of a rotation vector (Rodrigues)."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def energies(angles, rates):
    """Return kinetic and potential energy from the velocities of each body, in NumPy."""
    axes = np.array([[0, -1, 0], [0, 0, 1], np.array([1, 2, -1]) / np.sqrt(6)])
    frame, joint = turn([0.3, -0.2, 0.5]), np.zeros(3)
    spin, velocity, kinetic, potential = np.zeros(3), np.zeros(3), 0.0, 0.0
    for link, (xx, yy, zz, xy, xz, yz) in enumerate(tensors()):
        spin = spin + frame @ axes[link] * rates[link]
        frame = frame @ turn(axes[link] * angles[link])
        points = [(SIZES["mass"][link], [CENTRES[link], 0, 0])]
        for which, m in enumerate(BALL["mass"]):
            if BALL["links"][which] == link + 1:
                points.append((m, [BALL[name][which] for name in ("position", "left", "up")]))
        for m, place in points:
            arm = frame @ place
            kinetic += m * np.sum((velocity + np.cross(spin, arm)) ** 2) / 2
            potential += m * 9.80665 * (joint + arm)[2]
        turning = frame.T @ spin
        kinetic += turning @ [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] @ turning / 2
        reach = frame @ [SIZES["length"][link], 0, 0]
        velocity, joint = velocity + np.cross(spin, reach), joint + reach
    return kinetic, potential


def test_energies_are_those_of_its_bodies():
    arm, random = own(), np.random.default_rng(0)
    still = jnp.zeros(LINKS)
    rest = energies(np.zeros(LINKS), np.zeros(LINKS))[1]
    for _ in range(3):
        angles, rates = random.normal(size=(2, LINKS))
        kinetic, potential = energies(angles, rates)
        assert_allclose(rates @ mass_matrix(arm, angles) @ rates / 2, kinetic, rtol=1e-7)
        state = jnp.asarray(angles), jnp.asarray(rates)
        assert_allclose(kinetic_energy(arm, *state), kinetic, rtol=1e-7)
        # With a command equal to the angles, springs store no energy.
        height = potential_energy(arm, state[0], state[0]) - potential_energy(arm, still, still)
        assert_allclose(height, potential - rest, rtol=1e-7)


def test_its_mass_matrix_is_that_of_mujoco():
    spec = mujoco.MjSpec()
    body, x = spec.worldbody, 0.0
    for link, row in enumerate(tensors()):
        body = body.add_body(pos=[x, 0, 0])
        body.mass, body.ipos, body.fullinertia = SIZES["mass"][link], [CENTRES[link], 0, 0], row
        body.explicitinertial = True
        body.add_joint(axis=[[0, -1, 0], [0, 0, 1], [1, 2, -1]][link])
        for which, m in enumerate(BALL["mass"]):
            if BALL["links"][which] == link + 1:
                place = [BALL[name][which] for name in ("position", "left", "up")]
                ball = body.add_body(pos=place)
                ball.mass, ball.inertia, ball.explicitinertial = m, [1e-12] * 3, True
                ball.ipos = np.zeros(3)
        x = SIZES["length"][link]
    model = spec.compile()
    data = mujoco.MjData(model)
    angles = np.array([0.4, -0.7, 1.1])
    data.qpos[:] = angles
    mujoco.mj_forward(model, data)
    full = np.zeros((LINKS, LINKS))
    for column, row in zip(np.eye(LINKS), full, strict=True):
        mujoco.mj_mulM(model, data, row, column)
    assert_allclose(mass_matrix(own(), angles), full, rtol=1e-6, atol=1e-9)


def test_a_round_link_stays_one_and_others_add_up():
    row = [1e-4, 5e-3, 5e-3, 0.0, 0.0, 0.0]
    arm = own(inertia=row, point_masses=None)
    assert arm.point_masses is None
    assert_allclose(arm.links.inertia_transverse, 5e-3)
    drag = PointMasses((2,), 0.1, 0.2, None, None, 0.01)
    arm = own(point_masses=drag)
    assert_allclose(bodies(arm).mass, [0.3, 0.3, 0.1], rtol=1e-12)
    assert float(arm.point_masses.drag_area.sum()) == 0.01


def test_files_state_it_as_python_does():
    section = {
        "preset": "chain",
        "link_length_m": SIZES["length"],
        "link_diameter_m": 0.06,
        "link_mass_kg": SIZES["mass"],
        "link_centre_of_mass_m": CENTRES,
        "link_inertia_kg_m2": tensors(),
        "joint_axes": ARM["joint_axes"],
        "base_rotation_deg": np.rad2deg([0.3, -0.2, 0.5]),
        "parameters": KNOWN,
    }
    columns = {"position": "position_m", "mass": "mass_kg", "left": "left_m", "up": "up_m"}
    section["point_masses"] = [
        {"link": link} | {key: BALL[name][i] for name, key in columns.items()}
        for i, link in enumerate(BALL["links"])
    ]
    # A sidecar written by giajax contains further inertias below it.
    section |= {"link_inertia_transverse_kg_m2": 1.0, "link_inertia_axial_kg_m2": 1.0}
    arm = arm_from_definition(giajax.Definition.parse({"arm": section}))
    assert eqx.tree_equal(arm, own(), rtol=1e-12, atol=1e-12)
    # The definition names no preset and contains everything that a fit does not estimate.
    again = arm_from_definition(giajax.Definition.parse({"arm": arm_to_definition(arm)}))
    values = {path: giajax.get(arm, path) for path in default_free(arm)}
    assert eqx.tree_equal(giajax.replace(again, values), arm, rtol=1e-12, atol=1e-12)
    # A definition written by giajax describes links by points. A given inertia replaces them, in a
    # definition that is merged above or below, and with user-defined masses.
    written = arm_to_definition(arm)
    assert sum(entry.get("structural", False) for entry in written["point_masses"]) == 18
    for merged in (section | written, written | {"link_inertia_kg_m2": tensors()}):
        again = arm_from_definition(giajax.Definition.parse({"arm": merged}))
        assert_allclose(bodies(again).mass, bodies(arm).mass, rtol=1e-12)
        assert_allclose(bodies(again).uneven, bodies(arm).uneven, rtol=1e-6, atol=1e-9)
    heavier = written | {"link_mass_kg": [0.4, 0.3, 0.2], "link_inertia_kg_m2": tensors()}
    again = arm_from_definition(giajax.Definition.parse({"arm": heavier}))
    assert_allclose(bodies(again).mass, bodies(arm).mass + 0.1, rtol=1e-12)
    del heavier["link_inertia_kg_m2"]
    with pytest.raises(giajax.InputError, match="gives link 1 a mass, but its structural"):
        arm_from_definition(giajax.Definition.parse({"arm": heavier}))
    with pytest.raises(giajax.InputError, match=r"unknown key arm\.parent"):
        giajax.Definition.parse({"arm": {"preset": "chain", "parent": [0, 1, 1]}})
    short = {"preset": "chain", "links": 3, "link_inertia_kg_m2": tensors()[:2]}
    with pytest.raises(giajax.InputError, match="has 2 values, but must have one for each link"):
        giajax.Definition.parse({"arm": short})


def test_sizes_among_the_parameters_are_sizes():
    paths = {f"links.{name}": value for name, value in SIZES.items()}
    options = {"joint_axes": ARM["joint_axes"], "parameters": {**KNOWN, **paths}}
    assert eqx.tree_equal(giajax.chain(LINKS, **options), giajax.chain(LINKS, **ARM))


def test_what_is_not_stated_is_neutral():
    known = {"joints.pitch_stiffness": 1.0, "joints.damping": 0.1}
    sizes = {"length": 0.5, "diameter": 0.1, "mass": 0.1, "joint_axes": ["pitch"] * 2}
    planar = giajax.chain(2, **sizes, parameters=known)
    assert (float(planar.gravity), float(planar.air.drag_coefficient)) == (9.80665, 1.0)
    assert (planar.joints.friction, planar.joints.armature, planar.air.wind) == (None,) * 3
    free = ("joints.pitch_stiffness", "joints.damping", "air.drag_coefficient")
    assert default_free(planar) == free  # without yaw joints, there is no yaw stiffness


@pytest.mark.parametrize(
    ("left_out", "named"),
    [
        ("length", r"lacks links\.length \(link_length_m\): give"),
        ("diameter", r"lacks links\.diameter \(link_diameter_m\): give"),
        ("mass", r"lacks links\.mass \(link_mass_kg\): give"),
        ("joint_axes", "lacks joint_axes: give"),
        ("joints.pitch_stiffness", r"this arm lacks joints\.pitch_stiffness: give"),
        ("joints.yaw_stiffness", r"this arm lacks joints\.yaw_stiffness: give"),
        ("joints.damping", r"this arm lacks joints\.damping: give"),
    ],
)
def test_what_has_no_neutral_value_must_be_stated(left_out, named):
    known = {path: value for path, value in KNOWN.items() if path != left_out}
    options = {name: value for name, value in ARM.items() if name != left_out}
    with pytest.raises(giajax.InputError, match=named):
        giajax.chain(LINKS, **options | {"parameters": known})
    with pytest.raises(giajax.InputError, match="the number of links of this arm is unknown"):
        giajax.mechanics.arm.preset("chain")


@pytest.mark.parametrize(
    ("row", "error"),
    [
        ([1.0, 1.0, 3.0, 0, 0, 0], "no rigid body can have the inertia of link 1"),
        ([-1.0, 1.0, 1.0, 0, 0, 0], "no rigid body can have the inertia of link 1"),
        ([0.0] * 6, "no rigid body can have the inertia of link 1"),
        ([1.0, 1.0, 1.0], "six finite numbers"),
        ([np.nan] * 6, "six finite numbers"),
    ],
)
def test_an_inertia_that_no_body_has_is_refused(row, error):
    with pytest.raises(giajax.InputError, match=error):
        own(inertia=row)
    with pytest.raises(giajax.InputError, match="omit these two"):
        own(inertia_axial=1e-4)


def test_six_points_have_the_centre_and_the_inertia():
    place, tensor = np.array([0.2, 0.03, -0.04]), np.diag([1e-3, 5e-3, 5.5e-3])
    tensor[0, 1] = tensor[1, 0] = 4e-4
    mass, axial, transverse, points = six_points(np.array([0.5]), place[None], tensor[None])
    assert points.links == (1,) * 6
    each = np.stack([points.position, points.left, points.up], axis=1)
    assert_allclose(np.sum(points.mass) + mass[0], 0.5)
    assert_allclose(np.asarray(points.mass) @ each / np.sum(points.mass), place)
    away = each - place
    square = np.einsum("p,pi,pj->ij", points.mass, away, away)
    assert_allclose(np.trace(square) * np.eye(3) - square, tensor, rtol=1e-7, atol=1e-11)
    assert max(*axial, *transverse) < 1e-10
