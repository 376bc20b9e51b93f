"""Inputs of all commands with seeded damage are read correctly or refused in one sentence.

A case is a valid command on small files, one of which is damaged, or with a damaged word. It must
end with a documented status and without a traceback, within seconds and a gigabyte. If the input is
read, it is compared with the result of the standard library. `make test` draws 300 cases, and the
tests marked `long` draw 3,000 others.
"""

import contextlib
import copy
import csv
import functools
import importlib
import io
import itertools
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import sqlite3
import time
import tomllib
import warnings
from pathlib import Path

import jax
import numpy as np
import polars as pl
import pytest
from rosbags.highlevel import AnyReader

from giajax.apps.driving import read_pad
from giajax.cli import main
from giajax.fitting import load_result
from giajax.recordings import Definition, read_table
from giajax.runtime.text import InputError
from giajax.tasks import Plan
from tests.recordings import test_bags, test_foreign

ROOT = Path(__file__).resolve().parents[1]
EARLIER = ROOT / "tests" / "earlier"
MOST_SECONDS, MOST_BYTES = 5.0, 1 << 30
STATM, STATUS, REFERENCES = (
    Path("/proc/self") / name for name in ("statm", "status", "clear_refs")
)

pytestmark = pytest.mark.skipif(
    not (REFERENCES.exists() and os.access(REFERENCES, os.W_OK)),
    reason="needs to see how much memory a case takes",
)

FILM = (
    "scorer,net,net,net,net,net,net\n"
    "bodyparts,elbow,elbow,elbow,end,end,end\n"
    "coords,x,y,likelihood,x,y,likelihood\n"
    "0,403.8,520.2,0.88,393.5,528.2,0.84\n1,404.5,521.0,0.31,394,529,0.99\n2,405,522,0.99,,,\n"
)
TRACKS = '"Time","m/0/X","m/0/Y"\r\n"0","100.5","20.25"\r\n"0.04","101","21"\r\n'
PAD = (
    "[pad]\ndead_zone = 0.1\naxes = [{axis = 1, joints = [1, 2], rate_deg_per_s = -3.0}]\n"
    'buttons = [{button = 0, preset = "up"}]\n'
    'presets = [{name = "up", joints = [1], angles_deg = [20.0], others_deg = 0.0}]\n'
)
ARM = "[arm]\npreset = 'takeichi_20m'\nlinks = 2\n[initial]\nangle_deg = 5.0\n"
ROLL = '[arm]\nlinks = 2\n[unrolling]\norder = "by gas"\nroll_radius_mm = 80.0\n'
ROBOT = (
    "<mujoco><worldbody><body name='a'><joint type='hinge' axis='0 1 0'/>"
    "<geom type='capsule' fromto='0 0 0 1 0 0' size='0.1' mass='0.1'/></body></worldbody></mujoco>"
)
FAST = "--no-figures --force --quiet --max-iterations 1 --no-suspects"

# Tables of other programs, and the options of their import.
FOREIGN = {
    "tracker.txt": "--unit cm --point elbow=link01",
    "sleap.csv": "--frame-rate 50 --point tip=tip",
    "anipose.csv": "--frame-rate 10 --unit mm --point tip-end=tip",
    "motive.csv": "--point Arm:Tip=tip --from-time 0 --until 9",
    "phyphox.csv": "--point Gyroscope=imu02",
    "kinovea.txt": "--time-unit ms --origin 0,9 --point elbow=link01",
    "columns.csv": "--rename t=time_s --rename tip=tip_z_mm --ignore note*",
}
TEXTS = {
    "tracker.txt": test_foreign.TRACKER,
    "sleap.csv": test_foreign.SLEAP,
    "anipose.csv": test_foreign.ANIPOSE,
    "motive.csv": test_foreign.MOTIVE,
    "phyphox.csv": test_foreign.PHYPHOX,
    "kinovea.txt": test_foreign.KINOVEA,
    "columns.csv": test_foreign.COLUMNS.replace("z of tip", "tip"),
}

