"""Bags as written by ROS 2, read without ROS; and two commands from a bag to a fit."""

import os
import sqlite3
import struct
import sys
import tempfile
import zlib
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from giajax import InputError, Run, load_result, model_for, predict
from giajax.cli import main
from giajax.recordings import ImportSettings, channels_of, read_foreign, rows_kept

STORE = get_typestore(Stores.ROS2_HUMBLE)
BEGAN = 1_700_000_000  # s since 1970, as in the clocks of robots


def of(kind):
    return STORE.types[kind]


def header(time, frame=""):
    nanoseconds = round((BEGAN + time) * 1e9) if time is not None else 0
    stamp = of("builtin_interfaces/msg/Time")(*divmod(nanoseconds, 10**9))
    return of("std_msgs/msg/Header")(stamp, frame)


def joints(time, names, position=(), velocity=(), effort=()):
    lists = (np.array(each, dtype=float) for each in (position, velocity, effort))
    return of("sensor_msgs/msg/JointState")(header(time), list(names), *lists)


def poses(time, *points):
    still = of("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
    point = of("geometry_msgs/msg/Point")
    made = [of("geometry_msgs/msg/Pose")(point(*each), still) for each in points]
    return of("geometry_msgs/msg/PoseArray")(header(time), made)


def pose(time, point):
    return of("geometry_msgs/msg/PoseStamped")(header(time), poses(time, point).poses[0])


def inertial(time, gyro, accel, known=0.0):
    vector, nothing = of("geometry_msgs/msg/Vector3"), np.zeros(9)
    still = of("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
    covariance = np.r_[known, np.zeros(8)]
    return of("sensor_msgs/msg/Imu")(
        header(time), still, nothing, vector(*gyro), nothing, vector(*accel), covariance
    )


def write_bag(folder, topics, name="bag", plugin=StoragePlugin.SQLITE3):
    """Write a bag of (topic, time in the bag, message), and return its path."""
    path = folder / name
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, time, message in topics:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], round((BEGAN + time) * 1e9), data)
    return path


TOPICS = [
    ("/joint_states", 0.0, joints(0.0, ["shoulder", "elbow"], [0.1, 0.2], [1.0, 2.0])),
    ("/commands", 0.1, joints(None, ["shoulder"], [0.5])),
    ("/imu", 0.2, inertial(0.2, (1, 2, 3), (4, 5, 6))),
    ("/markers", 0.2, poses(0.2, (1, 2, 3), (4, 5, 6))),
    # Late in the bag and with one joint only, followed by a topic without stamps.
    ("/joint_states", 0.6, joints(0.5, ["elbow"], [0.3], [3.0], [7.0])),
    ("/commands", 0.7, joints(None, ["shoulder"], [1.1])),
    ("/tip", 0.8, pose(0.8, (7, 8, 9))),
]


@pytest.mark.quick
@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_what_is_in_a_bag(tmp_path, plugin):
    path = write_bag(tmp_path, TOPICS, plugin=plugin)
    alone = [each for each in path.iterdir() if each.suffix == ".mcap"]
    for each in (path, *alone):
        table = read_foreign(each)
        parts = {
            "/joint_states/elbow": "joint02",
            "/joint_states/shoulder velocity": "joint01_rate",
            "/commands/shoulder": "joint01_command",
            "/imu": "imu03",
            "/markers/1": "link02",
            "/tip": "tip",
        }
        times, values = rows_kept(table, channels_of(table, parts), ImportSettings())
        np.testing.assert_allclose(times, [0, 0.1, 0.2, 0.5, 0.7, 0.8], atol=1e-9)
        nan = np.nan
        for name, expected in {
            "joint02_angle": [0.2, nan, nan, 0.3, nan, nan],
            "joint02_rate": [2, nan, nan, 3, nan, nan],
            "joint01_rate": [1, nan, nan, nan, nan, nan],
            "joint01_command": [0.5, 0.5, 0.5, 0.5, 1.1, 1.1],
            "imu03_gyro_y": [nan, nan, 2, nan, nan, nan],
            "imu03_accel_z": [nan, nan, 6, nan, nan, nan],
            "link02_x": [nan, nan, 4, nan, nan, nan],
            "tip_z": [nan, nan, nan, nan, nan, 9],
        }.items():
            np.testing.assert_allclose(values[name], expected, err_msg=name)
        assert "joint02_torque" not in values
        effort = channels_of(table, {"/joint_states/elbow effort": "joint02_torque"})
        np.testing.assert_allclose(effort["joint02_torque"][3], 7)
    turned = channels_of(
        read_foreign(path, ImportSettings(axes=("x", "z", "-y"))), {"/markers/0": "tip"}
    )
    np.testing.assert_allclose([turned[f"tip_{axis}"][2] for axis in "xyz"], [1, -3, 2])


