"""Read joints, poses and inertial sensors from ROS 2 bags, which are folders or MCAP files.

The files are read here and not by rosbags, because rosbags decompresses data without a size limit
and executes code that it generates from the message definitions in the file. Only the standard
message definitions and the deserialisation of messages come from rosbags.
"""

import contextlib
import errno
import importlib
import io
import re
import sqlite3
import tempfile
import zlib
from array import array
from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.files import check_path, opened, read_text
from ..runtime.limits import (
    BAG_NUMBERS,
    CELL_BYTES,
    CHUNK_BYTES,
    COLUMNS,
    MESSAGE_BYTES,
    TEXT_BYTES,
    UNPACKED_BYTES,
    UNPACKED_TIMES,
    VALUE,
)
from ..runtime.text import InputError, install_command, shown, tried
from ._foreign import ForeignColumn, ForeignTable, ImportSettings, Numbers, placed, some

_SUFFIXES = (".mcap", ".db3")
_NS = 10**9
_SINCE_1970 = 10**8 * _NS  # separates wall-clock stamps from simulated time, which may start at 0
_MOMENTS = 2**63  # upper limit of time stamps, ns
_Moments = npt.NDArray[np.int64]


class _Cell(NamedTuple):
    """One number of a message: its thing, label and quantity, and its value in SI."""

    thing: str
    label: str
    quantity: str
    value: float


def _joints(topic: str, message: Any) -> Iterator[_Cell]:
    """Yield the numbers of a `sensor_msgs/JointState`, whose three lists may each be empty."""
    for label, quantity, ending in (
        ("position", "angle", ""),
        ("velocity", "angular_velocity", ""),
        ("effort", "torque", " effort"),
    ):
        values = getattr(message, label)
        if len(values) not in (0, len(message.name)):
            raise InputError(
                f"a message of {topic} has {len(message.name)} names but {len(values)} values of "
                f"{label}: it must have one value for each name, or no values"
            )
        for name, value in zip(message.name, values, strict=False):
            yield _Cell(f"{topic}/{name}{ending}", "" if ending else label, quantity, value)


def _pose(topic: str, message: Any) -> Iterator[_Cell]:
    for axis in "xyz":
        yield _Cell(topic, axis, "length", getattr(message.position, axis))


def _poses(topic: str, message: Any) -> Iterator[_Cell]:
    for number, pose in enumerate(message.poses):
        yield from _pose(f"{topic}/{number}", pose)


def _inertial(topic: str, message: Any) -> Iterator[_Cell]:
    """Yield the numbers of a `sensor_msgs/Imu`; a covariance starting with -1 means no sensor."""
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
    """Return whether a path is a folder or has the suffix of a file that ROS 2 records."""
    return path.is_dir() or path.suffix.lower() in _SUFFIXES