# Commands, and the files of each that are damaged.
COMMANDS = {
    "check --data run.csv --json": ["run.csv", "run.toml"],
    "check --data run.csv --strict --rename force_N=force_mN": ["run.csv", "run.toml"],
    "init --data bare.csv": ["bare.csv"],
    "import film.csv --frame-rate 50 --point elbow=link03 --point end=tip --command log.csv"
    " --to o.csv --force": ["film.csv", "log.csv"],
    "import tracks.csv --origin 0,10 --point m=tip --to o.csv --force": ["tracks.csv"],
    **{f"import {name} {how} --to o.csv --force": [name] for name, how in FOREIGN.items()},
    "import bag.mcap --point /tip=tip --to o.csv --force": ["bag.mcap"],
    "import bag --point /joint_states/elbow=joint02 --to o.csv --force": [
        "bag/bag.db3",
        "bag/metadata.yaml",
    ],
    "parameters --data run.csv": ["run.csv", "run.toml"],
    "parameters --arm arm.toml": ["arm.toml"],
    f"fit run_fit.toml --out f {FAST}": ["run_fit.toml", "run.csv", "run.toml"],
    f"fit --again kept/fit --out f {FAST}": ["kept/fit/result.json", "kept/run.csv"],
    f"fit --data run.csv --from fit --out f {FAST}": ["fit/result.json"],
    "fit --resume study/half --no-figures --quiet": ["study/half/journal.jsonl"],
    "sweep plan.toml --dry-run": ["plan.toml", "run_fit.toml"],
    "synth --data run.csv --to n.csv --force": ["run.csv", "run.toml"],
    "predict fit --data run.csv": ["fit/result.json", "run.csv", "run.toml"],
    "predict fit --against fit --data run.csv --config run_fit.toml": ["run_fit.toml"],
    "compare fit other": ["other/result.json"],
    "report fit --force": [
        *("fit/result.json", "fit/influence.json", "fit/profiles.json", "fit/bootstrap.json"),
    ],
    "suspects fit --force": ["fit/result.json", "run.csv"],
    "influence fit --force": ["fit/result.json"],
    "profile fit --quiet": ["fit/result.json", "fit/profiles.json"],
    "bootstrap fit --size 2 --folder tasks --force --quiet": ["fit/result.json"],
    "choose --data loops.csv --operator play": ["loops.csv", "loops.toml"],
    "compensate loops --target target.csv --to c.csv --force": [
        "loops/result.json",
        "target.csv",
    ],
    "drive arm.toml --replay pad.csv --pad pad.toml --to d.csv --force": [
        "pad.csv",
        "pad.toml",
        "arm.toml",
    ],
    "view arm.toml --page v.html --force": ["arm.toml"],
    "mjcf robot.xml --to r.toml --force": ["robot.xml"],
    "simulate --arm arm.toml --duration 0.2 --to s.csv --force": ["arm.toml"],
    "fill filling.toml --no-curve --json": ["filling.toml"],
    "unroll roll.toml --json": ["roll.toml"],
    "mission mission.toml --json": ["mission.toml"],
    "life mission.toml --json": ["mission.toml"],
    "wind --data resting.csv --wind 0,0.5,0.2": ["resting.csv", "resting.toml"],
    "joint joint.toml --out j --force": ["joint.toml"],
    "sensitivity --data run.csv --parameter muscle.effectiveness --out s --force": ["run.csv"],
    "design arm.toml --parameter air.drag_coefficient --out d --force --duration 1": ["arm.toml"],
    "explain run_fit.toml --out e --force --max-steps 1 --no-figures --quiet": ["run_fit.toml"],
    "check --data flat.parquet --json": ["flat.parquet"],
    "posterior fit --chains 1 --draws 8 --out p --force --quiet": ["fit/result.json"],
    "hysteresis --out h --travel 40 --seed 1 --force --quiet": ["a word"],
    "simulate --arm arm.toml --command log.csv --to s.csv --force": ["log.csv"],
    "view resting.csv --page v.html --force": ["resting.csv", "resting.toml"],
    "explain --resume explained --max-steps 1 --no-figures --quiet": [
        "explained/explain.jsonl",
        "explained/fits/first.json",
    ],
}
# These commands mainly read, so they are tested three times, and their results are compared.
OFTEN = ("check", "import", "compare", "parameters", "drive")
# In turn, so that none is omitted; only the damage is random.
PAIRS = [
    (command, damaged)
    for command, files in COMMANDS.items()
    for damaged in files * (3 if command.startswith(OFTEN) else 1)
]
random.Random(0).shuffle(PAIRS)
# Long computations are skipped: the command ends there with a message.
LONG = (
    ("giajax.apps.mission", "Mission.fly"),
    ("giajax.apps.joint", "joint_files"),
    ("giajax.apps.design", "design_experiment"),
    ("giajax.apps.filling", "fill"),
    ("giajax.apps.unrolling", "unroll"),
    ("giajax.apps.life", "live"),
    ("giajax.apps.wind", "fit_wind"),
    ("giajax.apps.experiments", "one_link"),
    ("giajax.studies", "posterior"),
)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Return small valid files of every kind."""
    home = tmp_path_factory.mktemp("hostile")
    results = EARLIER / "results"
    shutil.copytree(results / "muscle", home, dirs_exist_ok=True)
    shutil.copytree(results / "muscle", home / "kept")
    shutil.copytree(home / "fit", home / "other")
    shutil.copy(home / "run.csv", home / "bare.csv")
    shutil.copytree(EARLIER / "studies" / "journal", home / "study")
    shutil.copytree(results / "loops" / "fit", home / "loops")
    for folder, name in ((results / "loops", "loops"), (EARLIER / "written" / "wind", "resting")):
        for suffix in (".csv", ".toml"):
            shutil.copy(folder / f"run{suffix}", home / f"{name}{suffix}")
    shutil.copy(EARLIER / "written" / "fill" / "filling.toml", home)
    shutil.copy(ROOT / "missions" / "naraha.toml", home / "mission.toml")
    texts = {
        "film.csv": FILM, "tracks.csv": TRACKS, "pad.toml": PAD, "arm.toml": ARM,
        "roll.toml": ROLL, "robot.xml": ROBOT, "joint.toml": "[joint]\ntorque_N_m = 0.3\n",
        "log.csv": "time_s,joint01_command_deg\n0,0\n0.05,10\n",
        "pad.csv": "time_s,axis0,axis1,button0\n0,1,0.5,0\n0.1,0,0,1\n0.2,0.5,0,0\n",
        "target.csv": "time_s,output\n0,0\n1,0.1\n2,0\n",
        "plan.toml": 'fit = "run_fit.toml"\n[grid]\nloss = ["linear", "huber"]\n',
    }  # fmt: skip
    for sidecar in home.glob("*.toml"):  # otherwise the checksum would detect every damaged cell
        sidecar.write_text(re.sub("sha256 = .*", "", sidecar.read_text()))
    for name, text in {**texts, **TEXTS}.items():
        (home / name).write_text(text, newline="")
    for name, plugin in (
        ("bag", test_bags.StoragePlugin.SQLITE3),
        ("m", test_bags.StoragePlugin.MCAP),
    ):
        test_bags.write_bag(home, test_bags.TOPICS, name=name, plugin=plugin)
    shutil.move(next((home / "m").glob("*.mcap")), home / "bag.mcap")
    pl.read_csv(home / "run.csv").write_parquet(home / "flat.parquet")
    shutil.copy(home / "run.toml", home / "flat.toml")
    with contextlib.chdir(home):
        words = "--no-figures --quiet"
        for command in (
            *(f"{study} {words} fit" for study in ("influence", "profile", "bootstrap --size=2")),
            f"explain run_fit.toml --out explained --max-steps 1 {words}",
        ):  # fmt: skip
            status, _, err = ended(command.split())
            assert status in (0, 1), (command, err)
    return home


def ended(words):
    """Return the status and the output of a command."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(words)
    return status, out.getvalue(), err.getvalue()


