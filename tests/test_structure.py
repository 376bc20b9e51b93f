"""The structure of the source: imports between packages and files, and uses of model kinds.

Everything is read from the text of the files; giajax is not imported.
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

# The packages from top to bottom: each imports only those below it.
ROOMS = (
    "__main__",
    "cli",
    "apps",
    "report",
    "tasks",
    "studies",
    "fitting",
    "models",
    "simulation",
    "mechanics",
    "noise",
    "recordings",
    "schema",
    "runtime",
)
LEVEL = {room: level for level, room in enumerate(ROOMS)}


def files():
    return sorted([*SOURCE.rglob("*.py"), *SOURCE.rglob("*.pyi")])


def named(path):
    return str(path.relative_to(ROOT))


@functools.cache
def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(path, tree):
    """Return the full names of modules that a file imports, including local and type imports.

    `from giajax import fitting` counts as both `giajax` and `giajax.fitting`.
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


def module_of(path):
    """Return the module name of a file."""
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path) for path in SOURCE.rglob("*.py")}


def modules_imported(path):
    """Return the giajax modules that a file imports; a module within a package, not the package."""
    names = [name for name in imported(path, parsed(path)) if name in MODULES]
    inner = {name.rpartition(".")[0] for name in names}
    return {name for name in names if name not in inner} - {module_of(path)}


def rooms_imported(path):
    """Return pairs of a giajax package, other than the file's own, and the module in it."""
    for module in modules_imported(path):
        room = [*module.split("."), "__init__"][1]
        if room != room_of(path):
            yield room, module


def test_every_room_has_its_place():
    folders = {path.name for path in SOURCE.iterdir() if path.is_dir()}
    assert folders - {"__pycache__", "_examples"} == set(ROOMS) - {"__main__"}


def test_no_room_imports_upwards():
    """This includes the top-level package, which imports all others."""
    upwards = {
        f"{named(path)} imports {module}"
        for path in files()
        if room_of(path) in LEVEL
        for room, module in rooms_imported(path)
        if LEVEL.get(room, -1) <= LEVEL[room_of(path)]
    }
    assert not upwards, "\n".join(sorted(upwards))


def named_in_text(tree):
    """Return the giajax modules that are imported by a name in a string."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            texts = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
            if name == "import_module":
                yield from (text for text in texts if str(text).startswith("giajax."))


def test_one_room_is_imported_upwards_when_it_is_called():
    """The function that draws a result, given in its record (docs/architecture.md)."""
    found = [
        (named(path), module)
        for path in files()
        if path.name != "aliases.py"  # imports former names
        for module in named_in_text(parsed(path))
    ]
    assert found == [("src/giajax/fitting/_result.py", "giajax.report")]


def test_no_files_import_in_a_circle():
    """Neither at the top level, nor within functions or for types."""
    graph = {module_of(path): modules_imported(path) for path in SOURCE.rglob("*.py")}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_private_modules_stay_in_their_package():
    """A private module is imported only by modules next to it and in subfolders."""
    offenders = set()
    for path in files():
        for module in modules_imported(path):
            package, _, last = module.rpartition(".")
            inside = f"{module_of(path)}.".startswith(f"{package}.")
            if last.startswith("_") and not last.startswith("__") and not inside:
                offenders.add(f"{named(path)} imports {module}")
    assert not offenders, "\n".join(sorted(offenders))


def model_kinds():
    """Return the classes of the models package that follow its protocol, and the protocol."""
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
    """Return the last part of every name in an expression: ArmModel for `models.ArmModel`."""
    for part in ast.walk(node):
        if isinstance(part, ast.Name):
            yield part.id
        elif isinstance(part, ast.Attribute):
            yield part.attr


def kinds_asked_for(tree):
    """Return classes in `isinstance`, `issubclass` or a `match` pattern, by line."""
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
    importlib.import_module("giajax.report")
    if isinstance(x, (int, models.ArmModel)):
        match x:
            case JointModel():
                pass
"""


def test_the_reading_sees_what_it_must():
    """Imports in all forms, and tests for a class in all forms."""
    tree = ast.parse(SAMPLE)
    reading = set(imported(SOURCE / "studies" / "_sample.py", tree))
    assert reading == {
        "giajax", "giajax.models", "giajax.fitting", "giajax.fitting.fit", "giajax.cli._fit",
    }  # fmt: skip
    assert list(named_in_text(tree)) == ["giajax.report"]
    asked = {name for _, name in kinds_asked_for(tree)}
    assert {"int", "ArmModel", "JointModel"} <= asked
    for above, below in itertools.pairwise(["cli", "fitting", "models", "recordings", "schema"]):
        assert LEVEL[above] < LEVEL[below]