@pytest.mark.quick
def test_a_sensor_that_is_not_there_is_no_channel(tmp_path):
    path = write_bag(tmp_path, [("/imu", 0.0, inertial(0.0, (1, 2, 3), (0, 0, 0), known=-1.0))])
    assert set(channels_of(read_foreign(path), {"/imu": "imu01"})) == {
        f"imu01_gyro_{axis}" for axis in "xyz"
    }


@pytest.mark.quick
def test_messages_of_a_bag_have_one_clock_and_none_is_lost(tmp_path):
    """The clock of an ignored topic does not matter."""
    tip = [("/tip", time, pose(time, (time, 0, 0))) for time in (0.0, 0.5, 1.0)]
    turn = {"/cmd/a": "joint01_command", "/tip": "tip"}
    for number, (wrong, says) in enumerate([
        ([(0.0, 0.0), (0.5, None)], "1 of 2 messages of /cmd have no time stamp"),
        ([(0.0, 0.2), (0.4, 0.2), (0.5, 0.2), (0.6, 0.7)], "2 of 4 messages of /cmd have the same"),
        ([(0.0, -BEGAN + 5.0)], "the clocks of /cmd and /tip differ by 1.7e+09 s, but the"),
        ([(0.0, 90.0), (0.5, 90.5)], "the clocks of /tip and /cmd differ by 89 s, but the bag las"),
    ]):  # fmt: skip
        commands = [("/cmd", at, joints(time, ["a"], [at])) for at, time in wrong]
        path = write_bag(tmp_path, sorted([*tip, *commands], key=lambda each: each[1]), f"{number}")
        with pytest.raises(InputError) as caught:
            read_foreign(path)
        assert says in str(caught.value)
        assert "--ignore '/" in str(caught.value)
        how = ImportSettings(ignore=["/cmd*"])
        table = read_foreign(path, how)
        times, values = rows_kept(table, channels_of(table, turn, how=how), how)
        np.testing.assert_allclose(times, [0, 0.5, 1])
        np.testing.assert_allclose(values["tip_x"], [0, 0.5, 1])
    # A simulation starts at 0, and is recorded faster than real time.
    fast = [("/cmd", at, joints(10 * at - BEGAN, ["a"], [at])) for at in (0.0, 0.5, 1.0)]
    table = read_foreign(write_bag(tmp_path, fast, "fast"))
    np.testing.assert_allclose(table.times, [0, 5, 10])