# Damage.

PIECES = [
    b"", b"\0", b"\xff", b"nan", b"1e300", b"1e999", b"-", b'"', b"{", b"[[", b"]\n[", b"= 9\n",
    b"1_0", "\u0661\u0662".encode(), b"inf", b"9" * 5_000, b"[" * 5_000, b",1" * 20_000, b"\r",
    b"q" * 200_000, b"\n" * 20_000, b"links = 1e9\n", b"'", b'"""', b";", b"\xef\xbb\xbf", b"&x;",
]  # fmt: skip
VALUES = [
    None, True, 0, -3, 1e300, 2**70, math.nan, math.inf, "", "x", "a\0b", "q" * 9_999, [], [1],
    ["a"], {}, {"a": 1}, [[None]], [1e300] * 3, "links.mass",
]  # fmt: skip
CELLS = [
    "1_0", "\u0661", "\uff11", "inf", "-inf", "nan", "NA", "1e400", "1e31", "0x10", "1,5", "1;5",
    "-", ".", "e", "True", "0.5", "2e0", "+3", "007", '"1"2', '"', " 1 ", '"2"',
]  # fmt: skip
WORDS = [
    "1_0", "nan", "inf", "-1", "", "x", "\u0661", "1e999", "a\0b", "q" * 9_999, "\udcff", "a=b",
]  # fmt: skip


