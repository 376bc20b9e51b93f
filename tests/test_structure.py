"""The shape of the source: sizes of files, imports between rooms, and what knows the model kinds.

Everything here is read from the text of the files; nothing of giajax is imported.
"""

import ast
import functools
import graphlib
import itertools
from pathlib import Path

import pytest

pytestmark = pytest.mark.quick

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "giajax"

# The rooms from the top: one imports what is below it. Those of a line are beside each other, and
# may use each other as long as that is no circle.
ROOMS = [
    ("__init__", "__main__"),
    ("cli",),
    ("paper",),
    ("experiments",),
    ("report",),
    ("mission",),
    ("driving",),
    ("viewer",),
    ("sweeping",),
    ("tasks",),
    ("diagnosis",),
    ("repetitions",),
    ("study", "wind", "design"),
    ("fitting",),
    ("control",),
    ("synthetic",),
    ("models",),
    ("filling", "simulation", "joint", "arm", "hysteresis", "obstacles"),
    ("runs",),
    ("kinds",),
    ("verdict",),
    ("noise",),
    ("execution",),
    (
        "parameters",
        "quantities",
        "_shares",
        "_threads",
        "_cores",
        "_devices",
        "_blas",
        "_process",
        "_program",
        "_kept",
        "_kept_files",
        "_structure",
        "_maths",
        "_running_sum",
        "_computed_once",
        "_small_loops",
        "_files",
        "_limits",
        "_policy",
        "_signals",
        "_sobol",
        "_syntax",
        "_text",
        "_typing",
        "_errors",
        "_version",
    ),
]
LEVEL = {room: level for level, rooms in enumerate(ROOMS) for room in rooms}

LONG = 200
LONGEST = 300
REASON = "longer than 200 lines because"


def files():
    return sorted([*SOURCE.rglob("*.py"), *SOURCE.rglob("*.pyi")])


def named(path):
    return str(path.relative_to(ROOT))


@functools.cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(path, tree):
    """Names of modules that a file imports, within functions and for types too, each in full.

    Of `from giajax import fitting` both `giajax` and `giajax.fitting` count.
    """
    package = ["giajax", *path.relative_to(SOURCE).parent.parts]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*above, *filter(None, [node.module])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def room_of(path):
    return path.relative_to(SOURCE).with_suffix("").parts[0]


def rooms_imported(path):
    """Pairs of a room of giajax and the rest of the module's name, other than the file's own.

    What is imported from `giajax` itself, and is no room, comes from its `__init__`.
    """
    for name in imported(path, parsed(path)):
        first, *parts = name.split(".")
        if first != "giajax" or not parts:
            continue
        room, *rest = parts if parts[0] in LEVEL else ["__init__", *parts]
        if room != room_of(path):
            yield room, rest


def test_every_room_has_its_place():
    assert {room_of(path) for path in files()} <= set(LEVEL)


def test_no_file_is_too_long():
    """At most 300 lines; beyond 200 the docstring of the module says why."""
    offenders = []
    for path in files():
        lines = len(path.read_text(encoding="utf-8").splitlines())
        said = REASON in " ".join((ast.get_docstring(parsed(path)) or "").split()).lower()
        if lines > LONGEST or (lines > LONG and not said):
            offenders.append(f"{named(path)}: {lines} lines{', without a reason' * (not said)}")
    assert not offenders, "\n".join(offenders)


def test_no_room_imports_upwards():
    upwards = {
        f"{named(path)} imports {room}"
        for path in files()
        for room, _ in rooms_imported(path)
        if LEVEL[room] < LEVEL[room_of(path)]
    }
    assert not upwards, "\n".join(sorted(upwards))


def test_no_rooms_import_in_a_circle():
    graph = {room: set() for room in LEVEL}
    for path in files():
        # What imports upwards has a test of its own.
        below = {room for room, _ in rooms_imported(path) if LEVEL[room] >= LEVEL[room_of(path)]}
        graph[room_of(path)] |= below
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_private_modules_stay_in_their_room():
    offenders = {
        f"{named(path)} imports {room}.{'.'.join(rest)}"
        for path in files()
        for room, rest in rooms_imported(path)
        if rest and rest[0].startswith("_") and not rest[0].startswith("__")
    }
    assert not offenders, "\n".join(sorted(offenders))


def model_kinds():
    """Classes of the room of models that follow its protocol, and the protocol itself."""
    classes = {
        node.name: {base.id for base in node.bases if isinstance(base, ast.Name)}
        for path in (SOURCE / "models").glob("*.py")
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.ClassDef)
    }
    kinds = {"AbstractModel"}
    while more := {name for name, bases in classes.items() if bases & kinds} - kinds:
        kinds |= more
    return kinds


def names_in(node):
    """The last part of every name within an expression: of `models.ArmModel`, ArmModel."""
    for part in ast.walk(node):
        if isinstance(part, ast.Name):
            yield part.id
        elif isinstance(part, ast.Attribute):
            yield part.attr


def kinds_asked_for(tree):
    """Classes that `isinstance`, `issubclass` or a pattern of `match` ask for, by line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in ("isinstance", "issubclass") and len(node.args) == 2:
                yield from ((node.lineno, name) for name in names_in(node.args[1]))
        elif isinstance(node, ast.MatchClass):
            yield from ((node.lineno, name) for name in names_in(node.cls))


def test_nobody_asks_what_kind_a_model_is():
    kinds = model_kinds()
    assert {"AbstractModel", "ArmModel", "HysteresisModel", "JointModel", "MuscleModel"} <= kinds
    offenders = [
        f"{named(path)}:{line} asks for {name}"
        for path in files()
        if room_of(path) != "models"
        for line, name in kinds_asked_for(parsed(path))
        if name in kinds
    ]
    assert not offenders, "\n".join(offenders)


def test_no_test_imports_a_benchmark():
    benchmarks = {path.stem for path in (ROOT / "benchmarks").glob("*.py")} - {"__init__"}
    assert benchmarks
    offenders = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.walk(parsed(path)):
            modules = []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            for module in modules:
                first = module.partition(".")[0]
                if first == "benchmarks" or module in benchmarks:
                    offenders.append(f"{named(path)}:{node.lineno} imports {module}")
    assert not offenders, "\n".join(offenders)


SAMPLE = """
from giajax import models
from ..fitting import fit
def later():
    import giajax.cli._fit
    if isinstance(x, (int, models.ArmModel)):
        match x:
            case JointModel():
                pass
"""


def test_the_reading_sees_what_it_must():
    """Imports of every form, and every form of asking for a class."""
    tree = ast.parse(SAMPLE)
    reading = set(imported(SOURCE / "study" / "_sample.py", tree))
    assert reading == {
        "giajax", "giajax.models", "giajax.fitting", "giajax.fitting.fit", "giajax.cli._fit",
    }  # fmt: skip
    asked = {name for _, name in kinds_asked_for(tree)}
    assert {"int", "ArmModel", "JointModel"} <= asked
    for above, below in itertools.pairwise(["cli", "fitting", "models", "runs", "kinds"]):
        assert LEVEL[above] < LEVEL[below]
