"""Scenes: objects are drawn where the equations of the model place them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import (
    InputError,
    JointModel,
    MuscleModel,
    Run,
    joint_steps,
    predict,
    simulate,
    takeichi_20m,
)
from giajax.mechanics.arm import Contact, drag_force
from giajax.mechanics.joint import Joint, muscle_path
from giajax.mechanics.obstacles import Plane
from giajax.models import Line, Marker, Scene, arm_scene, capabilities, joint_scene, model_for
from giajax.simulation import contacts
from small_arm import small_run

ANGLES = np.deg2rad([-60.0, -30.0, -2.0, 2.0, 10.0, 45.0])


@pytest.mark.slow
def test_links_go_from_joint_to_joint():
    arm = takeichi_20m(2, joint_axes="pitch_yaw", length=[2.0, 1.0], diameter=[0.4, 0.2])
    motion = simulate(arm, joint_steps(2, {1: 0.0}), jnp.linspace(0.0, 1.0, 3))
    # Only the pose matters: joint 1 is at 30 deg upwards, joint 2 at 90 deg to the left.
    angles = jnp.broadcast_to(jnp.deg2rad(jnp.asarray([30.0, 90.0])), (3, 2))
    scene = arm_scene(dataclasses.replace(motion, angles=angles))
    assert [line.name for line in scene.lines] == ["link", "link"]
    elbow = np.array([2 * np.cos(np.pi / 6), 0.0, 1.0])
    end = elbow + np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(scene.lines[0].points[1], [np.zeros(3), elbow], atol=1e-12)
    np.testing.assert_allclose(scene.lines[1].points[1], [elbow, end], atol=1e-12)
    np.testing.assert_allclose(scene.markers["tip"][2], end, atol=1e-12)
    np.testing.assert_allclose(scene.markers["link01"][2], elbow / 2, atol=1e-12)
    assert [list(line.radii) for line in scene.lines] == [[0.2, 0.2], [0.1, 0.1]]
    low, high = scene.extent()
    np.testing.assert_allclose(low, [-0.2, -0.2, -0.2], atol=1e-12)
    np.testing.assert_allclose(high, [elbow[0] + 0.2, 1.1, 1.2], atol=1e-12)


def test_a_tracked_point_is_where_its_marker_is():
    arm = takeichi_20m(1, length=2.0)
    motion = simulate(arm, joint_steps(1, {1: 0.0}), jnp.linspace(0.0, 1.0, 2))
    marker = Marker(up=jnp.asarray(0.1), tip=jnp.asarray([0.05, 0.0, 0.0]))
    scene = arm_scene(motion, marker)
    np.testing.assert_allclose(scene.markers["link01"][0], [1.0, 0.0, 0.1], atol=1e-9)
    np.testing.assert_allclose(scene.markers["tip"][0], [2.05, 0.0, 0.0], atol=1e-9)
    # A command of zero is not a channel.
    assert list(scene.channels) == ["joint01_angle"]
    with pytest.raises(InputError, match="give all parts the same number of samples"):
        dataclasses.replace(scene, channels={"joint01_angle": np.zeros(3)})


@pytest.mark.slow
def test_markers_of_a_run_are_what_a_camera_records(tmp_path):
    run = small_run(tmp_path)
    model = model_for([run])
    scene = model.scene(run)
    assert scene.samples == len(run.times)
    recorded = predict(model, run)
    positions = {name: values for name, values in recorded.items() if name[-2:] in ("_x", "_z")}
    assert positions
    for name, values in positions.items():
        seen = scene.markers[name[:-2]][:, "xyz".index(name[-1])]
        np.testing.assert_allclose(seen, values, atol=1e-9)


def lengths(points):
    return np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)


def test_a_muscle_is_as_long_as_its_path():
    geometry = Joint().geometry
    scene = joint_scene(geometry, ANGLES)
    lines = {line.name: line for line in scene.lines}
    path = muscle_path(geometry, jnp.asarray(ANGLES))
    np.testing.assert_allclose(lengths(lines["muscle"].points), path.length, rtol=1e-12)
    # A wire with a large sag is drawn as an arc with a slightly smaller sag.
    drawn = lengths(lines["wire"].points)
    np.testing.assert_allclose(drawn[4:], 0.34, rtol=1e-12)
    np.testing.assert_allclose(drawn, 0.34, rtol=0.16)
    assert np.all(drawn <= 0.34 * (1 + 1e-12))
    assert list(lines["wire"].loose) == [True, True, True, True, False, False]
    np.testing.assert_allclose(lines["wire"].points[:, 0], scene.markers["B"])
    np.testing.assert_allclose(lines["wire"].points[:, -1], scene.markers["D"])
    # Points that exist on one side only: the outer muscle has no A, the inner one no M.
    there = {name: np.isfinite(points[:, 0]).tolist() for name, points in scene.markers.items()}
    assert there["A"] == there["H"] == [False] * 3 + [True] * 3
    assert there["M"] == there["P"] == [True] * 3 + [False] * 3
    assert all(there["E"])


def test_the_scene_of_a_joint_is_that_of_its_run():
    values = {"angle": np.abs(ANGLES), "side": np.repeat("inner", 6), "force": np.ones(6)}
    run = Run.from_arrays(None, values, definition={"model": "joint"})
    scene = JointModel(Joint()).scene(run)
    expected = joint_scene(Joint().geometry, np.abs(ANGLES))
    for ours, theirs in zip(scene.lines, expected.lines, strict=True):
        np.testing.assert_array_equal(ours.points, theirs.points)
    with pytest.raises(InputError, match="cannot be built"):
        joint_scene(Joint().geometry, [np.deg2rad(170.0)])


def test_what_has_no_shape_has_no_scene():
    values = {"contraction": np.linspace(0, 0.1, 3), "pressure": np.ones(3), "force": np.ones(3)}
    muscle = Run.from_arrays(None, values, definition={"model": "muscle"})
    assert capabilities.scene(MuscleModel(), muscle) is None
    turn = np.asarray([0.0, 1.0, -1.0, 0.0])
    loop = Run.from_arrays(
        None, {"input": turn, "output": turn}, definition={"model": "hysteresis"}
    )
    assert capabilities.scene(model_for([loop]), loop) is None


def test_parts_that_do_not_fit_together_are_refused():
    points = np.zeros((4, 2, 3))
    with pytest.raises(InputError, match="give one radius for each point"):
        Line("link", points, np.zeros(3))
    line = Line("link", points, np.zeros(2))
    with pytest.raises(InputError, match="give all parts the same number of samples"):
        Scene((line,), {"tip": np.zeros((3, 3))})


def test_muscles_lie_on_both_sides_of_their_joint():
    """The first muscle is on the side to which a positive angle bends, and is then shorter."""
    arm = takeichi_20m(2, muscles=[2], joint_axes="pitch_yaw", length=2.0, diameter=0.4)
    angles = jnp.asarray([[0.3, 0.0], [0.3, 0.5]])
    motion = simulate(arm, joint_steps(2, {}), jnp.asarray([0.0, 1e-3]))
    scene = arm_scene(dataclasses.replace(motion, angles=angles))
    first, second = (line for line in scene.lines if line.name == "muscle")
    joint = scene.lines[1].points[:, 0]
    for line, side in ((first, 1.0), (second, -1.0)):
        assert_allclose(np.linalg.norm(line.points[:, 1] - joint, axis=1), 0.2)
        assert_allclose(line.points[0, 1] - joint[0], [0.0, 0.2 * side, 0.0], atol=1e-12)
        # Its ends are on the skin of the links, a quarter of their length from the joint.
        for link, end in ((scene.lines[0], 0), (scene.lines[1], 2)):
            along = link.points[1, 1] - link.points[1, 0]
            place = (line.points[1, end] - link.points[1, 0]) @ along / 2.0
            assert_allclose(place, 1.5 if end == 0 else 0.5)
            off = line.points[1, end] - link.points[1, 0] - along * place / 2.0
            assert_allclose(np.linalg.norm(off), 0.2)

    def length(line, sample):
        return np.linalg.norm(np.diff(line.points[sample], axis=0), axis=1).sum()

    assert length(first, 1) < length(first, 0) == pytest.approx(1.0)
    assert length(second, 1) > 1.0
    assert_allclose(first.pressure, motion.pressures[:, 0, 1])


@pytest.mark.long
def test_forces_are_those_of_the_air_and_of_what_is_touched():
    ground = Plane(centre=[0.0, 0.0, -0.15])
    arm = takeichi_20m(2, length=1.0, diameter=0.4, contact=Contact(obstacles=(ground,)))
    wind = [0.0, 2.0, 0.0]
    motion = simulate(arm, joint_steps(2, {}), jnp.asarray([0.0, 1e-3]), wind=wind)
    scene = arm_scene(motion)
    air, contact = scene.arrows
    expected = drag_force(arm, jnp.zeros(2), jnp.zeros(2), jnp.asarray(wind))
    assert_allclose(air.vectors[0], expected, atol=1e-12)
    assert_allclose(air.origins[0], [[0.5, 0.0, 0.0], [1.5, 0.0, 0.0]], atol=1e-12)
    # Each link is indented by 5 cm, so the force is upwards.
    assert contact.vectors[0, :, 2].min() > 1.0
    assert_allclose(contact.vectors[0], contacts(motion).force[0, :, 0])
    (block,) = scene.blocks
    assert block.name == "ground"
    assert_allclose((block.centre + block.axes @ np.diag(block.size)[:, 2] / 2)[2], -0.15)