def cut(data, rng):
    """Return the data with one to three parts removed, repeated or replaced."""
    for _ in range(rng.randint(1, 3)):
        start = rng.randrange(len(data) + 1)
        again = data[start : start + rng.randint(1, 200)] * rng.randint(2, 50)
        data = (
            data[:start] + rng.choice([*PIECES, again]) + data[start + rng.choice([0, 1, 9, 999]) :]
        )
    return data


def changed(data, rng):
    """Return plain data with an entry removed, replaced or added."""
    data = copy.deepcopy(data)
    inner = data
    while True:
        keys = list(inner) if isinstance(inner, dict) else range(len(inner))
        key = rng.choice(list(keys))
        if not (isinstance(inner[key], dict | list) and inner[key]) or rng.random() < 0.2:
            break
        inner = inner[key]
    how = rng.random()
    if isinstance(inner[key], int | float) and how < 0.5:
        inner[key] *= rng.choice([1.01, 2, 1])
    elif how < 0.25:
        del inner[key]
    elif how < 0.4 and isinstance(inner, dict):
        inner["unknown"] = rng.choice(VALUES)
    else:
        inner[key] = rng.choice(VALUES)
    return data


def toml(value):
    """Return a value in TOML, which has no null."""
    if isinstance(value, dict):
        pairs = (f"{json.dumps(key)} = {toml(one)}" for key, one in value.items())
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return (
        "nil"
        if value is None
        else json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")
    )


def with_other_cells(data, separator, rng):
    lines = data.split(b"\n")
    for _ in range(rng.choice([1, 1, 2])):
        row = rng.randrange(len(lines) - 1)
        cells = lines[row].split(separator)
        cells[rng.randrange(len(cells))] = rng.choice(CELLS).encode()
        lines[row] = separator.join(cells)
    return b"\n".join(lines)


TABLES = (".csv", ".txt")
PLAIN = (*TABLES, ".toml", ".json", ".jsonl")


def damage(path, rng):
    """Damage a file."""
    data, how, kind = path.read_bytes(), rng.random(), path.suffix
    if kind == ".mcap" and how > 0.6:
        path.write_bytes(rng.choice(list(test_bags.FILES.values())))
    elif kind == ".db3" and how > 0.6:
        with contextlib.closing(sqlite3.connect(path)) as base:
            base.executescript(rng.choice(list(test_bags.SCRIPTS.values())))
    elif how < 0.06:
        path.unlink()
        where = rng.choice(["folder", "pipe", "zero", "link", "gone", "empty", "UTF-16"])
        if where == "folder":
            path.mkdir()
        elif where == "pipe":
            os.mkfifo(path)
        elif where in ("zero", "link"):
            path.symlink_to("/dev/zero" if where == "zero" else "nowhere")
        elif where != "gone":
            path.write_bytes(b"" if where == "empty" else data.decode("latin-1").encode("utf-16"))
    elif how < (0.2 if kind in TABLES else 0.4) or kind not in PLAIN:
        path.write_bytes(cut(data, rng))
    elif kind in TABLES:
        separator = IMPORTED[path.name][0] if path.name in IMPORTED else ","
        path.write_bytes(with_other_cells(data, separator.encode(), rng))
    elif kind == ".toml":
        table = changed(tomllib.loads(data.decode()), rng)
        path.write_text("".join(f"{json.dumps(k)} = {toml(v)}\n" for k, v in table.items()))
    elif kind == ".json":
        path.write_text(json.dumps(changed(json.loads(data), rng)))
    elif kind == ".jsonl":
        lines = data.splitlines()
        row = rng.choice([row for row, line in enumerate(lines) if line.endswith(b"}")])
        lines[row] = json.dumps(changed(json.loads(lines[row]), rng)).encode()
        path.write_bytes(b"\n".join(lines) + b"\n")