def read_bag(path: Path, how: ImportSettings) -> ForeignTable:
    """Read joints, poses and inertial sensors of a bag; times are relative to the first message.

    Things are named after their topics: `/imu`, a joint `/joint_states/shoulder`, and the first
    pose of an array `/markers/0`. The times of a topic are the time stamps in its message headers
    or, if these have none, the times at which the bag received the messages.

    Raises:
        InputError: the path is not a bag, the bag has no messages of the known types, or `rosbags`
            is not installed; time stamps of a topic that is not ignored are missing, repeated or
            from another clock; or the bag is damaged, or exceeds the limits before or after
            decompression.
    """
    check_path(path)
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            f"reading a bag requires rosbags, which is not installed: {install_command('ros')}"
        ) from None
    if how.frame_rate is not None:
        raise InputError(f"{path}: a bag contains its own time stamps: omit --frame-rate")
    ignored = ImportSettings(ignore=how.ignore)  # ignored topics may use any clock
    found = _Found(path, get_typestore(Stores.LATEST), ignored)
    with contextlib.closing(_messages(path, found.topics)) as messages:
        for each in messages:
            found.add(*each)
    if not found.series and not found.ignored:
        raise InputError(f"{path} {_said_of(found.topics)}")
    kept = [topic for topic, thing, *_ in found.series if ignored.keeps(thing)]
    clocks = {topic: np.frombuffer(found.clocks[topic][1], dtype=np.int64) for topic in kept}
    stamps = _stamps(path, clocks)
    moments = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *stamps.values()]))
    if len(kept) * len(moments) > BAG_NUMBERS:
        raise InputError(
            f"{path} gives a table of {len(kept):,} columns and {len(moments):,} rows, but the "
            f"table may have at most {BAG_NUMBERS:,} numbers: exclude topics with --ignore, or "
            "split the bag"
        )
    nothing: Numbers = np.broadcast_to(np.nan, len(moments))
    things: dict[str, list[ForeignColumn]] = {}
    for (topic, thing, label, quantity), (numbers, cells) in found.series.items():
        values = nothing
        if ignored.keeps(thing):
            at = stamps[topic][np.frombuffer(numbers, dtype=np.int64)]
            if again := len(at) - len(np.unique(at)):
                raise InputError(
                    f"{path}: {again} of {len(at)} messages of {topic} have the same time stamp as "
                    f"another message: correct the time stamps, or exclude the topic with --ignore "
                    f"'{topic}*'"
                )
            values = np.full(len(moments), np.nan)
            values[np.searchsorted(moments, at)] = np.frombuffer(cells)
        things.setdefault(thing, []).append(ForeignColumn(label, quantity, values))
    for thing, label, quantity in found.ignored:
        things.setdefault(thing, []).append(ForeignColumn(label, quantity, nothing))
    lengths = [thing for thing, of in things.items() if of[0].quantity == "length"]
    for thing in lengths:
        metres = [column.values for column in things[thing]]
        things[thing] = placed(metres, how.axes or "xyz", f"{path}: {thing}")
    how.check_used(path, "ROS 2", *(["axes"] if lengths else []))
    return ForeignTable("a ROS 2 bag", (moments - moments[:1]) / _NS, things, merged=True)


def _stamps(path: Path, clocks: Mapping[str, _Moments]) -> dict[str, _Moments]:
    """Return the message times of each topic, ns; `clocks` alternates stamps and receipt times."""
    stamps: dict[str, _Moments] = {}
    received: list[int] = []
    for topic, clock in clocks.items():
        stamp, reception = clock[::2], clock[1::2]
        none = int(np.sum(stamp == 0))
        if 0 < none < len(stamp) and stamp.max() > _SINCE_1970:
            raise InputError(
                f"{path}: {none} of {len(stamp)} messages of {topic} have no time stamp, but the "
                f"others have one: correct the time stamps, or exclude the topic with --ignore "
                f"'{topic}*'"
            )
        stamps[topic] = reception if none == len(stamp) else stamp
        received += [int(reception.min()), int(reception.max())]
    spans = {topic: (int(each.min()), int(each.max())) for topic, each in stamps.items()}
    whole = (min(received, default=0), max(received, default=0))
    length = max(last - first for first, last in [whole, *spans.values()])
    latest = -_MOMENTS
    for topic, later in pairwise(sorted(spans, key=spans.__getitem__)):
        latest = max(latest, spans[topic][1])
        if (gap := spans[later][0] - latest) > length:
            raise InputError(
                f"{path}: the clocks of {topic} and {later} differ by {gap / _NS:.6g} s, but the "
                f"bag lasts only {length / _NS:.6g} s: correct the time stamps, or exclude one "
                f"topic, for example with --ignore '{later}*'"
            )
    return stamps


# The messages of a bag and their contents.


class _Topic(NamedTuple):
    """A topic, the type of its messages, and the definition of this type if the bag has it."""

    name: str
    kind: str
    form: str
    definition: str


