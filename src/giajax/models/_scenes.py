"""Scenes of an arm and of a joint at rest, which contain their visible parts."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ..mechanics.arm import Arm, drag_force, pose
from ..mechanics.joint import Bend, JointGeometry, check_geometry, muscle_path
from ..mechanics.obstacles import owners, solids
from ..recordings import Run
from ..runtime.arrays import Array, Bool, Float, cross, dot, safe_norm, scaled
from ..runtime.programs import program
from ..simulation import Trajectory, contacts
from ._arm_sensors import Marker
from ._protocol import Arrows, Block, Line, Scene


def arm_scene(motion: Trajectory, marker: Marker | None = None) -> Scene:
    """Return the visible parts of a moving arm, for example from `giajax.simulate`.

    `marker` gives the positions of the tracked points, by default the centres of the links and the
    tip.

    Returns:
        One line `link` for each link, from its joint to its end; two lines `muscle` with pressures
        for each joint that has muscles; one marker for each tracked point (`link01`, ..., `tip`);
        the drag on each link as arrows `air` and the contact force as arrows `contact`, both at
        its centre; the obstacles; and, for more than one sample, the joint angles and the commands
        that are not zero as channels.

    Example:
        >>> import giajax, jax.numpy as jnp
        >>> from giajax.models import arm_scene
        >>> arm = giajax.takeichi_20m(4)
        >>> command = giajax.joint_steps(arm.count, {1: 0.2})
        >>> scene = arm_scene(giajax.simulate(arm, command, jnp.linspace(0.0, 1.0, 11)))
        >>> len(scene.lines), scene.lines[0].points.shape, list(scene.markers)[-1]
        (4, (11, 2, 3), 'tip')
    """
    arm = motion.arm
    corners, centres, tip = map(
        np.asarray, _points(arm, Marker() if marker is None else marker, motion.angles)
    )
    radii = np.asarray(arm.links.diameter) / 2
    lines = tuple(
        Line("link", corners[:, index : index + 2], np.full(2, radius))
        for index, radius in enumerate(radii)
    )
    markers = {f"link{index + 1:02d}": centres[:, index] for index in range(arm.count)}
    middles = (corners[:, 1:] + corners[:, :-1]) / 2
    arrows = [Arrows("air", "N", middles, np.asarray(_drag(motion)))]
    blocks: tuple[Block, ...] = ()
    if arm.contact is not None:
        pressed = np.asarray(contacts(motion).force).sum(axis=2)
        arrows.append(Arrows("contact", "N", middles, pressed))
        blocks = _blocks(arm)
    markers["tip"] = tip
    times = np.asarray(motion.times)
    channels = _channels(motion) if len(times) > 1 else {}
    return Scene(lines + _muscles(motion), markers, times, tuple(arrows), blocks, channels)


def _channels(motion: Trajectory) -> dict[str, np.ndarray]:
    """Return the joint angles, and the commands that are not zero, by channel name, rad."""
    angles, commands = np.asarray(motion.angles), np.asarray(motion.commands)
    joints = range(1, motion.arm.count + 1)
    found = {f"joint{joint:02d}_angle": angles[:, joint - 1] for joint in joints}
    for joint in joints:
        if np.any(commands[:, joint - 1]):
            found[f"joint{joint:02d}_command"] = commands[:, joint - 1]
    return found


def _muscles(motion: Trajectory) -> tuple[Line, ...]:
    """Return the pairs of muscles as lines across their joints, from link to link."""
    pneumatics = motion.arm.pneumatics
    if pneumatics is None:
        return ()
    assert motion.pressures is not None
    paths, pressures = np.asarray(_pairs(motion.arm, motion.angles)), np.asarray(motion.pressures)
    places = [(joint - 1, side) for joint in pneumatics.joints for side in (0, 1)]
    return tuple(
        Line("muscle", paths[:, side, :, at], np.zeros(3), pressure=pressures[:, side, at])
        for at, side in places
    )


def _blocks(arm: Arm) -> tuple[Block, ...]:
    """Return the boxes of all obstacles."""
    assert arm.contact is not None
    obstacles = arm.contact.obstacles
    boxes = solids(obstacles)
    return tuple(
        Block(
            obstacles[owner].name,
            np.asarray(boxes.centre[:, index]),
            2 * np.asarray(boxes.half[:, index]),
            np.asarray(boxes.frame[:, :, index]),
        )
        for index, owner in enumerate(owners(obstacles))
    )


@program
def _points(
    arm: Arm, marker: Marker, angles: Float[Array, "sample joint"]
) -> tuple[
    Float[Array, "sample corner 3"], Float[Array, "sample link 3"], Float[Array, "sample 3"]
]:
    """Return joints and end of the arm, link markers, and tip marker, m."""

    def at(row: Array) -> tuple[Array, Array, Array]:
        here = pose(arm, row)
        end = here.joint[:, -1:] + arm.links.length[-1] * here.direction[:, -1:]
        corners = jnp.concatenate([here.joint, end], axis=1).T
        return corners, marker.on_links(arm, row), marker.at_tip(arm, row)

    return jax.vmap(at)(angles)


@program
def _drag(motion: Trajectory) -> Float[Array, "sample link 3"]:
    """Return the drag on each link, N."""
    arm = motion.arm

    def at(time: Array, angles: Array, rates: Array) -> Array:
        wind = None if motion.wind is None else motion.wind(time)
        if wind is not None and wind.size != 3:
            wind = wind.reshape(arm.count, 3)
        return drag_force(arm, angles, rates, wind)

    return jax.vmap(at)(motion.times, motion.angles, motion.rates)


@program
def _pairs(
    arm: Arm, angles: Float[Array, "sample joint"]
) -> Float[Array, "sample side point joint 3"]:
    """Return lines of muscles on both sides of each joint, m: the first one, and the second.

    They are for display and do not follow the wire geometry: each lies on the surface of the
    balloons, over a quarter of each length.
    """

    def at(row: Array) -> Array:
        here = pose(arm, row)
        # Direction of the previous link, by Rodrigues' formula.
        before = scaled(jnp.cos(row), here.direction)
        before = before - scaled(jnp.sin(row), cross(here.axis, here.direction))
        along = dot(here.axis, here.direction) * (1 - jnp.cos(row))
        before = before + scaled(along, here.axis)
        radius = arm.links.diameter / 2 * jnp.ones_like(row)
        reach = arm.links.length / 4 * jnp.ones_like(row)
        ends = [scaled(-reach, before), jnp.zeros_like(before), scaled(reach, here.direction)]
        # A positive angle bends towards the first muscle.
        sides = [cross(here.axis, each) for each in (before, here.direction)]
        bow = sides[0] + sides[1]
        bow = scaled(1 / safe_norm(bow), bow)
        across = [scaled(radius, each) for each in (sides[0], bow, sides[1])]
        centres, offsets = here.joint[None] + jnp.stack(ends), jnp.stack(across)
        return jnp.moveaxis(jnp.stack([centres + offsets, centres - offsets]), 2, -1)

    return jax.vmap(at)(angles)


_REACH = 1.0  # length of a balloon from the centre of the joint, m: more than half of a link
_WIRE_POINTS = 40  # points of each half of the wire, enough to draw an arc

Points = Float[np.ndarray, "sample 2"]


def joint_scene(
    geometry: JointGeometry,
    angles: npt.ArrayLike,
    inner: npt.ArrayLike | None = None,
    *,
    times: Float[np.ndarray, " sample"] | None = None,
) -> Scene:
    """Return the visible parts of one joint and of its muscle on the +y side.

    The frame is that of the bisector: the centre E of the joint is the origin, x points to the
    right link, and all z are 0.

    Arguments:
        angles: bending angles of the muscle, rad, shape (sample,).
        inner: True for the inner muscle; by default it depends on the sign of the angle.
        times: times of the samples, s, if they are a time series.

    Returns:
        The lines `balloon` (twice), `muscle` and `wire`, and as markers the lettered points of
        figs 7 and 8: A, B, C, D, E and H for an inner muscle; M, P, O, Q, N, B, D and E for an
        outer one.

    Raises:
        InputError: the joint cannot be built at one of the angles.
    """
    size = np.asarray(angles, dtype=float)
    check_geometry(geometry, size)
    angle = jnp.asarray(size, dtype=jnp.result_type(float))
    side = size >= 0 if inner is None else np.asarray(inner, dtype=bool)
    path, bend = muscle_path(geometry, angle, jnp.asarray(side)), Bend.by(angle)
    anchor, wire_end, shoulder = (
        np.stack([np.asarray(part) for part in point(bend)], axis=-1)
        for point in (geometry.anchor, geometry.wire_end, geometry.contact)
    )
    bush = np.stack([np.zeros_like(size), np.asarray(path.height)], axis=-1)
    slack = np.asarray(path.wire_slack)
    muscle = _in_space(_muscle(anchor, bush, shoulder, side, np.asarray(path.engaged)))
    wire = _in_space(_wire(wire_end, bush, slack))
    lines = (
        *(_balloon(geometry, size, sign) for sign in (-1.0, 1.0)),
        Line("muscle", muscle, np.zeros(4)),
        Line("wire", wire, np.zeros(2 * _WIRE_POINTS), loose=slack > 0),
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
    """Return a muscle as straight segments over the bush (inner) or both shoulders (outer)."""
    right = np.where(inner[:, None], bush, shoulder)
    right = np.where(engaged[:, None], right, anchor)
    left = np.where(engaged[:, None] & inner[:, None], bush, _mirrored(right))
    return np.stack([_mirrored(anchor), left, right, anchor], axis=1)


def _wire(
    end: Points, bush: Points, slack: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, "sample point 2"]:
    """Return the wire from B over the bush to D; each half is an arc if the wire is slack."""
    along = np.linspace(0.0, 1.0, _WIRE_POINTS)
    halves = []
    for foot in (_mirrored(end), end):
        line = foot[:, None] + along[None, :, None] * (bush - foot)[:, None]
        span = np.linalg.norm(bush - foot, axis=-1)
        # A shallow arc of rise r over a span s is 8 r^2 / (3 s) longer than the span.
        rise = np.sqrt(3 * np.maximum(slack, 0.0) / 2 * span / 8)
        outwards = np.where(foot[:, :1] < 0, -1.0, 1.0) * np.array([1.0, 0.0])
        bow = rise[:, None] * 4 * along * (1 - along)
        halves.append(line + bow[:, :, None] * outwards[:, None])
    return np.concatenate([halves[0], halves[1][:, ::-1]], axis=1)


def _balloon(geometry: JointGeometry, angles: Float[np.ndarray, " sample"], sign: float) -> Line:
    """Return a link that is narrow at the joint and widens to its full radius at the shoulder."""
    shoulder, radius = float(geometry.contact_x), float(geometry.contact_y)
    axis = np.stack([sign * np.cos(angles / 2), np.sin(angles / 2)], axis=-1)
    distances = np.array([0.0, shoulder, _REACH])
    points = axis[:, None] * distances[None, :, None]
    return Line("balloon", _in_space(points), np.array([0.0, radius, radius]))


# Tolerance relative to the extent of the scene. Axes that agree differ by less than this.
_ALIGNED = 1e-3


def recorded_markers(
    scene: Scene, run: Run, predicted: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray] | None:
    """Return recorded markers in the frame of the scene of a model that follows the run.

    Coordinates that were not recorded are those of the model. Its predictions are by channel, SI.

    Returns:
        Points by marker name, m, NaN where nothing was recorded; None if the axes of the recording
        differ from those of the scene.
    """
    low, high = scene.extent()
    allowed = _ALIGNED * float(np.max(high - low))
    found: dict[str, np.ndarray] = {}
    for name, points in scene.markers.items():
        here = points.copy()
        measured = np.zeros(len(here), bool)
        for axis, letter in enumerate("xyz"):
            channel = f"{name}_{letter}"
            if channel not in run.observations or len(predicted[channel]) != len(here):
                continue
            if np.nanmax(np.abs(predicted[channel] - points[:, axis])) > allowed:
                return None
            cells = run.observations[channel]
            here[:, axis] = cells
            measured |= ~np.isnan(cells)
        if measured.any():
            here[~measured] = np.nan
            found[name] = here
    return found