# Readers that use only the standard library.


def cells_of(path, below=0):
    """Return the rows of a CSV file below `below` irrelevant rows, starting with the header."""
    text = path.read_text(encoding="utf-8-sig").rstrip("\n").split("\n", below)[-1]
    return list(csv.reader(io.StringIO(text), strict=True))


def number(cell):
    cell = cell.strip()
    if cell.lower() in ("", "nan", "na"):
        return math.nan
    assert cell.isascii(), cell
    assert "_" not in cell, cell
    return float(cell)


def same_table(path, _):
    header, *rows = cells_of(path)
    table = read_table(path)
    for name, column in zip(header, zip(*rows, strict=True), strict=True):
        channel = next((c for c in table.channels.values() if c.column == name.strip()), None)
        read = table.times if channel is None else table.values[channel.name]
        if channel is not None and channel.quantity == "text":
            assert list(read) == [cell.strip() or None for cell in column]
        elif channel is not None or name.strip() == "time_s":
            wanted = np.array([number(cell) for cell in column])
            wanted = wanted if channel is None else channel.to_si(wanted)
            np.testing.assert_allclose(read, wanted, rtol=1e-15)


def same_points(path, home):
    (_, *names), (_, *kinds), *rows = cells_of(path, below=1)
    pairs = enumerate(zip(names, kinds, strict=True), 1)
    column = {pair: [row[at] for row in rows] for at, pair in pairs}
    header, *written = cells_of(home / "o.csv")
    for point, part in (("elbow", "link03"), ("end", "tip")):
        likely = [number(cell) for cell in column.get((point, "likelihood"), ["1"] * len(rows))]
        for kind, axis in (("x", "u"), ("y", "v")):
            cells = zip(map(number, column[point, kind]), likely, strict=True)
            wanted = [value for value, p in cells if p >= 0.6 and not math.isnan(value)]
            found = [number(row[header.index(f"{part}_{axis}_px")]) for row in written]
            found = [value for value in found if not math.isnan(value)]
            np.testing.assert_allclose(found, wanted, rtol=1e-8)


def same_import(path, home):
    """Check that each imported column is a column of the table, with another unit and zero."""
    separator, parts = IMPORTED[path.name]
    text = path.read_text(encoding="utf-8-sig")
    if path.name == "kinovea.txt":  # sections with rows
        text = "t elbow.X elbow.Y\n" + text.partition("# elbow\n")[2].partition("\n\n")[0]
        text = re.sub(" +", " ", text)
    if separator != ",":
        text = text.replace(",", ".")
    rows = [next(csv.reader([line], delimiter=separator), []) for line in text.splitlines()]
    # The names of points are above those of axes, once for each axis or only for the first one.
    first, up = {"tracker.txt": ("t", 1), "motive.csv": ("Frame", 3)}.get(path.name, ("", 0))
    last = next(n for n, row in enumerate(rows) if not up or (row and row[0].strip() == first))
    names = rows[last]
    if up:
        above = next((row for row in rows[:last] if "Name" in row[:2]), rows[last - up])
        points = itertools.accumulate(above, lambda before, name: name or before)
        names = [f"{point}.{name}" for point, name in zip(points, names, strict=False)]
    body = rows[last + 1 :]
    if path.name == "sleap.csv":  # frames in any order
        body.sort(key=lambda row: number(row[names.index("frame_idx")]))
    header, *written = cells_of(home / "o.csv")

    def column(name, otherwise=""):
        at = names.index(name) if name in names else len(names)
        cells = (row[at] if at < len(row) else otherwise for row in body)
        return np.array([number(cell) for cell in cells])

    for part, (name, factor, zero, score) in parts.items():
        wanted = zero + factor * column(name)
        score, least = (score, 0.6) if "score" in score else (score, -math.inf)
        wanted = wanted[(column(score, "1") >= least) & ~np.isnan(wanted)]
        found = [number(row[header.index(part)]) for row in written] if part in header else []
        found = [value for value in found if not math.isnan(value)]
        np.testing.assert_allclose(found, wanted, rtol=1e-8)


