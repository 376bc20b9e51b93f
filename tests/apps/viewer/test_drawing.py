"""Drawing: shapes, rotations, samples on a common clock, and clipping."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.apps.viewer import (
    SPEEDS,
    Player,
    Show,
    ball,
    brick,
    cut,
    ends,
    factor,
    frames,
    scale_of,
    segments,
    span,
    thread_colours,
    tube,
    turns_to,
    words,
)
from giajax.models import Arrows, Block, Line, Scene

pytestmark = pytest.mark.quick


def moving(times=(0.0, 0.5, 1.0)):
    """Return a link that rises, with a marker at its end and a thread beside it."""
    count = len(times)
    heights = np.arange(count, dtype=float)
    points = np.zeros((count, 2, 3))
    points[:, 1, 0], points[:, 1, 2] = 2.0, heights
    thread = points + np.array([0.0, 0.3, 0.0])
    lines = (
        Line("link", points, np.array([0.2, 0.2])),
        Line("muscle", thread, np.zeros(2), pressure=1e5 * heights),
    )
    drag = Arrows("air", "N", points[:, 1:], -heights[:, None, None] * np.eye(3)[2])
    return Scene(lines, {"tip": points[:, 1]}, np.array(times), (drag,))


@pytest.mark.parametrize(("shape", "volume"), [(tube, np.pi), (ball, 4 / 3 * np.pi), (brick, 1.0)])
def test_meshes_are_closed_and_look_outwards(shape, volume):
    """Check the volume by the divergence theorem; a faceted body has slightly less."""
    mesh = shape()
    corners = mesh.vertices[mesh.faces]
    found = np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6
    assert 0.92 * volume < found <= volume * (1 + 1e-12)


def test_turns_take_x_to_a_direction():
    random = np.random.default_rng(0)
    directions = np.concatenate([random.normal(size=(20, 3)), np.eye(3), -np.eye(3)])
    w, vector = turns_to(directions)[:, 0], turns_to(directions)[:, 1:]
    x = np.array([1.0, 0.0, 0.0])
    turned = x + 2 * np.cross(vector, np.cross(vector, x) + w[:, None] * x)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert_allclose(turned, unit, atol=1e-12)
    assert_allclose(turns_to(np.zeros((1, 3))), [[1.0, 0.0, 0.0, 0.0]])


def test_a_show_has_the_sample_of_a_time():
    show = Show("a", moving([0.0, 0.5, 2.0]))
    times = (-1.0, 0.0, 0.49, 0.5, 1.9, 2.0, 9.0)
    assert list(map(show.sample_at, times)) == [0, 0, 0, 1, 1, 2, 2]
    other = Show("b", moving([1.0, 2.0, 3.0]))
    assert span([show, other]) == (0.0, 3.0)
    assert_allclose(Show("c", dataclasses.replace(moving(), times=None)).clock, [0.0, 0.1, 0.2])


def test_frames_are_samples_and_no_more_than_are_seen():
    show = Show("a", moving(np.arange(5) * 0.1))
    assert_allclose(frames([show], 30.0, 100), show.clock)
    fast = Show("b", moving(np.arange(1001) * 0.001))
    assert_allclose(frames([fast], 30.0, 100), np.linspace(0.0, 1.0, 31))
    assert len(frames([fast], 30.0, 10)) == 10
    assert_allclose(frames([Show("c", moving([4.0]))], 30.0, 10), [4.0])


def test_recorded_markers_have_the_samples_of_their_scene():
    with pytest.raises(
        InputError, match="the recorded marker 'tip' has 2 samples, but the scene has 3"
    ):
        Show("a", moving(), {"tip": np.zeros((2, 3))})
    with pytest.raises(InputError, match="give one origin for each vector"):
        Arrows("air", "N", np.zeros((3, 2, 3)), np.zeros((3, 1, 3)))


def test_words_say_what_is_seen():
    scene = moving()
    recorded = {"tip": scene.markers["tip"] + [0.0, 3e-3, 4e-3]}
    said = words(Show("run", scene, recorded, ("a note",)), 2, "blue")
    assert said.splitlines() == [
        "**run** (blue)  ",
        "time 1.00 s  ",
        "tip at 2.000, 0.000, 2.000 m  ",
        "RMS distance to the recorded markers 5.0 mm  ",
        "largest drag on a link 2 N  ",
        "highest muscle pressure 2.00 bar  ",
        "*a note*",
    ]
    nothing = {"tip": np.full((3, 3), np.nan)}
    assert "recorded" not in words(Show("run", scene, nothing), 2, "blue")


def test_the_name_of_a_run_is_no_markup():
    said = words(Show("a](http://b) <img src=x>\n# run_1", moving(), {}), 2, "blue")
    shown = r"**a\]\(http\:\/\/b\) \<img src\=x\> \# run\_1** (blue)"
    assert said.splitlines()[0].strip() == shown


def test_scales_and_pieces_are_those_of_the_scene():
    show = Show("a", moving())
    scale = scale_of([show])
    assert scale.force == 2.0
    assert scale.pressure == 2e5
    assert_allclose(scale.extent, 2.4, atol=1e-12)
    starts, tips, radii = segments(show.scene, 1, bodies=True)
    assert_allclose(np.concatenate([starts, tips]), [[0, 0, 0], [2, 0, 1]])
    assert_allclose(radii, [0.2])
    empty, half, full = (thread_colours(show.scene, k, 2e5)[0].astype(float) for k in range(3))
    assert full[0] > half[0] > empty[0]
    assert full[2] < half[2] < empty[2]


def test_ground_is_cut_to_what_is_near():
    """The surface of the ground stays where it is; a finite box is not changed."""
    low, high = np.array([0.0, -0.2, -0.2]), np.array([20.0, 0.2, 3.0])
    tilt = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    for axes in (np.eye(3), tilt):
        surface = np.array([0.0, 0.0, -1.0])
        centre = surface - 200.0 * axes[:, 2]
        middle, size = cut(centre, np.full(3, 400.0), axes, low, high)
        top = middle + axes[:, 2] * size[2] / 2
        assert_allclose((top - surface) @ axes[:, 2], 0.0, atol=1e-9)
        assert size[2] < 1.0 < size[0] < 60.0
    wall = Block("wall", np.array([30.0, 0.0, 0.0]), np.array([0.2, 4.0, 4.0]), np.eye(3))
    middle, size = cut(wall.centre, wall.size, wall.axes, low, high)
    assert_allclose(middle, wall.centre)
    assert_allclose(size, wall.size)
    assert_allclose(ends(wall, 20.0), [[29.9, -2, -2], [30.1, 2, 2]])
    assert ends(Block("ground", centre, np.full(3, 400.0), np.eye(3)), 20.0) is None


def test_a_player_runs_to_its_end_and_again():
    player = Player(1.0, 3.0, again=False)
    assert not player.tick(0.5)
    player.play()
    player.speed = 2.0
    assert player.tick(0.5)
    assert player.time == 2.0
    player.tick(9.0)
    assert (player.time, player.playing) == (3.0, False)
    player.play()
    assert player.time == 1.0
    player.again = True
    player.tick(9.0)
    assert (player.time, player.playing) == (3.0, True)
    player.tick(0.1)
    assert player.time == 1.0
    player.seek(99.0)
    assert player.time == 3.0
    assert [factor(speed) for speed in SPEEDS] == [0.25, 0.5, 1, 2, 4, 8, 16]
