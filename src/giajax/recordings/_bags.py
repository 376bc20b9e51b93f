"""Bags of ROS 2, as folders or MCAP files: joints, poses and inertial sensors by their topics."""

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.files import check_kind, check_path, read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.text import InputError, tried
from ._foreign import ForeignColumn, ForeignTable, ImportSettings, Numbers, placed, some

_SUFFIXES = (".mcap", ".db3")
_NS = 10**9
_SINCE_1970 = 10**8 * _NS  # what a clock shows, but no simulation, which may begin at 0
_Moments = npt.NDArray[np.int64]


class _Cell(NamedTuple):
    """One number of a message: of which thing, its label and quantity, and the value, SI."""

    thing: str
    label: str
    quantity: str
    value: float


def _joints(topic: str, message: Any) -> Iterator[_Cell]:
    """`sensor_msgs/JointState`, whose three lists may each be empty."""
    for label, quantity in (("position", "angle"), ("velocity", "angular_velocity")):
        # Of a message with fewer names there are no further joints.
        for name, value in zip(message.name, getattr(message, label), strict=False):
            yield _Cell(f"{topic}/{name}", label, quantity, value)
    for name, value in zip(message.name, message.effort, strict=False):
        yield _Cell(f"{topic}/{name} effort", "", "torque", value)


def _pose(topic: str, message: Any) -> Iterator[_Cell]:
    for axis in "xyz":
        yield _Cell(topic, axis, "length", getattr(message.position, axis))


def _poses(topic: str, message: Any) -> Iterator[_Cell]:
    for number, pose in enumerate(message.poses):
        yield from _pose(f"{topic}/{number}", pose)


def _inertial(topic: str, message: Any) -> Iterator[_Cell]:
    """`sensor_msgs/Imu`: a covariance that begins with -1 says that there is no such sensor."""
    for vector, covariance, quantity in (
        (message.angular_velocity, message.angular_velocity_covariance, "angular_velocity"),
        (message.linear_acceleration, message.linear_acceleration_covariance, "acceleration"),
    ):
        if covariance[0] != -1:
            for axis in "xyz":
                yield _Cell(topic, axis, quantity, getattr(vector, axis))


_MESSAGES: Mapping[str, Callable[[str, Any], Iterator[_Cell]]] = {
    "sensor_msgs/msg/JointState": _joints,
    "geometry_msgs/msg/PoseArray": _poses,
    "geometry_msgs/msg/PoseStamped": lambda topic, message: _pose(topic, message.pose),
    "sensor_msgs/msg/Imu": _inertial,
}


def is_bag(path: Path) -> bool:
    """Whether a path is that of a folder or file as ROS 2 records it."""
    return path.is_dir() or path.suffix.lower() in _SUFFIXES