DEGREES = 180 / math.pi
# Cell separator; for each column of the run, its column in the table, factor, zero, description.
IMPORTED = {
    "tracks.csv": (",", {"tip_u_px": ("m/0/X", 1, 0, ""), "tip_v_px": ("m/0/Y", -1, 10, "")}),
    "tracker.txt": (
        "\t",
        {"link01_x_m": ("elbow.x", 0.01, 0, ""), "link01_z_m": ("elbow.y", 0.01, 0, "")},
    ),
    "sleap.csv": (
        ",", {f"tip_{to}_px": (f"tip.{of}", 1, 0, "tip.score") for to, of in ("ux", "vy")}
    ),
    "anipose.csv": (
        ",", {f"tip_{axis}_m": (f"tip-end_{axis}", 1e-3, 0, "tip-end_score") for axis in "xyz"}
    ),
    "motive.csv": (
        ",",
        {
            "tip_x_m": ("Arm:Tip.X", 1e-3, 0, ""),
            "tip_y_m": ("Arm:Tip.Z", -1e-3, 0, ""),
            "tip_z_m": ("Arm:Tip.Y", 1e-3, 0, ""),
        },
    ),
    "phyphox.csv": (
        ",",
        {
            f"imu02_gyro_{xyz}_deg_per_s": (f"Gyroscope {xyz} (rad/s)", DEGREES, 0, "Time (s)")
            for xyz in "xyz"
        },
    ),
    "kinovea.txt": (
        " ", {"link01_u_px": ("elbow.X", 1, 0, ""), "link01_v_px": ("elbow.Y", -1, 9, "")}
    ),
    "columns.csv": (
        ";",
        {"joint01_command_deg": ("joint01_command_deg", 1, 0, ""), "tip_z_m": ("tip", 1e-3, 0, "")},
    ),
}  # fmt: skip


def same_bag(path, home):
    """Compare with the reader of rosbags, for the two imported topics."""
    header, *written = cells_of(home / "o.csv")
    topic, column = (
        ("/tip", "tip_x_m") if path.suffix == ".mcap" else ("/joint_states", "joint02_angle_deg")
    )
    if path.suffix == ".mcap":  # the data themselves, not the summary at the end
        data = path.read_bytes()
        path = home / "scanned.mcap"
        path.write_bytes(data[:-28] + bytes(8) + data[-20:])
    wanted = []
    with AnyReader([path if path.suffix == ".mcap" else path.parent]) as bag:
        of = [each for each in bag.connections if each.topic == topic]
        for each, _, data in bag.messages(of) if of else ():
            message = bag.deserialize(data, each.msgtype)
            if topic == "/tip":
                wanted.append(message.pose.position.x)
            elif "elbow" in message.name and len(message.position):
                wanted.append(math.degrees(message.position[message.name.index("elbow")]))
    found = [number(row[header.index(column)]) for row in written] if column in header else []
    found, wanted = ([x for x in xs if not math.isnan(x)] for xs in (found, wanted))
    np.testing.assert_allclose(found, wanted, rtol=1e-8)


def same_definition(path, _):
    both = Definition.load(path).contents(), tomllib.loads(path.read_text(encoding="utf-8-sig"))
    # NaN does not equal NaN.
    one, other = (json.loads(json.dumps(x, default=str), parse_constant=str) for x in both)
    assert one == other


def same_result(path, _):
    record = json.loads(path.read_text())
    try:
        result = load_result(path)
    except InputError:  # a part that a warm-started fit does not read
        return
    for name, estimate in record["parameters"].items():
        assert result.parameters[name].value == estimate["value"]
        assert result.parameters[name].standard_error == estimate["standard_error"]
    assert result.cost == record["cost"]


def same_pad(path, _):
    header, *rows = cells_of(path)
    pad = read_pad(path)
    for at, name in enumerate(header):
        np.testing.assert_array_equal(pad[name.strip()], [number(row[at]) for row in rows])