@pytest.mark.quick
def test_a_bad_bag_is_one_sentence(tmp_path, monkeypatch):
    path = write_bag(tmp_path, TOPICS[:1], plugin=StoragePlugin.MCAP)
    write_bag(tmp_path, [("/talk", 0.0, of("std_msgs/msg/String")("hello"))], "other")
    (tmp_path / "empty").mkdir()
    (tmp_path / "torn.mcap").write_bytes(next(path.glob("*.mcap")).read_bytes()[:200])
    (tmp_path / "text.db3").write_text("time_s\n0\n")
    for name, how, says in [
        ("other", {}, "(its topics: /talk (std_msgs/msg/String)): give another bag"),
        ("empty", {}, "metadata.yaml does not exist"),
        ("torn.mcap", {}, "is not a complete MCAP file"),
        ("text.db3", {}, "file is not a database"),
        ("gone.mcap", {}, "gone.mcap fails (FileNotFoundError"),
        ("bag", {"axes": ("x", "-y")}, "--axes has no effect on this table of ROS 2: omit it"),
        ("bag", {"frame_rate": 5.0}, "a bag contains its own time stamps: omit --frame-rate"),
    ]:
        with pytest.raises(InputError) as caught:
            read_foreign(tmp_path / name, ImportSettings(**how))
        assert says in str(caught.value)
        assert "\n" not in str(caught.value)
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(InputError, match=r"not installed: .*pip install .*\[ros\]"):
        read_foreign(path)


# Invalid bags.

MCAP = b"\x89MCAP0\r\n"
JOINTS, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
DEFINITION = STORE.generate_msgdef(JOINTS, ros_version=2)[0]


def zstd(data):
    return zstandard.ZstdCompressor(level=1).compress(data)


def record(code, *parts):
    """Return an MCAP record; texts are preceded by their length."""
    parts = [p if isinstance(p, bytes) else struct.pack("<I", len(p)) + p.encode() for p in parts]
    data = b"".join(parts)
    return bytes([code]) + struct.pack("<Q", len(data)) + data


def mcap(*records, end=b"", checked=False):
    """Return a file of these records, with a checksum of its data if `checked`."""
    data = MCAP + record(1, "ros2", "test") + b"".join(records)
    checksum = struct.pack("<I", zlib.crc32(data) if checked else 0)
    return data + record(15, checksum) + end + record(2, bytes(20)) + MCAP


def topic(definition=DEFINITION, form="cdr", number=1, name="/j", kind=JOINTS, said="ros2msg"):
    """Return a schema and a channel with this number."""
    number = struct.pack("<H", number)
    return record(3, number, kind, said, definition) + record(
        4, number, number, name, form, b"\0\0\0\0"
    )


def told(time, *lists, at=None, data=None, number=1):
    """Return a message as a record."""
    at = round((BEGAN + time) * 1e9) if at is None else at
    data = bytes(STORE.serialize_cdr(joints(time, *lists), JOINTS)) if data is None else data
    return record(5, struct.pack("<HIQQ", number, 0, at, at), data)


def chunk(data, form="zstd", size=None):
    packed = {"zstd": zstd, "lz4": lz4.frame.compress}[form](data)
    size = len(data) if size is None else size
    return record(
        6, struct.pack("<QQQI", 0, 0, size, 0), form, struct.pack("<Q", len(packed)), packed
    )


