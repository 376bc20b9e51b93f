"""Check a run for implausible data, also by comparison with the arm at its commanded angles.

Each check is a function in `_CHECKS`. Checks that need no commands are in `_plausible_columns` and
`_plausible_constants`.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..schema import (
    BASE,
    BUOYANCY,
    CAMERA,
    LINKS,
    MARKER,
    ArmSection,
    InitialSection,
    SensorsSection,
    WindSection,
)
from . import _plausible_columns as columns, _plausible_constants as constants
from ._channels import Channel
from ._mistakes import Mistake, mistakes
from ._plausible_columns import (
    PAPER,
    TURN,
    Look,
    Oddity,
    Rows,
    Values,
    arm_values,
    is_balanced,
    number_of_links,
)
from ._run import Run


def oddities(run: Run) -> list[Oddity]:
    """Return the implausible features of a run; most correct recordings have none.

    Example:
        >>> import giajax
        >>> values = {"joint01_command": [0.0, 30.0, 30.0], "link01_z": [0.0, 0.1, 0.2]}
        >>> [odd] = giajax.recordings.oddities(giajax.Run.from_arrays([0.0, 0.5, 1.0], values))
        >>> odd.code, odd.remedy
        ('units', '--rename joint01_command_rad=joint01_command_deg, if this is the case')
    """
    look = Look(run)
    return [odd for check in _CHECKS for odd in check(look)]


# Initial states.


def _is_blown(look: Look) -> bool:
    wind = look.section(WindSection).velocity_m_per_s or look.section(ArmSection).wind_field
    return bool(look.run.winds or wind)


def _at_equilibrium(look: Look) -> Iterator[Oddity]:
    """Report a free motion that the model would start at an equilibrium."""
    if look.run.model != "arm" or look.run.commands or _is_blown(look):
        return
    initial, arm = look.section(InitialSection), look.section(ArmSection)
    began = initial.first_row or any(np.any(value) for value in initial.values().values())
    gravity = arm_values(arm).get(BASE.gravity.path)
    rests = arm.preset == "pendulum" or not np.any(gravity or 0.0)
    if began or not rests:
        return
    moving = [n for n, c in look.measured.items() if c.span > 20 * max(c.noise, 1e-9)]
    if moving:
        yield Oddity(
            "start",
            f"{moving[0]} moves, but without a state in [initial] a free motion starts at the "
            "equilibrium, where nothing moves",
            "set first_row = true in [initial], and also free = true if angles are not recorded, "
            "or set angle_deg and rate_deg_per_s",
            tuple(moving),
        )


_MOVES = 0.15  # fraction of the whole motion that is implausible before the first command change


def _before_commands(look: Look) -> Iterator[Oddity]:
    """Report motion before the commands change if the arm is assumed to start at rest."""
    if look.run.model != "arm" or look.times is None or not look.run.commands or _is_blown(look):
        return
    initial = look.section(InitialSection)
    if initial.first_row or initial.free or initial.values():
        return
    moving = []
    for name, cells in look.measured.items():
        early = cells.values[cells.rows < look.still]
        if cells.channel.quantity in ("acceleration", "angular_velocity") or len(early) < 6:
            continue
        third = max(len(early) // 3, 2)
        drift = abs(float(np.median(early[-third:]) - np.median(early[:third])))
        if drift > max(_MOVES * cells.span, 6 * cells.noise):
            moving.append(name)
    if moving:
        more = f"{moving[0]} and {len(moving) - 1} more"
        yield Oddity(
            "start",
            f"{' and '.join(moving) if len(moving) < 3 else more} "
            f"{'moves' if len(moving) == 1 else 'move'} up to "
            f"{look.at([look.still - 1])}, before any command changes, but the arm is assumed to "
            "start at rest, so the clocks of camera and commands may differ, or the arm may have "
            "been moving",
            "correct the time stamps, or give the initial state in [initial] (free = true lets "
            "the fit estimate it)",
            tuple(moving),
        )


# Recorded positions and angles of an arm, compared with those at the commanded angles.
#
# The arm follows its commands with a delay that increases towards the tip. Each column is therefore
# compared with its value at the commands after the first-order lag that fits it best.

_BLOCKS, _IN_BLOCK = 64, 5
_LAGS = np.array([1e-9, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0])  # s
_IMBALANCES = (BUOYANCY.imbalance, BUOYANCY.imbalance_drift)
_MOVES_BY = 20.0  # minimum ratio of the squared motion of a channel to its squared noise
_BETTER = -0.45  # maximum mean log ratio of the squared residuals with and without a correction
_FEWEST_BLOCKS = 20  # minimum number of blocks for a comparison with the recording
_USUAL_WAYS = 100  # candidates for which `_BETTER` holds at `_BLOCKS`; with more it is stricter
_SMOOTHER = 0.4  # maximum ratio of the roughness with two labels exchanged to that as recorded


class _Point(NamedTuple):
    """A recorded number: a component (None: the joint angle) of a link, counted from 0."""

    channel: Channel
    link: int
    component: int | None

    @classmethod
    def of(cls, channel: Channel, count: int) -> "_Point":
        """Return the point of a channel of an arm with `count` links; the tip has this number."""
        link = count if channel.index is None else channel.index - 1
        return cls(channel, link, channel.component)


@dataclasses.dataclass(frozen=True)
class _Pose:
    """Recorded values in blocks of rows, and the arm at its commands.

    Attributes:
        points: meaning of each column; the tip has the number after the last link.
        recorded: recorded values, m, shape (block, point); joint angles times the reach of the arm.
        first: recorded values in the first rows, before any command changes, shape (point,).
        times: times, s, shape (block,).
        angles: commanded angles, rad, shape (block, joint).
        joints: name of a command -> number of its joint, from 0.
        noise: standard deviation of the noise of each point, shape (point,).
        lengths, axes, base: lengths of the links, joint axes, and rotation vector of the base.
        width: diameter of the links, m.
    """

    points: list[_Point]
    recorded: Values
    first: Values
    times: Values
    angles: Values
    joints: dict[str, int]
    noise: Values
    lengths: Values
    axes: Values
    base: Values
    width: float

    @property
    def reach(self) -> float:
        return float(np.sum(self.lengths))

    def places(self, angles: Values) -> Values:
        """Return link centres and tip, the straight arm first, shape (1 + block, link + 1, 3)."""
        angles = np.concatenate([np.zeros((1, angles.shape[1])), angles])
        turn = np.broadcast_to(_rotation(self.base[None]), (len(angles), 3, 3))
        end, centres = np.zeros((len(angles), 3)), []
        for joint, (axis, length) in enumerate(zip(self.axes, self.lengths, strict=True)):
            if np.any(angles[:, joint]):
                turn = turn @ _rotation(axis * angles[:, joint, None])
            span = length * turn[:, :, 0]
            centres.append(end + span / 2)
            end = end + span
        return np.stack([*centres, end], axis=1)

    def seen(self, places: Values, angles: Values, points: Sequence[_Point]) -> Values:
        """Return points at the commands, shape (1 + block, point), the straight arm first."""
        whole = np.concatenate([np.zeros((1, angles.shape[1])), angles])
        columns = [
            whole[:, p.link] * self.reach if p.component is None else places[:, p.link, p.component]
            for p in points
        ]
        return np.stack(columns, axis=1)

    def squares(self, recorded: Values, seen: Values) -> Values:
        """Return the sum of squared residuals of each point for the best first-order lag."""
        lagged = np.repeat(seen[:1, None], len(_LAGS), axis=1)[0]
        left = np.zeros(lagged.shape)
        steps = np.diff(self.times, prepend=self.times[0])
        for row, target, step in zip(recorded, seen[1:], steps, strict=True):
            lagged = lagged + (1 - np.exp(-step / _LAGS))[:, None] * (target - lagged)
            left += np.nan_to_num((row - lagged) ** 2)
        return np.asarray(np.min(left, axis=0))

    @cached_property
    def at_commands(self) -> Values:
        """`places` at the commands as recorded."""
        return self.places(self.angles)

    def points_but_for(self, mistake: Mistake) -> tuple[list[_Point], Values]:
        """Return the points that the columns contain given a mistake, and their factors."""
        points, times = [], []
        for point in self.points:
            name = point.channel.name
            of, factor = mistake.sources.get(name, (name, 1.0))
            points.append(point if of == name else _Point.of(Channel.named(of), len(self.lengths)))
            times.append(factor)
        return points, np.array(times)

    def squares_but_for(self, mistake: Mistake | None) -> Values:
        """Return the sum of squared residuals of each point after correction of a mistake."""
        if mistake is None:
            return self.squares(
                self.recorded, self.seen(self.at_commands, self.angles, self.points)
            )
        points, times = self.points_but_for(mistake)
        angles, places = self.angles, self.at_commands
        if mistake.kind == "commands":
            angles = self.angles.copy()
            there = {n: of for n, of in mistake.sources.items() if n in self.joints}
            angles[:, [self.joints[name] for name in there]] = 0.0
            for name, (of, factor) in there.items():
                joint = (Channel.named(of).index or 1) - 1
                angles[:, joint] = self.angles[:, self.joints[name]] / factor
            if np.max(np.abs(angles)) > TURN:
                return np.full(len(points), np.inf)
            places = self.places(angles)
        return self.squares(self.recorded, times * self.seen(places, angles, points))


def _rotation(vectors: Values) -> Values:
    """Convert rotation vectors, shape (row, 3), to rotation matrices, shape (row, 3, 3)."""
    size = np.linalg.norm(vectors, axis=-1)[:, None, None]
    unit = vectors / np.maximum(size[:, :, 0], 1e-300)
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = unit
    cross[:, [1, 2, 0], [2, 0, 1]] = -unit
    return np.eye(3) + np.sin(size) * cross + (1 - np.cos(size)) * (cross @ cross)


def _within(edges: Rows) -> Rows:
    """Return a few evenly spaced positions within each of some ranges, shape (range, position)."""
    first, last = edges[:-1, None], np.maximum(edges[1:, None] - 1, edges[:-1, None])
    return (first + (last - first) * np.linspace(0, 1, _IN_BLOCK)).astype(int)


def _pose_of(look: Look) -> _Pose | None:
    """Return the data to compare, or None if the arm is not known, or not driven by commands only.

    The comparison assumes that the arm moves from the straight state to its commanded angles.
    """
    run, section, times = look.run, look.section(ArmSection), look.times
    known, count = arm_values(section), number_of_links(look)
    commands = {
        name: values
        for name, values in run.commands.items()
        if run.channels[name].kind == "joint_command"
    }
    joints = {name: (run.channels[name].index or 1) - 1 for name in commands}
    initial, sensors = look.section(InitialSection), look.section(SensorsSection).values()
    heavy = np.any(known.get(BASE.gravity.path, 0.0)) and not is_balanced(section)
    heavy = heavy or any(np.any(known.get(each.path, 0.0)) for each in _IMBALANCES)
    heavy = heavy or any(not body.structural for body in section.point_masses or ())
    driven = len(commands) < len(run.commands) or section.muscles or section.joint_laws
    stated = initial.values() or initial.first_row or initial.free or section.obstacles
    seen = any(path.startswith("camera.") for path in sensors)
    seen = seen or any(np.any(sensors.get(each.path, 0.0)) for each in MARKER)
    axes: Any = section.joint_axes
    if axes is None and section.preset in PAPER:
        axes = "pitch_yaw"
    if times is None or count is None or axes is None or LINKS.length.path not in known:
        return None
    if not commands or heavy or _is_blown(look) or driven or stated or seen:
        return None
    edges = np.linspace(0, len(times), min(_BLOCKS, len(times)) + 1).astype(int)
    rows = _within(edges)
    lengths = np.broadcast_to(known[LINKS.length.path], (count,))
    points, columns, first, noise = [], [], [], []
    for name, cells in look.measured.items():
        point = _Point.of(cells.channel, count)
        turns = cells.channel.kind == "joint_angle" and point.link in joints.values()
        if not turns and cells.channel.kind not in ("link_position", "tip_position"):
            continue
        points.append(point)
        scale = float(np.sum(lengths)) if turns else 1.0
        bounds = np.searchsorted(cells.rows, edges)
        inside = np.minimum(_within(bounds), len(cells.rows) - 1)
        middle = np.median(cells.values[inside], axis=1)
        columns.append(scale * np.where(np.diff(bounds) > 0, middle, np.nan))
        early = cells.values[cells.rows < min(look.still, 1000)]
        first.append(scale * np.median(early) if len(early) else np.nan)
        noise.append(scale * max(run.noise(name) or 0.0, cells.noise))
    if not points:
        return None
    angles = np.zeros((len(rows), count))
    for name, values in commands.items():
        angles[:, joints[name]] = np.median(values[rows], axis=1)
    if np.max(np.abs(angles)) > TURN:  # reported by `columns.magnitudes`
        return None
    named = {"pitch": (0.0, -1.0, 0.0), "yaw": (0.0, 0.0, 1.0)}
    words = ["pitch", "yaw"] * count if axes == "pitch_yaw" else axes
    vectors = np.array([named[a] if isinstance(a, str) else a for a in words[:count]], dtype=float)
    return _Pose(
        points,
        np.stack(columns, axis=1),
        np.array(first),
        np.median(times[rows], axis=1),
        angles,
        joints,
        np.array(noise),
        lengths,
        vectors / np.linalg.norm(vectors, axis=1, keepdims=True),
        np.asarray(known.get(BASE.base_rotation.path, np.zeros(3)), dtype=float),
        float(np.max(known.get(LINKS.diameter.path, 0.0))),
    )


class _Undone(NamedTuple):
    """A mistake that may have been made: its code, description and remedy."""

    code: str
    words: str
    remedy: str


def _at_commands(look: Look) -> Iterator[Oddity]:
    """Report positions and angles that follow the commands only if one mistake is corrected."""
    pose = _pose_of(look) if look.run.model == "arm" else None
    if pose is None:
        return
    names = tuple(point.channel.name for point in pose.points)
    asked = mistakes([look.run])
    found = [*_in_first_rows(pose, asked)] or [*_exchanged(pose, asked)] or [*_farther_in(pose)]
    if found:
        yield from (Oddity(each.code, each.words, each.remedy, names) for each in found)
        return
    before = pose.squares_but_for(None)
    noise = np.sum(~np.isnan(pose.recorded), axis=0) * pose.noise**2
    whole = np.nansum((pose.recorded - pose.first) ** 2, axis=0)
    moves = whole > _MOVES_BY * noise
    if not moves.any() or len(pose.times) < _FEWEST_BLOCKS:
        return
    floor = 4 * noise + 1e-3 * whole

    def gain(mistake: Mistake) -> float:
        left = pose.squares_but_for(mistake)
        return float(np.mean(np.log((left + floor) / (before + floor))[moves]))

    # Wrong link numbers are detected from the shape of the arm, and wrong units from its reach.
    moving = [each for each in asked if each.kind in ("angles", "axes", "commands")]
    gains = [(gain(each), each) for each in moving]
    best = min((gained for gained, _ in gains), default=0.0)
    by_chance = np.log(len(gains) + 1) / np.log(_USUAL_WAYS) * _BLOCKS / len(pose.times)
    if best > _BETTER * max(1.0, float(np.sqrt(by_chance))):
        return
    # Nearly equal corrections are reported, too, with the simplest one first.
    near = [each for gained, each in gains if gained < best + 0.1][:3]
    yield Oddity(
        near[0].code,
        "the recorded motion does not follow the commands, but would follow them with corrected "
        "columns: " + "; or ".join(each.words for each in near),
        "; or ".join(dict.fromkeys(each.remedy for each in near)),
        names,
    )


def _exchanged(pose: _Pose, asked: Sequence[Mistake]) -> Iterator[_Undone]:
    """Report two labels whose exchange makes the rough recorded shape of the arm smooth."""
    along = np.append(np.cumsum(pose.lengths) - pose.lengths / 2, pose.reach)

    def roughness(points: Sequence[_Point]) -> tuple[float, float]:
        """Return the sum of squared bends between links, and the part expected from noise."""
        bends = by_noise = 0.0
        for axis in range(3):
            of = [(point.link, i) for i, point in enumerate(points) if point.component == axis]
            if len(of) < 3:
                continue
            links, at = (list(each) for each in zip(*sorted(of), strict=True))
            shape = (pose.recorded - pose.first)[:, at]
            shape = shape[~np.isnan(shape).any(axis=1)]
            gaps = np.diff(along[links], prepend=0.0)
            if not np.all(gaps > 0):
                return np.inf, 1.0
            slopes = np.diff(shape, axis=1, prepend=0.0) / gaps
            bends += float(np.sum(np.diff(slopes, axis=1) ** 2))
            noise = np.append(0.0, pose.noise[at])
            apart = (noise[:-2] / gaps[:-1]) ** 2 + (noise[2:] / gaps[1:]) ** 2
            apart += (noise[1:-1] * (1 / gaps[:-1] + 1 / gaps[1:])) ** 2
            by_noise += len(shape) * float(np.sum(apart))
        return bends, by_noise

    bends, by_noise = roughness(pose.points)
    if bends <= 4 * by_noise:
        return
    pairs = [each for each in asked if each.kind == "exchanged"]
    rough = [(roughness(pose.points_but_for(each)[0])[0], each) for each in pairs]
    least, pair = min(rough, default=(np.inf, None), key=lambda each: each[0])
    if pair is not None and least < _SMOOTHER * bends:
        yield _Undone(
            "labels",
            f"the recorded shape of the arm is not smooth, but would be with {pair.words}",
            pair.remedy,
        )


def _farther_in(pose: _Pose) -> Iterator[_Undone]:
    """Report a link that turns with the commands although all commanded joints are farther out."""
    # The range includes the straight arm, because a wrong command may act from the first row on.
    spans = np.ptp(np.pad(pose.angles, ((1, 0), (0, 0))), axis=0)
    turning = [joint for joint in pose.joints.values() if spans[joint] > 0]
    for i, point in enumerate(pose.points):
        inner = turning and point.link < min(turning)
        if point.component not in (1, 2) or not inner or np.isnan(pose.first[i]):
            continue
        along = float(np.sum(pose.lengths[: point.link])) + pose.lengths[point.link] / 2
        turned = np.nanmax(np.abs(pose.recorded[:, i] - pose.first[i])) / along
        far = 0.5 * float(np.max(spans))
        if turned > max(far, 10 * pose.noise[i] / along):
            name = f"joint{min(turning) + 1:02d}_command"
            yield _Undone(
                "command",
                f"link {point.link + 1} turns by {np.rad2deg(turned):.2g} deg, but no joint "
                f"between the base and this link is commanded, so {name} may belong to another "
                "joint",
                f"--rename {name}_deg=joint{max(point.link - 1, 0) + 1:02d}_command_deg, or name "
                "the column after the joint that was commanded",
            )
            return


def _in_first_rows(pose: _Pose, asked: Sequence[Mistake]) -> Iterator[_Undone]:
    """Report first rows that differ from the straight arm, which is assumed to rest there."""
    straight = pose.places(pose.angles[:1])[0]
    chosen = [
        i
        for i, p in enumerate(pose.points)
        if p.component is not None and pose.first[i] == pose.first[i]
    ]
    points, first = [pose.points[i] for i in chosen], pose.first[chosen]
    at = np.array([straight[p.link] for p in points]).reshape(-1, 3)
    axis = np.array([p.component for p in points], dtype=int)
    here = at[np.arange(len(points)), axis]
    enough = max(0.015 * pose.reach, pose.width, 6 * float(np.max(pose.noise[chosen], initial=0.0)))
    rest = first - here
    if not len(points) or np.max(np.abs(rest)) <= enough:
        return
    # Wrong axes or labels are tried first: with these, the rows match the straight arm exactly.
    for each in asked:
        if each.kind in ("axes", "exchanged", "numbers"):
            others, times = pose.points_but_for(each)
            there = [times[i] * straight[others[i].link, others[i].component or 0] for i in chosen]
            if np.max(np.abs(first - there)) <= enough:
                words = f"the first rows match a straight arm with {each.words}"
                yield _Undone(each.code, words, each.remedy)
                return
    origin = np.array([np.median(rest[axis == c]) if np.any(axis == c) else 0.0 for c in range(3)])
    stated = ",".join(f"{each:.3g}" for each in origin + 0.0)
    path = CAMERA.origin.path
    if np.max(np.abs(rest - origin[axis])) <= max(enough, 0.2 * np.max(np.abs(rest))):
        yield _Undone(
            "frame",
            f"the first rows differ from the straight arm by ({stated}) m, which is the same "
            "offset in all columns, so the origin of the camera frame may be wrong",
            f"--free {path} --start {path}={stated}, or subtract it from the columns",
        )
        return
    x, y, z = at.T
    zero = np.zeros(len(points))
    by_axis = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
    rows = np.column_stack([by_axis[axis, :, np.arange(len(points))], np.eye(3)[axis]])
    found = np.linalg.lstsq(rows, rest, rcond=1e-6)[0]
    degrees = float(np.rad2deg(np.linalg.norm(found[:3])))
    left = float(np.max(np.abs(rest - rows @ found)))
    turned_so = degrees < 30 and left <= max(enough, 0.2 * np.max(np.abs(rest))) and len(points) > 6
    how = f"the frame of the camera may be rotated by {degrees:.2g} deg" if turned_so else (
        "the arm may not be straight at the start, or axes, labels or lengths may be wrong"
    )  # fmt: skip
    yield _Undone(
        "frame",
        f"the first rows are up to {np.max(np.abs(rest)):.3g} m away from the straight arm, so "
        f"{how}",
        f"--free {CAMERA.rotation.path} --free {path}"
        if turned_so
        else (
            "check the first rows, and set [initial] if the arm does not start straight and at rest"
        ),
    )


def _reach(look: Look) -> Iterator[Oddity]:
    """Report positions that are farther from the base than the arm can reach."""
    if look.run.model != "arm":
        return
    count, known = number_of_links(look), arm_values(look.section(ArmSection))
    if count is None or LINKS.length.path not in known:
        return
    sensors = look.section(SensorsSection).values()
    if CAMERA.origin.path in sensors or CAMERA.scale.path in sensors:
        return
    lengths = np.broadcast_to(known[LINKS.length.path], (count,))
    # Ratio of the recorded distance from the base to the largest possible one, for each column.
    beyond, points = [], set()
    for name, cells in look.measured.items():
        if cells.channel.kind in ("link_position", "tip_position"):
            link = (cells.channel.index or count + 1) - 1
            points.add(link)
            own = float(np.sum(lengths[:link]) + np.sum(lengths[link : link + 1]) / 2)
            seen = np.abs(cells.values[:: max(len(cells.values) // 2000, 1)])
            far = float(np.quantile(seen, 0.9))
            if far > 1.2 * own + 6 * cells.noise + 0.1:
                beyond.append((far / own, far, own, name))
    if not beyond:
        return
    ratio, far, own, name = max(beyond)
    channel = look.run.channels[name]
    # A ratio above 100 remains implausible in cm, so the unit is mm. If only a few points are too
    # far out, but within the length of the arm, their labels are more likely to be wrong.
    unit = "mm" if ratio > 120 else "cm" if ratio > 10 else ""
    far_points = {(look.measured[each[-1]].channel.index or count + 1) - 1 for each in beyond}
    if 2 * len(far_points) < len(points) and far < 1.2 * float(np.sum(lengths)):
        unit = ""
    what = (
        f"the values may be in {unit}" if unit else "the origin, a label or a length may be wrong"
    )
    remedy = "correct the columns, or links and link_length_m in [arm]"
    if unit:
        renamed = f"--rename {channel.column}={name}_{unit}, and rename the others in the same way"
        remedy = renamed if channel.unit == "m" else "convert the values"
    yield Oddity(
        "units" if unit else "frame",
        f"{look.of(channel)} reaches {far:.4g} m, but the arm limits it to {own:.4g} m, so {what}",
        remedy,
        (name,),
    )


_CHECKS: tuple[Callable[[Look], Iterator[Oddity]], ...] = (
    columns.stamps, columns.leaps, columns.takes, _reach, columns.magnitudes, _at_commands,
    constants.constants, constants.force, columns.falls, _at_equilibrium, _before_commands,
    columns.sentinels, columns.zeros, columns.wraps, columns.glitches, columns.noise_too_small,
)  # fmt: skip