def same_plan(path, _):
    grid = tomllib.loads(path.read_text(encoding="utf-8-sig")).get("grid", {})
    assert len(Plan.load(path).cases) == math.prod(map(len, grid.values()))


SAME = {
    "run.csv": same_table, "loops.csv": same_table, "target.csv": same_table, "log.csv": same_table,
    "film.csv": same_points, "run_fit.toml": same_definition, "run.toml": same_definition,
    "arm.toml": same_definition, "result.json": same_result, "pad.csv": same_pad,
    "plan.toml": same_plan, "bag.mcap": same_bag, "bag.db3": same_bag,
    **dict.fromkeys(IMPORTED, same_import),
}  # fmt: skip


# Cases.


class Hangs(KeyboardInterrupt):
    """A case that exceeds the time limit."""


@contextlib.contextmanager
def bounded(most):
    """Limit the processor time and the waiting time; yield whether it hung, and the memory."""

    seen = {"hung": False}

    def stop(number, frame):
        seen["hung"] = True
        raise Hangs

    numbers = signal.SIGPROF, signal.SIGALRM
    before = [signal.signal(number, stop) for number in numbers]
    limits = resource.getrlimit(resource.RLIMIT_AS)
    size, resident = (int(n) * resource.getpagesize() for n in STATM.read_text().split()[:2])
    REFERENCES.write_text("5")  # resets the peak memory
    # Allow for compilation, whose result the next case would find in the cache.
    signal.setitimer(signal.ITIMER_PROF, most + 55.0)
    signal.setitimer(signal.ITIMER_REAL, 3 * (most + 55.0))  # for a case that waits
    resource.setrlimit(resource.RLIMIT_AS, (size + 8 * MOST_BYTES, limits[1]))
    try:
        yield seen
    finally:
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0)
        resource.setrlimit(resource.RLIMIT_AS, limits)
        for each, handler in zip(numbers, before, strict=True):
            signal.signal(each, handler)
    (highest,) = re.findall(r"VmHWM:\s+(\d+) kB", STATUS.read_text())
    seen["grown"] = 1024 * int(highest) - resident


def try_one(seed, home, folder, seconds, most=None):
    """Run one case within a time limit; return its status, time and memory."""
    most = MOST_SECONDS if most is None else most
    rng = random.Random(seed)
    command, damaged = PAIRS[seed % len(PAIRS)]
    words = command.split()
    shutil.copytree(home, folder)
    if damaged == "a word" or rng.random() < 0.1:
        damaged = "a word"
        place = rng.randrange(1, len(words))
        words[place : place + 1] = [rng.choice(WORDS)]
    else:
        damage(folder / damaged, rng)
    what = f"seed {seed}: {' '.join(words)[:300]!r} with {damaged} damaged"
    began, compiling = time.process_time(), seconds()
    with contextlib.chdir(folder), bounded(most) as seen:
        try:
            status, out, err = ended(words)
        except BaseException as error:
            raise AssertionError(f"{what} raised {error!r}") from error
    took = time.process_time() - began - (seconds() - compiling)
    assert not seen["hung"], f"{what} hangs"
    assert status in (0, 1, 2, 3), f"{what} ended with {status}: {err}"
    assert "Traceback" not in err + out, f"{what}: {err}"
    assert took < most, f"{what} took {took:.1f} s"
    assert seen["grown"] < MOST_BYTES, f"{what} took {seen['grown']:,} bytes"
    if status == 2:
        last = err.splitlines()[-1]
        assert last.startswith("giajax: "), f"{what}: {err}"
        assert 20 < len(last) < 2_500, f"{what}: {err}"
    elif (folder / damaged).exists() and (same := SAME.get(Path(damaged).name)):
        with contextlib.chdir(folder):
            try:
                same(Path(damaged), Path())
            except Exception as error:
                raise AssertionError(f"{what} was read otherwise: {error!r}") from error
    return status, took, seen["grown"]


@pytest.fixture
def compiling():
    """Return the seconds of compilation so far."""
    total = [0.0]

    def heard(event, duration, **_):
        if event.startswith("/jax/core/compile/"):
            total[0] += duration

    jax.monitoring.register_event_duration_secs_listener(heard)
    yield lambda: total[0]
    jax.monitoring.unregister_event_duration_listener(heard)