GOOD = told(0, ["a"], [1.0]) + told(1, ["a"], [2.0])
DATA = bytes(STORE.serialize_cdr(joints(0.0, ["a"], [1.0]), JOINTS))
TURNED = (
    DEFINITION.replace("velocity", "x").replace("position", "velocity").replace("x", "position")
)
# 16 definitions of 1,048,000 characters for 16 topics with one message each, then empty messages.
LONG = b"".join(
    topic(DEFINITION.ljust(1_048_000, "#"), number=n, name=f"/j{n}")
    + told(0, ["a"], [1.0], number=n)
    for n in range(1, 17)
)
EMPTY = told(0, [])
ENDLESS = (
    "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT x AS id, 1 AS topic_id,"
    " x AS timestamp, zeroblob(1000) AS data FROM c"
)
FILES = {
    "decompresses to more than 100 times": mcap(topic(), chunk(bytes(1 << 25)), GOOD),
    "has chunks of more than 134,217,728 bytes": mcap(topic(), chunk(b"", size=1 << 40), GOOD),
    "differs from the specified 100 bytes": mcap(topic(), chunk(bytes(1 << 25), size=100), GOOD),
    "is compressed with 'tars'": mcap(topic(), chunk(GOOD).replace(b"zstd", b"tars")),
    "is truncated": mcap(topic(), b"\x05" + b"\xff" * 8, GOOD),
    "is not a complete MCAP file": mcap(topic(), GOOD)[:-30],
    "has 2 messages, but its statistics give 5": mcap(
        topic(), GOOD, end=record(11, struct.pack("<QHIIIIQQ", 5, 1, 1, 0, 0, 0, 0, 1), bytes(4))
    ),
    "uses channel 1 for two topics": mcap(topic(), GOOD, end=topic().replace(b"/j", b"/k")),
    "has records that refer to 7, which is not a channel or "
    "schema": mcap(topic(), told(0, [], number=7)),
    "has records that refer to 9, which is not a channel": mcap(
        record(4, b"\1\0\x09\0", "/j", "cdr", bytes(4)), GOOD
    ),
    "more than 10,000 series": mcap(topic(), *(told(i, [f"n{i}"], [1.0]) for i in range(10_001))),
    "'/j/a\\x1b[2J\\nb' is not a valid name": mcap(topic(), told(0, ["a\x1b[2J\nb"], [1.0])),
    "is not a valid name: it may have at most 1,000 printable": mcap(
        topic(), told(0, ["q" * 1_001], [1.0])
    ),
    "/j/a twice": mcap(topic(), told(0, ["a", "a"], [1.0, 2.0])),
    "has 2 names but 1 values of position": mcap(topic(), told(0, ["a", "b"], [1.0])),
    "/j/a is inf in a message": mcap(topic(), told(0, ["a"], [np.inf])),
    "has the receipt time 18446744073709551615": mcap(topic(), told(0, ["a"], [1.0], at=2**64 - 1)),
    "have a JointState that differs from the ROS 2 definition": mcap(topic(TURNED), GOOD),
    "of /j have a JointState that differs": mcap(
        topic(), GOOD, topic(TURNED, number=2), told(2, ["a"], number=2)
    ),
    "a JointState that differs from": mcap(topic(f"JointState[] more\n{DEFINITION}"), GOOD),
    "but must be encoded as cdr": mcap(topic(form="json"), GOOD),
    "are encoded as 'json', but": mcap(
        topic(), GOOD, topic(form="json", number=2), told(2, [], number=2)
    ),
    f"messages of /j are of two types, {JOINTS} and {POSE}": mcap(
        topic(), GOOD, topic("", number=2, kind=POSE), told(2, ["a"], number=2)
    ),
    "reading a message of /j in": mcap(topic(), told(0, data=DATA[:20] + b"\xff" * 4 + DATA[24:])),
    "has more than 4,194,304 bytes": mcap(topic(), chunk(told(0, data=DATA.ljust(1 << 22) + DATA))),
    "has more than 16,777,216 numbers": mcap(chunk(LONG + 5_000 * EMPTY)),
    "has ROS 1 messages (/j (sensor_msgs/JointState)): convert": mcap(
        topic("", form="ros1", kind="sensor_msgs/JointState", said="ros1msg"), GOOD
    ),
    f"has no messages, or only empty messages, on the topics /j "
    f"({JOINTS})": mcap(topic(), told(0, [])),
    "has damaged data": mcap(topic(), GOOD, checked=True).replace(b"\xf0\x3f", b"\xf0\x3e"),
}  # fmt: skip
SCRIPTS = {
    "has no ordinary table messages": f"DROP TABLE messages; CREATE VIEW messages AS {ENDLESS}",
    "no ordinary table messages": "DROP TABLE messages; CREATE TABLE messages(id, topic_id, "
    "timestamp,"
    " data AS (zeroblob(900000000)))",
    "no ordinary table message_definitions": "DROP TABLE message_definitions; CREATE VIEW"
    f" message_definitions AS SELECT '{JOINTS}' AS topic_type, 'ros2msg' AS encoding, hex(data) AS"
    f" encoded_message_definition FROM ({ENDLESS})",
    "ordinary table message_definitions": "DROP TABLE message_definitions; CREATE TABLE"
    f" Message_Definitions(topic_type, encoding, encoded_message_definition AS (hex(topic_type)));"
    f" INSERT INTO message_definitions VALUES ('{JOINTS}', 'ros2msg')",
    f"two definitions of {JOINTS}": "INSERT INTO message_definitions SELECT 9, topic_type,"
    f" encoding, 'float64 x', '' FROM message_definitions WHERE topic_type = '{JOINTS}'",
    f"messages of /j are of two types, {JOINTS} and {POSE}": "INSERT INTO topics SELECT 9, name,"
    f" '{POSE}', 'cdr', '', '' FROM topics LIMIT 1; UPDATE messages SET topic_id = 9 WHERE id = 2",
    "are encoded as 'json', but must be encoded as cdr": "INSERT INTO topics SELECT 9, name, type,"
    " 'json', '', '' FROM topics LIMIT 1; UPDATE messages SET topic_id = 9 WHERE id = 2",
    "contains a topic twice": "ALTER TABLE topics RENAME TO t; CREATE TABLE topics AS SELECT * "
    "FROM t;"
    " INSERT INTO topics SELECT * FROM t",
    # Columns that are absent from all rows, and none of which may be empty.
    "takes much longer to read than is usual for its size": "DROP TABLE messages; CREATE TABLE "
    "messages(id,"
    " topic_id, timestamp, data); WITH RECURSIVE c(x) AS (SELECT 9 UNION ALL SELECT x + 1 FROM c"
    " WHERE x < 20000) INSERT INTO messages SELECT x, 1, 0, x'' FROM c;"
    " PRAGMA writable_schema = ON; UPDATE sqlite_master SET sql = 'CREATE TABLE messages(id,"
    " topic_id, timestamp, data, "
    + ", ".join(f"c{n} NOT NULL DEFAULT 0" for n in range(1_500))
    + ")' WHERE name = 'messages'",
    "1 messages that belong to no topic": "UPDATE messages SET topic_id = 9 WHERE id = 2",
    "has the receipt time 'soon'": "UPDATE messages SET timestamp = 'soon'",
    "has a message without data": "UPDATE messages SET data = 'hello'",
    "too big": "UPDATE messages SET data = zeroblob(300000000) WHERE id = 1",
    "more than 10,000 topics": "WITH RECURSIVE c(x) AS (SELECT 9 UNION ALL SELECT x + 1 FROM c"
    " WHERE x < 10010) INSERT INTO topics SELECT x, '/t' || x, 'a/b/C', 'cdr', '', '' FROM c",
}