def _said_of(topics: Collection[_Topic]) -> str:
    """Describe the topics of a bag that contains no usable numbers."""
    known = [each for each in topics if each.kind in _MESSAGES]
    ros_1 = [each for each in topics if each.form == "ros1"]
    listed = some([f"{each.name} ({each.kind})" for each in known or ros_1 or topics])
    if known:
        return (
            f"has no messages, or only empty messages, on the topics {listed}: record these "
            "topics again"
        )
    if ros_1:
        return f"has ROS 1 messages ({listed}): convert the .bag file with rosbags-convert"
    return (
        f"has no messages of the types {', '.join(_MESSAGES)} (its topics: {listed or 'none'}): "
        "give another bag"
    )


@dataclass
class _Found:
    """The numbers found in the messages of a bag so far.

    Attributes:
        how: settings that specify what is ignored.
        topics: all topics, including those with other message types.
        read: topic -> True if its messages are read, False if the whole topic is ignored.
        clocks: topic -> message type, and alternately time stamps and receipt times, ns.
        series: (topic, thing, label, quantity) -> message numbers and values.
        ignored: (thing, label, quantity) of the series of topics that are ignored as a whole.
    """

    path: Path
    store: Any
    how: ImportSettings
    topics: dict[_Topic, None] = field(default_factory=dict)
    read: dict[_Topic, bool] = field(default_factory=dict)
    clocks: dict[str, tuple[str, array]] = field(default_factory=dict)
    series: dict[tuple[str, str, str, str], tuple[array, array]] = field(default_factory=dict)
    ignored: dict[tuple[str, str, str], None] = field(default_factory=dict)
    numbers: int = 0
    numbers_ignored: int = 0

    def add(self, topic: _Topic, received: Any, data: bytes) -> None:
        """Add a message; if its topic is ignored as a whole, only the names in it are used."""
        what = f"a message of {topic.name} in {self.path}"
        if topic not in self.read:
            below = ImportSettings(ignore=[each for each in self.how.ignore if each[-1:] == "*"])
            self.read[topic] = self.how.keeps(topic.name) or below.keeps(f"{topic.name}/")
            if self.read[topic]:
                self._check(topic)
        if not self.read[topic]:
            self._add_names(topic, data, what)
            return
        if not (type(received) is int and 0 <= received < _MOMENTS):
            raise InputError(
                f"{what} has the receipt time {shown(received)}: give this time in ns since 1970"
            )
        self._count(2)  # the stamp and the receipt time, so that empty messages count, too
        message = self._message(topic, data, what)
        stamp = message.header.stamp
        _, clock = self.clocks[topic.name]
        number = len(clock) // 2
        clock.extend((stamp.sec * _NS + stamp.nanosec, received))
        for thing, label, quantity, value in _MESSAGES[topic.kind](topic.name, message):
            self._count(1)
            key = (topic.name, thing, label, quantity)
            if key not in self.series:
                _check_name(self.path, thing, len(self.series), "series")
                self.series[key] = array("q"), array("d")
            numbers, values = self.series[key]
            if numbers and numbers[-1] == number:
                raise InputError(f"{what} contains {thing} twice: rename one")
            if abs(value) > VALUE:
                raise InputError(
                    f"{self.path}: {thing} is {value:g} in a message, but must be at most "
                    f"{VALUE:g} in magnitude: correct the value, or exclude the topic with "
                    f"--ignore '{topic.name}*'"
                )
            numbers.append(number)
            values.append(value)

    def _add_names(self, topic: _Topic, data: bytes, what: str) -> None:
        if self.numbers_ignored < BAG_NUMBERS:
            self.numbers_ignored += 2 + len(data) // 8
            with contextlib.suppress(InputError):
                for cell in _MESSAGES[topic.kind](topic.name, self._message(topic, data, what)):
                    if cell[:3] not in self.ignored:
                        _check_name(self.path, cell.thing, len(self.ignored), "series")
                        self.ignored[cell[:3]] = None

    def _check(self, topic: _Topic) -> None:
        """Refuse a topic whose encoding, type or definition is not as expected."""
        what = f"{self.path}: messages of {topic.name}"
        if topic.form != "cdr":
            raise InputError(
                f"{what} are encoded as {shown(topic.form)}, but must be encoded as cdr: record "
                f"them in this encoding"
            )
        kind, _ = self.clocks.setdefault(topic.name, (topic.kind, array("q")))
        if kind != topic.kind:
            raise InputError(
                f"{what} are of two types, {kind} and {topic.kind}: record each type in its own "
                f"topic"
            )
        self._count(len(topic.definition))  # a character takes as long to process as a number
        known = dict(_fields(kind, self.store.generate_msgdef(kind, ros_version=2)[0]))
        for part, fields in _fields(kind, topic.definition):
            if fields and fields != known.get(part, fields):
                raise InputError(
                    f"{what} have a {part} that differs from the ROS 2 definition, "
                    f"{shown(', '.join(known[part]))}: record them with the ROS 2 definition"
                )

    def _count(self, numbers: int) -> None:
        self.numbers += numbers
        if self.numbers > BAG_NUMBERS:
            raise InputError(f"{self.path} has more than {BAG_NUMBERS:,} numbers: split the bag")

    def _message(self, topic: _Topic, data: bytes, what: str) -> Any:
        if len(data) > MESSAGE_BYTES:
            raise InputError(
                f"{what} has more than {MESSAGE_BYTES:,} bytes: exclude the topic with --ignore"
                f" '{topic.name}*'"
            )
        with tried(f"reading {what}"):
            return self.store.deserialize_cdr(data, topic.kind)