@pytest.fixture
def brief(monkeypatch):
    """Replace long computations by an error message."""

    def not_here(*_, **__):
        raise InputError("this takes long, so that it is not computed here: leave it out")

    for module, name in LONG:
        monkeypatch.setattr(f"{module}.{name}", not_here)


def try_many(seeds, home, tmp_path, compiling, most=None):
    ends = []
    for seed in seeds:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ends.append(try_one(seed, home, tmp_path / "case", compiling, most))
        shutil.rmtree(tmp_path / "case")
    statuses, seconds, grown = zip(*ends, strict=True)
    print(f"{len(ends)} cases, longest {max(seconds):.1f} s, most {max(grown) / 1e6:.0f} MB")
    # Not all cases are refused, either.
    read = sum(status != 2 for status in statuses)
    assert len(ends) / 20 < read < len(ends) * 19 / 20


# 300 cases.
@pytest.mark.parametrize("part", range(6))
def test_a_command_reads_or_refuses(home, tmp_path, compiling, brief, part):
    try_many(range(50 * part, 50 * part + 50), home, tmp_path, compiling)


@pytest.mark.long
@pytest.mark.parametrize("part", range(30))
def test_a_command_reads_or_refuses_3000_others(home, tmp_path, compiling, brief, part):
    try_many(range(1_000 + 100 * part, 1_100 + 100 * part), home, tmp_path, compiling)


# Commands that the test above ends early run completely here. An arm has twenty links by default,
# and a design takes minutes.
_COMPUTING = ("mission", "joint", "design", "fill", "unroll", "wind")
COMPUTED = [
    seed for seed in range(5_000, 5_600) if PAIRS[seed % len(PAIRS)][0].split()[0] in _COMPUTING
]


@pytest.mark.long
def test_what_takes_long_reads_or_refuses_too(home, tmp_path, compiling):
    try_many(COMPUTED, home, tmp_path, compiling, most=240.0)


def a_fault(read, *given, **named):
    raise RuntimeError(given)


def a_hang(read, *given, **named):
    while True:
        pass


def a_flood(read, *given, **named):
    np.ones(1 << 24).sum()
    return read(*given, **named)


def a_lie(read, *given, **named):
    table = read(*given, **named)
    for column in table.values.values():
        if column.dtype != object:
            column *= 1.001
    return table


@pytest.mark.parametrize(
    ("reader", "broken", "says"),
    [
        ("giajax.recordings.read_run", a_fault, "ended with 4"),
        ("giajax.recordings.read_run", a_hang, "hangs"),
        ("giajax.recordings.read_run", a_flood, "took [0-9,]+ bytes"),
        (f"{__name__}.read_table", a_lie, "was read otherwise"),
    ],
)
def test_each_check_can_fail(home, tmp_path, compiling, monkeypatch, reader, broken, says):
    """A reader with one defect is detected by a case that it reads."""
    monkeypatch.setattr(f"{__name__}.MOST_BYTES", 1 << 26)
    command = PAIRS.index(("check --data run.csv --json", "run.csv"))
    seeds = itertools.count(command, len(PAIRS))
    seed = next(n for n in seeds if not try_one(n, home, tmp_path / f"{n}", compiling)[0])
    holder, _, name = reader.rpartition(".")
    whole = getattr(importlib.import_module(holder), name)
    monkeypatch.setattr(reader, functools.partial(broken, whole))
    most = -54.0 if broken is a_hang else None  # one second of processor time
    with pytest.raises(AssertionError, match=says):
        try_one(seed, home, tmp_path / "broken", compiling, most)


def test_what_is_damaged_is_right_before(home, tmp_path, brief):
    shutil.copytree(home, tmp_path / "case")
    with contextlib.chdir(tmp_path / "case"):
        for command in COMMANDS:
            status, _, err = ended(command.split())
            assert status in (0, 1) or "this takes long" in err, (command, err)
        for command, damaged in dict.fromkeys(PAIRS):
            if same := SAME.get(Path(damaged).name):
                ended(command.split())
                same(Path(damaged), Path())
