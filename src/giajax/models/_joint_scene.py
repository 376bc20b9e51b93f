"""The scene of a joint at rest: balloons, muscle, wire and the lettered points of figs 7 and 8."""

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from .._typing import Array, Bool, Float
from ..joint import JointGeometry, check_geometry, muscle_path
from ._scene import Line, Scene

# How far a balloon is drawn from the joint's centre, m: half of one link and more.
_REACH = 1.0

# Points of each half of the wire: enough for a bow.
_WIRE_POINTS = 40

Points = Float[np.ndarray, "sample 2"]


def joint_scene(
    geometry: JointGeometry,
    angles: npt.ArrayLike,
    inner: npt.ArrayLike | None = None,
    *,
    times: Float[np.ndarray, " sample"] | None = None,
) -> Scene:
    """What is seen of one joint and one of its muscles, which is on the side of +y.

    The plane is that of the bisector: the joint's centre E is the origin, x goes to the right
    link, and all z are 0.

    Arguments:
        geometry: of the joint.
        angles: bending angles of the muscle, rad, shape (sample,).
        inner: whether it is the inner muscle, shape (sample,); by the sign of the angle by
            default.
        times: of the samples, s, if they are in time.

    Returns:
        The lines `balloon` (twice), `muscle` and `wire`, and the lettered points as markers: A,
        B, C, D, E and H of an inner muscle; M, P, O, Q, N, B, D and E of an outer one.

    Raises:
        InputError: the joint cannot be built at one of the angles.
    """
    size = np.asarray(angles, dtype=float)
    check_geometry(geometry, size)
    bend = jnp.asarray(size, dtype=jnp.result_type(float))
    side = size >= 0 if inner is None else np.asarray(inner, dtype=bool)
    path = muscle_path(geometry, bend, jnp.asarray(side))
    anchor, wire_end, shoulder = (
        _plane(point(bend)) for point in (geometry.anchor, geometry.wire_end, geometry.contact)
    )
    bush = np.stack([np.zeros_like(size), np.asarray(path.height)], axis=-1)
    slack = np.asarray(path.wire_slack)
    lines = (
        *(_balloon(geometry, size, sign) for sign in (-1.0, 1.0)),
        Line(
            "muscle",
            _in_space(_muscle(anchor, bush, shoulder, side, np.asarray(path.engaged))),
            np.zeros(4),
        ),
        Line(
            "wire",
            _in_space(_wire(wire_end, bush, slack)),
            np.zeros(2 * _WIRE_POINTS),
            loose=slack > 0,
        ),
    )
    markers = {
        "A": _where(side, _mirrored(anchor)),
        "C": _where(side, anchor),
        "H": _where(side, bush),
        "M": _where(~side, _mirrored(anchor)),
        "N": _where(~side, anchor),
        "O": _where(~side, bush),
        "P": _where(~side, _mirrored(shoulder)),
        "Q": _where(~side, shoulder),
        "E": np.zeros_like(bush),
        "B": _mirrored(wire_end),
        "D": wire_end,
    }
    return Scene(lines, {name: _in_space(points) for name, points in markers.items()}, times)


def _plane(point: tuple[Array, Array]) -> Points:
    return np.stack([np.asarray(part) for part in point], axis=-1)


def _mirrored(points: Points) -> Points:
    return points * np.array([-1.0, 1.0])


def _where(side: Bool[np.ndarray, " sample"], points: Points) -> Points:
    return np.where(side[:, None], points, np.nan)


def _in_space(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)


def _muscle(
    anchor: Points,
    bush: Points,
    shoulder: Points,
    inner: Bool[np.ndarray, " sample"],
    engaged: Bool[np.ndarray, " sample"],
) -> Float[np.ndarray, "sample 4 2"]:
    """Straight from end to end, over the bush (inner) or over both shoulders (outer)."""
    right = np.where(inner[:, None], bush, shoulder)
    right = np.where(engaged[:, None], right, anchor)
    left = np.where(engaged[:, None] & inner[:, None], bush, _mirrored(right))
    return np.stack([_mirrored(anchor), left, right, anchor], axis=1)


def _wire(
    end: Points, bush: Points, slack: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "sample point 2"]:
    """From B over the bush to D; where it is slack, each half is a bow of about its length."""
    along = np.linspace(0.0, 1.0, _WIRE_POINTS)
    halves = []
    for foot in (_mirrored(end), end):
        line = foot[:, None] + along[None, :, None] * (bush - foot)[:, None]
        span = np.linalg.norm(bush - foot, axis=-1)
        # A shallow bow of rise r over a span s is 8 r^2 / (3 s) longer than the span.
        rise = np.sqrt(3 * np.maximum(slack, 0.0) / 2 * span / 8)
        outwards = np.where(foot[:, :1] < 0, -1.0, 1.0) * np.array([1.0, 0.0])
        bow = rise[:, None] * 4 * along * (1 - along)
        halves.append(line + bow[:, :, None] * outwards[:, None])
    return np.concatenate([halves[0], halves[1][:, ::-1]], axis=1)


def _balloon(geometry: JointGeometry, angles: Float[np.ndarray, " sample"], sign: float) -> Line:
    """One link: narrow at the joint, and as wide as its shoulder from there on."""
    shoulder, radius = float(geometry.contact_x), float(geometry.contact_y)
    axis = np.stack([sign * np.cos(angles / 2), np.sin(angles / 2)], axis=-1)
    distances = np.array([0.0, shoulder, _REACH])
    points = axis[:, None] * distances[None, :, None]
    return Line("balloon", _in_space(points), np.array([0.0, radius, radius]))