def _check_name(path: Path, name: str, before: int, what: str) -> None:
    """Refuse a name that cannot be printed, and any name once there are too many."""
    if len(name) > CELL_BYTES or not name.isprintable():
        raise InputError(
            f"{path}: {shown(name)} is not a valid name: it may have at most {CELL_BYTES:,} "
            "printable characters"
        )
    if before >= COLUMNS:
        raise InputError(f"{path} has more than {COLUMNS:,} {what}: record fewer topics")


def _fields(kind: str, definition: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each message type of a definition with the types and names of its fields."""
    for section in re.split(r"^=+$", definition, flags=re.MULTILINE):
        lines = [line.partition("#")[0].split() for line in section.splitlines()]
        lines = [line for line in lines if line]
        if lines and lines[0][0] == "MSG:":
            kind, lines = lines[0][-1], lines[1:]
        fields = [" ".join([line[0].rpartition("/")[2], *line[1:2]]) for line in lines]
        yield kind.rpartition("/")[2], fields


# Files of a bag.

_ZSTD = b"\x28\xb5\x2f\xfd"  # start of zstd-compressed data; no message starts with these bytes
_PACKED = {"lz4": ["lz4.frame"], "zstd": ["compression.zstd", "backports.zstd", "zstandard"]}
_Messages = Generator[tuple[_Topic, Any, bytes], None, None]


def _messages(path: Path, topics: dict[_Topic, None]) -> _Messages:
    """Yield topic, receipt time (ns) and data of messages of known types; record all topics."""
    for part in _files(path) if path.is_dir() else [path]:
        with _reading(part), contextlib.ExitStack() as stack:
            file = stack.enter_context(opened(part))
            unpacking = _Unpacking(part, file.seek(0, io.SEEK_END))
            file.seek(0)
            name = part.name.removesuffix(".zstd")
            if name != part.name:
                folder = tempfile.TemporaryDirectory(prefix="giajax-", ignore_cleanup_errors=True)
                part = Path(stack.enter_context(folder), name)
                unpacking.to_file(file, part)
            read = _database if name.lower().endswith(".db3") else _mcap
            for topic, received, data in read(part, topics, unpacking):
                packed = data[: len(_ZSTD)] == _ZSTD
                yield topic, received, unpacking.unpacked(data, "zstd") if packed else data


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn any error that occurs while a file is read into an error of one sentence."""
    try:
        with tried(f"reading {path}"):
            yield
    except InputError as error:
        cause = error.__cause__
        if isinstance(cause, KeyError):
            says = (
                f"has records that refer to {cause}, which is not a channel or schema of the "
                f"file: copy the file again"
            )
        elif getattr(cause, "errno", None) == errno.ENOSPC:
            says = (
                f"cannot be decompressed, because no space is left in {tempfile.gettempdir()}: "
                f"set TMPDIR to another folder"
            )
        elif getattr(cause, "sqlite_errorname", "") == "SQLITE_INTERRUPT":
            says = "takes much longer to read than is usual for its size: record it again"
        else:
            raise
        raise InputError(f"{path} {says}") from None


_LISTED = re.compile(r"^ *relative_file_paths: *\n((?: *- .*(?:\n|\Z))+)", re.MULTILINE)


def _files(folder: Path) -> list[Path]:
    """Return the files of a bag in order, as listed in the `metadata.yaml` that ROS writes.

    No other key of this file is needed. A YAML reader is not used, because with it a short text can
    expand to a very long one.
    """
    path = folder / "metadata.yaml"
    text = read_text(path, TEXT_BYTES, "YAML", "the folder of a bag, or a file in it")
    listed = _LISTED.findall(text.replace("\r\n", "\n"))
    lines = listed[0].splitlines() if len(listed) == 1 else []
    # Earlier versions write the folder in front of the name, but the folder may have been renamed.
    names = [PurePath(line.partition("- ")[2].strip().strip("'\"")).name for line in lines]
    if not names or not all(name.removesuffix(".zstd").endswith(_SUFFIXES) for name in names):
        raise InputError(
            f"{path} must contain relative_file_paths once, followed by `- name.db3` or "
            "`- name.mcap` for each file: recreate it with ros2 bag reindex, or give one file of "
            "the bag"
        )
    return [folder / name for name in names]


class _Unpacking:
    """Decompress the data of a file, within limits on the size of the result."""

    def __init__(self, path: Path, size: int) -> None:
        self._path, self.size = path, size
        self._left = UNPACKED_TIMES * size + UNPACKED_BYTES

    def unpacked(self, data: bytes, form: str, size: int | None = None) -> bytes:
        """Return the decompressed data, which must have the given size, if any."""
        if not form:
            return data
        most = min(self._left, CHUNK_BYTES)
        if size is None or size <= most:
            with self._opened(io.BytesIO(data), form) as file:
                found = file.read((most if size is None else size) + 1)
            if size is not None and len(found) != size:
                raise InputError(
                    f"{self._path} has a chunk whose size differs from the specified {size:,} "
                    "bytes: copy the file again"
                )
            size = len(found)
        self._take(size, most)
        return found

    def to_file(self, packed: BinaryIO, path: Path) -> None:
        """Decompress a whole file into another file."""
        with path.open("xb") as out, self._opened(packed, "zstd") as file:
            while block := file.read(1 << 20):
                self._take(len(block), self._left)
                out.write(block)
        self.size = path.stat().st_size

    def _take(self, size: int, most: int) -> None:
        self._left -= size
        if size > most or self._left < 0:
            raise InputError(
                f"{self._path} decompresses to more than {UNPACKED_TIMES} times its size, or has "
                f"chunks of more than {CHUNK_BYTES:,} bytes: record it without compression"
            )

    def _opened(self, file: BinaryIO, form: str) -> Any:
        for name in _PACKED.get(form, ()):
            with contextlib.suppress(ImportError):
                return importlib.import_module(name).open(file, "rb")
        raise InputError(
            f"{self._path} is compressed with {shown(form)}: the compression must be zstd, lz4 or "
            f"none"
        )


# MCAP: https://mcap.dev/spec. Records are read in sequence; the positions that a summary gives are
# not used.

_Records = Iterator[tuple[int, io.BytesIO]]  # operation codes and contents of records
_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _STATISTICS, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0B, 0x0F
_READ = (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _STATISTICS, _DATA_END)


def _mcap(path: Path, topics: dict[_Topic, None], unpacking: _Unpacking) -> _Messages:
    """Yield the messages of an MCAP file."""
    schemas = {0: ("", "")}  # number -> message type and its definition
    channels: dict[int, _Topic] = {}
    count = 0
    with opened(path) as file:
        end = file.seek(0, io.SEEK_END) - len(_MAGIC)
        file.seek(max(end, 0))
        last = file.read()
        file.seek(0)
        if file.read(len(_MAGIC)) != _MAGIC or last != _MAGIC or end < 2 * len(_MAGIC):
            raise InputError(
                f"{path} is not a complete MCAP file: copy it again, or use mcap recover"
            )
        for code, record in _unchunked(path, file, end, unpacking):
            if code == _STATISTICS and (said := _number(record, 8)) != count:
                raise InputError(
                    f"{path} has {count:,} messages, but its statistics give {said:,}: copy it "
                    "again"
                )
            number = _number(record, 2)
            if code == _SCHEMA:
                kind, form = _text(record), _text(record)
                schemas[number] = kind, _text(record) if form == "ros2msg" else ""
            elif code == _CHANNEL:
                kind, definition = schemas[_number(record, 2)]
                topic = _Topic(_text(record), kind, _text(record), definition)
                if channels.setdefault(number, topic) != topic:  # the summary repeats all channels
                    raise InputError(f"{path} uses channel {number} for two topics: copy it again")
                _know(path, topic, topics)
            elif code == _MESSAGE:
                count += 1
                topic = channels[number]
                if topic.kind in _MESSAGES:
                    _number(record, 4)  # sequence number of the message
                    received, _ = _number(record, 8), _number(record, 8)
                    yield topic, received, record.read()


def _unchunked(path: Path, file: BinaryIO, end: int, unpacking: _Unpacking) -> _Records:
    """Yield the relevant records, also from within chunks; after the data, only the summary."""
    data_ended = False
    for code, record in _records(path, file, end):
        if code == _CHUNK and not data_ended:
            record.seek(16)  # skip the times of the first and last message
            size, checksum, form = _number(record, 8), _number(record, 4), _text(record)
            data = unpacking.unpacked(record.read(_number(record, 8)), form, size)
            if checksum not in (0, zlib.crc32(data)):
                raise InputError(f"{path} has a damaged chunk: copy it again")
            for inner, each in _records(path, io.BytesIO(data), len(data)):
                if inner in (_SCHEMA, _CHANNEL, _MESSAGE):
                    yield inner, each
        elif code == _DATA_END and not data_ended:
            data_ended, checksum, after = True, _number(record, 4), file.tell()
            found, left = 0, after - 9 - record.getbuffer().nbytes if checksum else 0
            file.seek(0)
            while block := file.read(min(left, 1 << 20)):
                found, left = zlib.crc32(block, found), left - len(block)
            if found != checksum:
                raise InputError(f"{path} has damaged data: copy it again")
            file.seek(after)
        elif code not in (_CHUNK, _MESSAGE, _DATA_END) or not data_ended:
            yield code, record


def _records(path: Path, file: BinaryIO, end: int) -> _Records:
    """Yield the records that are read, and skip all others."""
    while (at := file.tell()) < end:
        code, size = _number(file, 1), _number(file, 8)
        if code == 0 or size > end - at - 9 or (code in _READ and size > CHUNK_BYTES):
            raise InputError(
                f"{path} is truncated, or has a record of more than {CHUNK_BYTES:,} bytes: copy it "
                "again, or use mcap recover"
            )
        if code in _READ:
            yield code, io.BytesIO(file.read(size))
        else:
            file.seek(size, io.SEEK_CUR)


def _number(file: BinaryIO, size: int) -> int:
    data = file.read(size)
    if len(data) != size:
        raise EOFError("a record is too short")
    return int.from_bytes(data, "little")


def _text(file: BinaryIO) -> str:
    size = _number(file, 4)
    data = file.read(min(size, TEXT_BYTES))
    if len(data) != size:
        raise EOFError(f"a string of {size:,} bytes extends beyond the end of its record")
    return data.decode()


def _know(path: Path, topic: _Topic, topics: dict[_Topic, None]) -> None:
    """Add a topic to the known topics."""
    if topic not in topics:
        for name in (topic.name, topic.kind):
            _check_name(path, name, len(topics), "topics")
        topics[topic] = None


# SQLite. A table of a database may be a view, which runs code when it is read, and its pages may
# refer to each other in a cycle.

_STEPS, _STEPS_A_BYTE = 1_000_000, 4  # SQLite instructions; a row of 7 bytes takes about ten


def _database(path: Path, topics: dict[_Topic, None], unpacking: _Unpacking) -> _Messages:
    """Yield the messages of a database, without running any code that it contains."""
    for ending in ("-wal", "-journal"):
        log = path.with_name(path.name + ending)
        if log.exists() and log.stat().st_size:
            raise InputError(
                f"{path} is being written, or was not closed ({log.name} exists): stop the "
                "recording, or open and close the file with sqlite3"
            )
    steps = iter(range(10 + _STEPS_A_BYTE * unpacking.size // _STEPS))
    uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    with contextlib.closing(sqlite3.connect(uri, uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, CHUNK_BYTES)
        base.set_progress_handler(lambda: next(steps, None) is None, _STEPS)
        base.execute("PRAGMA trusted_schema = OFF")
        base.execute("PRAGMA ignore_check_constraints = ON")  # these can contain code, too
        definitions = dict[str, str]()
        for table in ("topics", "messages", "message_definitions"):
            query = "SELECT type, rootpage > 0 FROM sqlite_master WHERE name = ? COLLATE NOCASE"
            found = base.execute(query, [table]).fetchall()
            if not found and table == "message_definitions":  # ROS 2 before 2023 has no such table
                continue
            hidden = base.execute(f"SELECT max(hidden) FROM pragma_table_xinfo('{table}')")
            if found != [("table", 1)] or hidden.fetchone()[0]:
                raise InputError(f"{path} has no ordinary table {table}: give a ROS 2 bag")
            if (said := base.execute(f"PRAGMA quick_check({table})").fetchone()[0]) != "ok":
                raise InputError(f"{path} is damaged ({shown(said)}): copy it again")
            if table == "message_definitions":
                query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
                for kind, text in base.execute(f"{query} WHERE encoding = 'ros2msg'"):
                    if kind in _MESSAGES and definitions.setdefault(kind, str(text)) != str(text):
                        raise InputError(f"{path} has two definitions of {kind}: copy it again")
        numbers: dict[int, _Topic] = {}
        query = "SELECT id, name, type, serialization_format FROM topics"
        for number, *words in base.execute(query):
            named = type(number) is int and all(isinstance(word, str) for word in words)
            if not named or number in numbers:
                raise InputError(
                    f"{path} contains a topic twice, or a topic without a name: copy it again"
                )
            numbers[number] = _Topic(words[0], words[1], words[2], definitions.get(words[1], ""))
            _know(path, numbers[number], topics)
        query = "SELECT count(*) FROM messages WHERE topic_id NOT IN (SELECT id FROM topics)"
        if lost := base.execute(query).fetchone()[0]:
            raise InputError(f"{path} has {lost:,} messages that belong to no topic: copy it again")
        known = [str(number) for number, topic in numbers.items() if topic.kind in _MESSAGES]
        query = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN"
        for number, received, data in base.execute(f"{query} ({','.join(known)})"):
            if not isinstance(data, bytes):
                raise InputError(f"{path} has a message without data: copy it again")
            yield numbers[number], received, data
