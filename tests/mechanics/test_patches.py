"""Parts of lines near boxes: compared with a fine search, and boxes with shared faces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics import obstacles
from giajax.mechanics.obstacles import Box, Lines, Plane, WallWithOpening, owners, solids

nearest, patches = jax.jit(obstacles.nearest), jax.jit(obstacles.patches)


OBSTACLES = [
    Box(centre=[1.0, 0.0, 0.0], size=[1.0, 2.0, 0.5], rotation=[0.1, 0.2, 0.3]),
    Plane(centre=[0.0, 0.0, -1.0], normal=[0.1, 0.0, 1.0]),
    WallWithOpening(centre=[3.0, 0.0, 0.0], thickness=0.3),
]
RADIUS = 0.15


def lines(start, direction, length):
    """Pair each line with each box: rows of lines, then of boxes."""
    boxes = solids(OBSTACLES)
    frame, centre = np.asarray(boxes.frame), np.asarray(boxes.centre)
    shape = (len(start), centre.shape[1])
    local = np.einsum("xkb,xlb->klb", frame, start.T[:, :, None] - centre[:, None])
    along = np.einsum("xkb,xl->klb", frame, direction.T)

    def flat(value, *rows):
        return jnp.asarray(np.broadcast_to(value, (*rows, *shape)).reshape(*rows, -1), float)

    return Lines(
        flat(local, 3),
        flat(along, 3),
        flat(length[:, None]),
        flat(RADIUS),
        flat(np.asarray(boxes.half)[:, None], 3),
        flat(boxes.shared[:, :, None], 2, 3),
    )


def random_lines(count):
    random = np.random.default_rng(0)
    start = random.uniform([-1, -2, -2], [5, 2, 2], (count, 3))
    direction = random.normal(size=(count, 3))
    # Some lines are along axes, parallel to faces.
    direction[: count // 4] = np.eye(3)[random.integers(0, 3, count // 4)]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return lines(start, direction, random.uniform(0.5, 2.0, count))


def test_stretches_are_those_of_a_fine_search():
    some, steps = random_lines(150), 4001
    found = patches(some)
    place = np.linspace(0, 1, steps) * np.asarray(some.length)[:, None]
    x = np.asarray(some.start)[..., None] + np.asarray(some.direction)[..., None] * place
    half, shared = np.asarray(some.half)[..., None], np.asarray(some.shared)[..., None] > 0
    outside = np.maximum(np.abs(x) - half, 0)
    near = (np.linalg.norm(outside, axis=0) < RADIUS) & ~np.any(shared[0] & (x < -half), axis=0)
    near &= ~np.any(shared[1] & (x > half), axis=0)
    step = np.asarray(some.length) / (steps - 1)
    some_touch = near.any(axis=1)
    assert 80 < some_touch.sum() < near.shape[0] / 2
    begin, end = (np.asarray(found.knots[k]) for k in (0, -1))
    width = end - begin
    assert np.all(width[~some_touch] <= step[~some_touch])
    assert np.all(np.asarray(found.touching)[some_touch])
    assert np.all(np.diff(found.knots, axis=0) >= 0)
    first = place[np.arange(len(near)), near.argmax(axis=1)]
    last = place[np.arange(len(near)), steps - 1 - near[:, ::-1].argmax(axis=1)]
    assert np.all(np.abs(first - begin)[some_touch] <= step[some_touch])
    assert np.all(np.abs(last - end)[some_touch] <= step[some_touch])


def test_the_nearest_point_is_on_the_surface_along_the_normal():
    random = np.random.default_rng(1)
    half = np.asarray([[0.5], [1.0], [0.25]])
    x = random.uniform(-1.5, 1.5, (3, 500))
    seen = jax.tree.map(np.asarray, nearest(x, half, np.zeros((2, 3, 1))))
    assert_allclose(np.sum(seen.normal**2, axis=0), 1, rtol=1e-14)
    surface = x - seen.distance[None] * seen.normal
    assert_allclose(np.max(np.abs(surface) - half, axis=0), 0, atol=1e-14)
    # No point of the surface is nearer.
    clipped = np.clip(x, -half, half)
    outside = seen.distance > 0
    gap = np.linalg.norm(x - clipped, axis=0)
    assert_allclose(seen.distance[outside], gap[outside], rtol=1e-14)
    inside = ~outside
    assert 20 < inside.sum() < 450
    depth = np.min(half - np.abs(x), axis=0)
    assert_allclose(-seen.distance[inside], depth[inside], rtol=1e-13)


def test_inside_a_shared_face_is_no_way_out():
    half, shared = np.asarray([[0.5], [1.0], [1.0]]), np.zeros((2, 3, 1))
    shared[1, 0, 0] = 1
    seen = nearest(np.asarray([[0.49], [0.3], [0.0]]), half, shared)
    assert_allclose(seen.normal[:, 0], [0, 1, 0])
    assert_allclose(seen.distance, [-0.7])
    # The distance does not jump on a path through the middle, to the face that is not shared.
    across = np.stack([np.linspace(-0.49, 0.49, 99), np.zeros(99), np.zeros(99)])
    seen = nearest(across, half, shared)
    assert_allclose(seen.distance, np.maximum(-across[0] - 0.5, -1.0), atol=1e-14)


def test_a_plane_stands_as_its_normal_does():
    for normal in ([0.0, 0.0, 1.0], [0.0, 0.0, -2.0], [3.0, 0.0, 0.0], [0.3, -0.4, -0.6]):
        boxes = solids([Plane(centre=[1.0, 2.0, 3.0], normal=normal)])
        unit = np.asarray(normal) / np.linalg.norm(normal)
        frame = np.asarray(boxes.frame[:, :, 0])
        assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
        assert_allclose(frame[:, 2], unit, atol=1e-15)
        top = np.asarray(boxes.centre[:, 0]) + np.asarray(boxes.half[2, 0]) * unit
        assert_allclose(unit @ (top - np.array([1.0, 2.0, 3.0])), 0, atol=1e-12)


def test_the_boxes_of_a_wall_fill_it_but_for_the_opening():
    wall = WallWithOpening(opening=[2.0, 1.0], margins=[0.5, 1.0, 1.5, 2.0], thickness=0.4)
    boxes = solids([wall])
    volume = float(jnp.sum(8 * jnp.prod(boxes.half, axis=0)))
    assert_allclose(volume, 0.4 * ((0.5 + 2 + 1.5) * (1 + 1 + 2) - 2.0 * 1.0), rtol=1e-14)
    # A face is shared exactly where another box starts.
    for box in range(8):
        for side, sign in enumerate((-1, 1)):
            for k in range(3):
                beside = np.asarray(boxes.centre[:, box]).copy()
                beside[k] += sign * (float(boxes.half[k, box]) + 1e-6)
                inside = np.all(np.abs(beside[:, None] - boxes.centre) < boxes.half, axis=0)
                assert inside.any() == boxes.shared[side, k, box]
    assert list(owners([Plane(), wall])) == [0] + [1] * 8


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (
            lambda: Box(size=[1.0, 0.0, 1.0]),
            "'box' has a size that is not positive: give three positive sizes",
        ),
        (
            lambda: Plane(normal=[0.0, 0.0, 0.0]),
            "'ground' has a normal of zero: give a vector other than zero",
        ),
        (lambda: WallWithOpening(margins=[1.0, 1.0, 0.0, 1.0]), "give positive sizes"),
    ],
)
def test_what_is_no_obstacle_is_refused(build, sentence):
    with pytest.raises(InputError, match=sentence):
        build()