@pytest.mark.quick
@pytest.mark.parametrize("says", FILES)
def test_a_hostile_file_is_one_sentence(tmp_path, says):
    path = tmp_path / "bag.mcap"
    path.write_bytes(FILES[says])
    with pytest.raises(InputError) as caught:
        read_foreign(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def database(folder, name="bag"):
    said = [("/j", time, joints(time, ["a"], [time])) for time in (0.0, 1.0)]
    path = write_bag(folder, said, name)
    return path, path / f"{name}.db3"


@pytest.mark.quick
@pytest.mark.parametrize("says", SCRIPTS)
def test_a_hostile_database_is_one_sentence(tmp_path, says):
    path, file = database(tmp_path)
    base = sqlite3.connect(file)
    base.executescript(SCRIPTS[says])
    base.close()
    with pytest.raises(InputError) as caught:
        read_foreign(path)
    assert says in str(caught.value)


@pytest.mark.quick
def test_pages_of_a_database_that_are_in_each_other_end(tmp_path):
    """The root has 300 children with 300 children each, and so on: 2e17 rows in a file of 60 kB."""
    path, file = database(tmp_path)
    base = sqlite3.connect(file)
    (size,), (root,) = (
        base.execute(query).fetchone()
        for query in (
            "PRAGMA page_size",
            "SELECT rootpage FROM sqlite_master WHERE name = 'messages'",
        )
    )
    base.close()
    data = bytearray(file.read_bytes())
    leaf = bytes(data[(root - 1) * size : root * size])
    pages = len(data) // size
    for level in range(8):
        child = struct.pack(">I", pages + 1 + level)
        body = size - 5 * 300
        page = bytearray(b"\5\0\0" + struct.pack(">HH", 300, body) + b"\0" + child).ljust(
            size, b"\0"
        )
        page[12:612] = b"".join(struct.pack(">H", body + 5 * n) for n in range(300))
        page[body:] = (child + b"\1") * 300
        place = root - 1 if level == 0 else pages + level - 1
        data[place * size : (place + 1) * size] = page
    data += leaf
    data[28:32] = struct.pack(">I", len(data) // size)
    file.write_bytes(data)
    with pytest.raises(InputError, match="is damaged"):
        read_foreign(path)


@pytest.mark.quick
def test_files_of_a_bag_are_in_its_folder_and_are_files(tmp_path):
    for number, (listed, says) in enumerate([
        ("- ../../etc/passwd", "must contain relative_file_paths once"),
        ("- ..", "must contain relative_file_paths once"),
        ("- ../bag/bag.db3", "6/bag.db3 fails (FileNotFoundError"),
        ("- bag.db3\nrelative_file_paths:\n- bag.db3", "must contain relative_file_paths once"),
        ("- gone.db3", "gone.db3 fails (FileNotFoundError"),
        ("- pipe.db3", "is a pipe, but must be a file"),
        ("- zero.db3", "is a device, but must be a file"),
    ]):  # fmt: skip
        path, _ = database(tmp_path, f"{number}")
        os.mkfifo(path / "pipe.db3")
        (path / "zero.db3").symlink_to("/dev/zero")
        about = path / "metadata.yaml"
        about.write_text(about.read_text().replace(f"- {number}.db3", listed))
        with pytest.raises(InputError) as caught:
            read_foreign(path)
        assert says.replace("6", str(number)) in str(caught.value)
    # A bag that is still being recorded is incomplete.
    path, _ = database(tmp_path)
    (path / "bag.db3-wal").write_bytes(b"more")
    with pytest.raises(InputError, match="was not closed"):
        read_foreign(path)


@pytest.mark.quick
def test_bags_may_be_packed_in_every_way(tmp_path):
    expected = channels_of(read_foreign(database(tmp_path)[0]), {"/j/a": "joint01"})
    assert list(expected["joint01_angle"]) == [0, 1]
    whole, file = database(tmp_path, "whole")
    (whole / "whole.db3.zstd").write_bytes(zstd(file.read_bytes()))
    file.unlink()
    about = whole / "metadata.yaml"
    about.write_text(about.read_text().replace("- whole.db3", "- 'whole/whole.db3.zstd'"))
    each, file = database(tmp_path, "each")
    base = sqlite3.connect(file)
    for number, data in base.execute("SELECT id, data FROM messages").fetchall():
        base.execute("UPDATE messages SET data = ? WHERE id = ?", [zstd(data), number])
    base.commit()
    base.close()
    each = each.rename(tmp_path / "each?mode=rwc#1")
    said = told(0, ["a"], [0.0]) + told(1, ["a"], [1.0])
    files = [tmp_path / f"{form}.mcap" for form in ("zstd", "lz4")]
    for path in files:
        path.write_bytes(mcap(topic(), chunk(said, path.stem)))
    for path in (whole, each, *files):
        found = channels_of(read_foreign(path), {"/j/a": "joint01"})
        np.testing.assert_array_equal(found["joint01_angle"], expected["joint01_angle"])


BIG_ENDIAN = STORE.serialize_cdr(joints(0, ["a"], [1.0]), JOINTS, little_endian=False)
LEGAL = {
    "checked": mcap(topic(), GOOD, checked=True),
    "message indexes": mcap(
        topic(),
        chunk(GOOD),
        record(7, b"\1\0", struct.pack("<IQQ", 16, BEGAN * 10**9, 0)),
        end=topic() + record(11, struct.pack("<QHIIIIQQ", 2, 1, 1, 0, 0, 1, 0, 1), bytes(4)),
    ),
    "an attachment, metadata and private records": mcap(
        record(0x80, b"\xff" * 99),
        topic(),
        record(9, bytes(16), "a.txt", "text/plain", struct.pack("<Q", 5), b"hello", bytes(4)),
        record(12, "about", bytes(4)),
        GOOD,
        record(0xFF),
    ),
    "big-endian": mcap(topic(), told(0, data=bytes(BIG_ENDIAN)), told(1, ["a"], [2.0])),
    "of several channels": mcap(
        topic(), topic(number=2), told(0, ["a"], [1.0]), told(1, ["a"], [2.0], number=2)
    ),
    "without a definition": mcap(topic("", said=""), GOOD),
}


@pytest.mark.quick
@pytest.mark.parametrize("what", LEGAL)
def test_bags_may_have_more_than_messages(tmp_path, what):
    path = tmp_path / "bag.mcap"
    path.write_bytes(LEGAL[what])
    found = channels_of(read_foreign(path), {"/j/a": "joint01"})
    assert list(found["joint01_angle"]) == [1, 2]


@pytest.mark.quick
def test_a_bag_may_have_two_files_of_which_each_is_checked(tmp_path):
    path = write_bag(tmp_path, TOPICS[:1], plugin=StoragePlugin.MCAP)
    about = path / "metadata.yaml"
    about.write_text(about.read_text().replace("- bag.mcap", "- bag.mcap\n  - more.mcap"))
    (path / "bag.mcap").write_bytes(mcap(topic(), told(0, ["a"], [1.0])))
    (path / "more.mcap").write_bytes(mcap(topic(), told(1, ["a"], [2.0])))
    found = channels_of(read_foreign(path), {"/j/a": "joint01"})
    assert list(found["joint01_angle"]) == [1, 2]
    (path / "more.mcap").write_bytes(mcap(topic(TURNED), told(1, ["a"], [2.0])))
    with pytest.raises(InputError, match="messages of /j have a JointState that differs"):
        read_foreign(path)


@pytest.mark.quick
def test_a_database_of_ros_2_before_it_kept_definitions(tmp_path):
    path, file = database(tmp_path)
    base = sqlite3.connect(file)
    base.executescript(
        "DROP TABLE message_definitions; DROP TABLE IF EXISTS schema;"
        " ALTER TABLE topics DROP COLUMN type_description_hash"
    )
    base.close()
    found = channels_of(read_foreign(path), {"/j/a": "joint01"})
    assert list(found["joint01_angle"]) == [0, 1]


@pytest.mark.quick
def test_what_is_ignored_is_not_counted(tmp_path):
    """Its series, numbers, sizes and times are not counted, only its names are."""
    path = tmp_path / "bag.mcap"
    others = topic(number=17, name="/k") + b"".join(
        told(n, ["a"], [float(n)], number=17) for n in (0, 1)
    )
    ignored = topic() + told(0, ["a"], [1.0])
    for more in (
        chunk(LONG + 5_000 * EMPTY),
        ignored + told(0, [f"n{n}" for n in range(10_001)], [0.0] * 10_001),
        ignored + chunk(told(0, data=DATA.ljust(1 << 22) + DATA)),
        ignored + told(0, [], at=2**64 - 1),
        ignored + topic(TURNED, number=2) + told(0, ["a"], [1.0], number=2),
    ):
        path.write_bytes(mcap(more, others))
        with pytest.raises(InputError):
            read_foreign(path)
        table = read_foreign(path, ImportSettings(ignore=["/j*"]))
        np.testing.assert_array_equal(table.times, [0, 1])
        assert list(channels_of(table, {"/k/a": "joint01"})["joint01_angle"]) == [0, 1]
        assert 0 < sum(name.startswith("/j") for name in table.things) <= 10_000
    # This much counts, but does not exceed the limit.
    path.write_bytes(mcap(chunk(LONG + 4_000 * EMPTY), others))
    assert "/j1/a" in read_foreign(path).things
    empty = topic(number=18, name="/i") + 5_000 * told(0, [], number=18)
    path.write_bytes(mcap(chunk(LONG + empty), others))
    assert "/j1/a" in read_foreign(path, ImportSettings(ignore=["/i*"])).things


@pytest.mark.quick
def test_files_are_unpacked_one_after_the_other_where_there_is_space(tmp_path, monkeypatch):
    path, file = database(tmp_path)
    file.unlink()
    about = path / "metadata.yaml"
    names = [f"{n}.mcap.zstd" for n in range(3)]
    about.write_text(about.read_text().replace("- bag.db3", "\n  ".join(f"- {n}" for n in names)))
    for n, name in enumerate(names):
        (path / name).write_bytes(zstd(mcap(topic(), told(n, ["a"], [float(n)]))))
    (tmp_path / "space").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "space"))
    opened, there = Path.open, []

    def counted(each, *words):
        there.append(len(list((tmp_path / "space").rglob("*.mcap"))))
        return opened(each, *words)

    monkeypatch.setattr(Path, "open", counted)
    found = channels_of(read_foreign(path), {"/j/a": "joint01"})
    assert list(found["joint01_angle"]) == [0, 1, 2]
    assert there == [0, 0, 0]
    monkeypatch.setattr(Path, "open", lambda *_: opened(Path("/dev/full"), "wb"))
    with pytest.raises(
        InputError,
        match=r"0\.mcap\.zstd cannot be decompressed, because no space is left in "
        r".*space: set",
    ):
        read_foreign(path)
    assert not list((tmp_path / "space").iterdir())


