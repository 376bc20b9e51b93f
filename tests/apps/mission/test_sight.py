"""The operator's estimate from pictures, compared with the truth, and without pictures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax import InputError
from giajax.apps.mission import Operator, Picture, Scene, Tracking, opening_of, posed
from giajax.mechanics.arm import Contact
from giajax.mechanics.obstacles import Box, WallWithOpening
from giajax.models import Pinhole, View

WALL = WallWithOpening(
    centre=[14.0, 0.0, 7.4], opening=[2.0, 1.0], thickness=0.2, rotation=[0.1, -1.4, 0.2]
)
CAMERA = Pinhole(
    position=[0.0, 0.0, 0.0],
    rotation=[0.0, 0.0, 0.0],
    focal_length=200.0,
    centre=[319.5, 239.5],
    distortion=[0.05, -0.01, 0.001, 0.0, 0.0],
    mount="tip",
    size=(640, 480),
)


def arm_before(*obstacles):
    return giajax.takeichi_20m(2, contact=Contact(obstacles=obstacles))


OPENING = opening_of(arm_before(WALL))


def looking(place, aim, roll=0.0):
    """Return a view between two places in the frame of the opening, rolled about its axis."""
    here, there = (
        np.asarray(OPENING.centre) + np.asarray(OPENING.frame) @ np.asarray(each, float)
        for each in (place, aim)
    )
    ahead = (there - here) / np.linalg.norm(there - here)
    right = np.cross(ahead, [0.3, 0.1, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    right, down = (
        np.cos(roll) * right + np.sin(roll) * down,
        np.cos(roll) * down - np.sin(roll) * right,
    )
    return View(jnp.asarray(here), jnp.asarray(np.stack([right, down, ahead], axis=1)))


def test_an_opening_is_where_its_wall_is():
    corners = np.asarray(OPENING.local(OPENING.corners))
    assert_allclose(np.abs(corners[:, 1:]), [[1.0, 0.5]] * 4, atol=1e-12)
    assert_allclose(corners[:, 0], 0, atol=1e-12)
    # The outer face is half a thickness from the centre, in the direction of the wall's x axis.
    assert_allclose(np.linalg.norm(np.asarray(OPENING.centre) - [14.0, 0.0, 7.4]), 0.1)
    assert_allclose(OPENING.beside(jnp.asarray([5.0, 1.3, -0.9])), 0.5, rtol=1e-12)
    assert_allclose(OPENING.beside(jnp.asarray([5.0, 0.9, -0.4])), 0.0)


def test_four_corners_are_a_pose():
    """Exact to rounding from any viewpoint, with a lens that distorts."""
    random = np.random.default_rng(0)
    seen = 0

    @jax.jit
    def there_and_back(view):
        found = CAMERA.project_from(view, OPENING.corners)
        return CAMERA.sees(found), posed(CAMERA, OPENING, found.pixels)

    for _ in range(40):
        place = random.uniform([0.8, -4, -4], [9, 4, 4])
        view = looking(place, random.uniform(-0.5, 0.5, 3), random.uniform(-3, 3))
        sees, back = there_and_back(view)
        if not np.all(sees):
            continue
        seen += 1
        assert_allclose(back.centre, view.centre, atol=1e-6)
        assert_allclose(back.axes, view.axes, atol=1e-6)
    assert seen > 15


@eqx.filter_jit
def along(tracking, first, interval, views, errors, shown):
    """Return the last estimate and all estimates; one program for all paths of the same length."""

    def step(sight, given):
        view, error = given
        found = CAMERA.project_from(view, OPENING.corners)
        seen = CAMERA.sees(found) & (jnp.arange(4) < shown)
        sight = tracking.later(sight, interval)
        sight = tracking.corrected(
            sight, CAMERA, OPENING, found.pixels + error, seen, first, interval
        )
        return sight, (sight.view.centre, jnp.sqrt(jnp.diag(sight.covariance)[:3]))

    return jax.lax.scan(step, tracking.start(first), (views, errors))


def followed(tracking, first, interval, path, rng, shown=4):
    """Return the errors of the estimates along a path of views, and their standard deviations."""
    views = View(*(jnp.asarray(np.stack(each)) for each in zip(*path, strict=True)))
    errors = jnp.asarray(rng.normal(size=(len(path), 4, 2)))
    sight, (centres, sure) = along(tracking, first, interval, views, errors, jnp.asarray(shown))
    return np.asarray(centres - views.centre), np.asarray(sure), sight


def test_a_camera_is_followed_from_a_wrong_belief():
    """The moving camera is 6 m away; the initial estimate is off by 4 m and 30 deg; noise 1 px."""
    rng, interval = np.random.default_rng(1), jnp.asarray(0.1)
    times = 0.1 * np.arange(150)
    places = np.stack([5 - 0.15 * times, 1.5 + 0.1 * times, -2 + 0.1 * times], axis=1)
    path = [looking(place, [0, 0, 0]) for place in places]
    commanded = looking(places[0] + [2.0, -3.0, 1.5], [0.0, 2.0, 1.0], 0.3)
    gaps, sure, sight = followed(Tracking(pixel=1.0), commanded, interval, path, rng)
    assert np.abs(gaps[60:]).max() < 0.3
    pulls = gaps[60:] / sure[60:]
    # The filter assumes that the camera does not turn systematically, so it is slightly
    # overconfident.
    assert 0.3 < np.sqrt(np.mean(pulls**2)) < 3.0
    speed = np.asarray(OPENING.frame) @ [-0.15, 0.1, 0.1]
    # The assumed velocity decays without pictures, so the estimate lags behind.
    assert_allclose(sight.velocity, speed, atol=0.1)
    ahead = np.asarray(sight.view.axes).T @ np.asarray(path[-1].axes)
    assert_allclose(ahead, np.eye(3), atol=0.03)


def test_two_corners_go_on_where_four_began():
    rng, interval = np.random.default_rng(2), jnp.asarray(0.1)
    path = [looking([2.0, 0.2, 0.1], [0, 0, 0])] * 150
    tracking = Tracking(pixel=1.0)
    _gaps, sure, sight = followed(tracking, path[0], interval, path, rng)
    on = followed(tracking, path[0], interval, path, rng, shown=2)
    assert np.abs(on[0][-1]).max() < 0.5
    # Fewer corners give larger errors, and no corner makes the estimate drift.
    assert np.all(on[1][-1] > sure[-1])
    later = eqx.filter_jit(tracking.later)
    for _ in range(50):
        sight = later(sight, interval)
    assert np.all(np.sqrt(np.diag(np.asarray(sight.covariance)[:3, :3])) > 2 * sure[-1])
    assert np.all(np.abs(np.asarray(sight.velocity)) < 0.05)


def test_a_camera_beside_the_tip_is_not_the_tip():
    """The tip must pass the opening, so the commands are those for a camera at the tip."""
    arm, angles = giajax.takeichi_20m(), jnp.linspace(-0.3, 0.2, 20)
    operator = Operator(approach=jnp.zeros(20))

    @eqx.filter_jit
    def commanded(operator, camera, arm, angles):
        # The estimate is where the commands place the camera, and there is no picture yet.
        scene = Scene(arm, camera, OPENING, jnp.asarray(0.1))
        memory = operator.start(scene, 0)._replace(
            sight=operator.tracking.start(camera.view(arm, angles)), blind=jnp.asarray(0.0)
        )
        nothing = Picture(jnp.zeros((4, 2)), jnp.zeros(4, bool), jnp.asarray(False), angles)
        return operator.decide(scene, memory, nothing, angles)[1]

    wanted = []
    for position in ([0.0, 0.0, 0.0], [-0.4, 0.1, 0.3]):
        camera = Pinhole(
            position=position, rotation=[0.1, 0.3, -0.2], focal_length=200.0,
            centre=[319.5, 239.5], mount="tip", size=(640, 480),
        )  # fmt: skip
        wanted.append(commanded(operator, camera, arm, angles))
    assert np.abs(wanted[0] - angles).max() > 1e-3
    assert_allclose(wanted[1], wanted[0], atol=1e-12)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("obstacles", "name", "sentence"),
    [
        ((Box(),), None, "the arm has no opening to enter: add a wall"),
        (
            (WALL, WallWithOpening(name="other")),
            None,
            r"several walls have an opening \(wall, other\): name one",
        ),
        ((WALL,), "door", "'door' is not a wall with an opening: use one of wall"),
    ],
)
def test_a_mission_without_its_opening_is_refused(obstacles, name, sentence):
    with pytest.raises(InputError, match=sentence):
        opening_of(arm_before(*obstacles), name)