def read_bag(path: Path, how: ImportSettings) -> ForeignTable:
    """Read joints, poses and inertial sensors of a bag; times count from its first message.

    A thing is called by its topic, `/imu`, a joint `/joint_states/shoulder`, and the first pose of
    an array `/markers/0`. Times of a topic are those of its headers, where they have any, else of
    the bag.

    Raises:
        InputError: it is no bag, or has none of these messages, or `rosbags` is not installed; or
            messages of a thing that is not ignored have no stamps, equal ones, or another clock.
    """
    check_path(path)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            'a bag needs rosbags, which is not installed: pip install "giajax[ros]"'
        ) from None
    if how.frame_rate is not None:
        raise InputError(f"{path}: a bag has its own times: leave out --frame-rate")
    clocks: dict[str, list[tuple[int, int]]] = {}  # stamp and reception of each message
    series: dict[tuple[str, str, str, str], list[tuple[int, float]]] = {}
    # Recorders of earlier distributions leave the definitions of the messages out.
    store = get_typestore(Stores.LATEST)
    with tried(f"reading {path}"):  # which rosbags does, whatever they are
        for part in path.iterdir() if path.is_dir() else (path,):
            check_kind(part, part.stat().st_mode)
            if part.suffix == ".yaml":
                read_bytes(part, RESULT_BYTES)
    with tried(f"reading {path} with rosbags"), AnyReader([path], default_typestore=store) as bag:
        topics = [f"{each.topic} ({each.msgtype})" for each in bag.connections]
        known = [each for each in bag.connections if each.msgtype in _MESSAGES]
        for connection, received, data in bag.messages(known) if known else ():
            message: Any = bag.deserialize(data, connection.msgtype)
            stamp = message.header.stamp
            topic = connection.topic
            clock = clocks.setdefault(topic, [])
            for thing, label, quantity, value in _MESSAGES[connection.msgtype](topic, message):
                found = series.setdefault((topic, thing, label, quantity), [])
                found.append((len(clock), float(value)))
            clock.append((stamp.sec * _NS + stamp.nanosec, received))
        clocked = {topic: np.array(clock, dtype=np.int64) for topic, clock in clocks.items()}
    if not series:
        kinds = ", ".join(kind.replace("/msg/", "/") for kind in _MESSAGES)
        raise InputError(
            f"{path} has no message of {kinds}, but {some(topics) or 'none'}: give another bag"
        )
    ignored = ImportSettings(ignore=how.ignore)  # what is not read may have any clock
    kept = dict.fromkeys(topic for topic, thing, *_ in series if ignored.keeps(thing))
    stamps = _stamps(path, {topic: clocked[topic] for topic in kept})
    moments = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *stamps.values()]))
    things: dict[str, list[ForeignColumn]] = {}
    for (topic, thing, label, quantity), cells in series.items():
        values: Numbers = np.full(len(moments), np.nan)
        if ignored.keeps(thing):
            at = stamps[topic][[number for number, _ in cells]]
            if again := len(at) - len(np.unique(at)):
                raise InputError(
                    f"{path}: {again} of {len(at)} messages of {topic} have the same time stamp as "
                    f"another one: correct the stamps, or leave them out with --ignore '{topic}*'"
                )
            values[np.searchsorted(moments, at)] = [value for _, value in cells]
        things.setdefault(thing, []).append(ForeignColumn(label, quantity, values))
    for thing, columns in things.items():
        if columns[0].quantity == "length":
            metres = [column.values for column in columns]
            things[thing] = placed(metres, how.axes or "xyz", f"{path}: {thing}")
    lengths = any(columns[0].quantity == "length" for columns in things.values())
    how.check_used(path, "ROS 2", *(["axes"] if lengths else []))
    times = (moments - moments[:1]) / _NS
    return ForeignTable("a bag of ROS 2", times, things, merged=True)


def _stamps(path: Path, clocks: Mapping[str, _Moments]) -> dict[str, _Moments]:
    """Times of the messages of topics, ns, of the stamp and the reception of each."""
    stamps = {}
    for topic, clock in clocks.items():
        none = int(np.sum(clock[:, 0] == 0))
        if 0 < none < len(clock) and clock[:, 0].max() > _SINCE_1970:
            raise InputError(
                f"{path}: {none} of {len(clock)} messages of {topic} have no time stamp, but the "
                f"others have one: correct the stamps, or leave them out with --ignore '{topic}*'"
            )
        stamps[topic] = clock[:, 1 if none == len(clock) else 0]
    received = [int(time) for clock in clocks.values() for time in clock[[0, -1], 1]]
    spans = {topic: (int(each.min()), int(each.max())) for topic, each in stamps.items()}
    whole = (min(received, default=0), max(received, default=0))
    length = max(last - first for first, last in [whole, *spans.values()])
    order = sorted(spans, key=spans.__getitem__)
    for topic, later in pairwise(order):
        gap = spans[later][0] - max(spans[each][1] for each in order[: order.index(later)])
        if gap > length:
            raise InputError(
                f"{path}: the clocks of {topic} and {later} lie {gap / _NS:.6g} s apart, but the "
                f"bag lasts {length / _NS:.6g} s: correct the stamps, or leave one out, such as "
                f"with --ignore '{later}*'"
            )
    return stamps