def test_two_commands_from_a_bag_to_a_fit(tmp_path, capsys):
    """A swing is recorded from the topic of a driver, and a fit finds its centre of mass."""
    times = np.arange(200) / 50
    arm = {"preset": "pendulum", "links": 1, "parameters": {"links.mass": 0.3}}
    truth = {**arm, "parameters": {**arm["parameters"], "links.centre_of_mass": 0.6}}
    about = {"arm": truth, "initial": {"angle_deg": [20.0]}}
    plan = Run.from_arrays(times, {"joint01_angle": np.zeros_like(times)}, definition=about)
    model = model_for([plan])
    seen = predict(model, plan)["joint01_angle"]
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(times))
    messages = [
        ("/joint_states", time, joints(time, ["pivot"], [angle]))
        for time, angle in zip(times, seen + noise, strict=True)
    ]
    bag = write_bag(tmp_path, messages, plugin=StoragePlugin.MCAP)
    fit = tmp_path / "fit.toml"
    fit.write_text(
        '[arm]\npreset = "pendulum"\nlinks = 1\n[arm.parameters]\n"links.mass" = 0.3\n'
        '[initial]\nfirst_row = true\nfree = true\n[fit]\ndata = ["run.csv"]\n'
        'free = ["links.centre_of_mass"]\n[fit.start]\n"links.centre_of_mass" = 0.75\n'
    )
    words = ["import", str(bag), "--point", "/joint_states/pivot=joint01"]
    assert main([*words, "--to", str(tmp_path / "run.csv")]) == 0
    assert "from a ROS 2 bag: 200 rows, 200 of 200 values found" in capsys.readouterr().out
    out = tmp_path / "result"
    assert main(["fit", str(fit), "--out", str(out), "--no-figures", "--no-suspects"]) == 0
    found = load_result(out).parameters["links.centre_of_mass[0]"]
    assert abs(found.value - 0.6) < 4 * found.standard_error < 0.02
