"""One session, one precision: float64, strict promotion, every warning an error.

And the tiers: tests marked `quick` compile nothing (`make check`), tests marked `slow` are left out
of `make test`, and those marked `long` of `make test-all`, too; both say so at their end.
"""

import contextlib
import functools
import gc
import io
import json
import os
import re
import shutil
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

# A check that raises in a compiled program calls back into Python, and JAX keeps no such program:
# each process would compile it again, and the largest have checks. As in the command, a failed
# check becomes a NaN instead (`simulation/raising.py` is run where it raises). Equinox reads this
# when it is imported.
os.environ.setdefault("EQX_ON_ERROR", "nan")

# Programs that the tests compile by themselves get the options that `giajax.program` sets: half
# of the time of compiling; and the compiler optimises less, because most programs of a test run
# once. XLA ends the process at a name that it does not know, and names change with its versions.
if version("jaxlib").startswith("0.10."):
    from giajax.runtime.programs import CPU_OPTIONS

    flags = [
        f"--{name}={str(value).lower() if isinstance(value, bool) else value}"
        for name, value in CPU_OPTIONS.items()
    ]
    flags.append("--xla_backend_optimization_level=0")
    os.environ.setdefault("XLA_FLAGS", " ".join(flags))

import equinox as eqx
import jax
import pytest

import giajax.runtime.programs
from giajax.runtime.programs import NoStructureError, described, program, restored, structure

ROOT = Path(__file__).resolve().parents[1]

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
# Compiling is most of the time of these tests: keep what was compiled for the next session.
# By way of the environment it is shared with the processes that the tests start.
CACHE = os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
LEAST = os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
jax.config.update("jax_compilation_cache_dir", CACHE)
jax.config.update("jax_persistent_cache_min_compile_time_secs", float(LEAST))

# A process of the command keeps no program whose result no text describes: it traces it each time,
# and nobody sees. So the results of all programs of the tests are described.


def as_shape(leaf):
    """Of an array that of JAX, which a program returns."""
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf


def describing(function):
    """As `giajax.runtime.programs.program`; refuses a result that no text describes."""
    call = program(function)
    seen = set()

    @functools.wraps(call)
    def checked(*args, **kwargs):
        result = call(*args, **kwargs)
        leaves = jax.tree.leaves((args, kwargs, result))
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return result
        try:
            key = structure((args, kwargs))
        except NoStructureError:  # not kept, and said nowhere: a test may have such arguments
            return result
        if key not in seen:
            seen.add(key)
            shaped = jax.tree.map(as_shape, result)
            assert structure(restored(json.loads(json.dumps(described(shaped))))) == structure(
                shaped
            )
        return result

    return checked


giajax.runtime.programs.program = describing

# Every compiled program maps memory, and a process may have 65,530 maps: beyond them the compiler
# dies, after a thousand tests.
MAPS = Path("/proc/self/maps")
MOST_MAPS = 12_000


COMPILING = "/jax/core/compile/backend_compile_duration"
programs = 0


def count_programs(event, duration, **_):
    """A listener of JAX: one more program was compiled, or read from the cache."""
    global programs
    programs += event == COMPILING


jax.monitoring.register_event_duration_secs_listener(count_programs)


@pytest.fixture
def compiled():
    """A function that says how many programs this process has compiled so far."""
    return lambda: programs


@pytest.fixture
def own_kinds():
    """Kinds that a test registers are gone after it."""
    from giajax.recordings import Definition
    from giajax.schema import KINDS, add_kind

    before, fields = dict(KINDS), set(Definition.model_fields)
    yield
    KINDS.clear()
    KINDS.update(before)
    add_kind(KINDS["arm"])
    for name in set(Definition.model_fields) - fields:
        del Definition.model_fields[name]
        Definition.model_rebuild(force=True)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """A test that says that it is quick compiles nothing, however fast the machine."""
    before = programs
    outcome = yield
    compiled = programs - before
    if compiled and item.get_closest_marker("quick"):
        pytest.fail(f"marked as quick, and {compiled} programs were compiled: remove the mark")
    return outcome


# All tests of such a file have the same programs, which take a minute to compile. A worker that has
# nothing left takes tests from the end of another's list: what begins a list stays together.
FIRST = ("test_arm_suspects.py",)


def pytest_collection_modifyitems(items):
    """What should be run by one worker comes first."""
    items.sort(key=lambda item: item.path.name not in FIRST)


def pytest_collection_finish():
    """What is imported stays: the collector does not look through it again at each pass."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


LEFT_OUT = pytest.StashKey[dict[str, int]]()
# Of each mark, what runs its tests.
RUN_BY = {"slow": "make test-all", "long": "make test-long"}


def pytest_deselected(items):
    """Count what `make test` leaves out; `pytest -k` and `make check` leave out more."""
    if not items or (config := items[0].config).option.markexpr != "not slow and not long":
        return
    counts = config.stash.setdefault(LEFT_OUT, dict.fromkeys(RUN_BY, 0))
    for mark in RUN_BY:
        counts[mark] += sum(item.get_closest_marker(mark) is not None for item in items)


def pytest_sessionfinish(session):
    """Workers select the tests, and tell the process that reports: each the same number."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = session.config.stash.get(LEFT_OUT, {})


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """A worker of pytest-xdist has ended."""
    node.config.stash[LEFT_OUT] = getattr(node, "workeroutput", {}).get("left_out", {})


def pytest_terminal_summary(terminalreporter, config):
    """What was left out is said, so that nobody takes a part for the whole."""
    for mark, number in config.stash.get(LEFT_OUT, {}).items():
        if number:
            terminalreporter.write_sep("-", f"{number} {mark} tests left out: {RUN_BY[mark]}")


@pytest.fixture(autouse=True, scope="module")
def few_programs_at_a_time():
    """Forget the compiled programs of a long session, which the cache on disk keeps."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(autouse=True, scope="session")
def every_picture_in_all_formats():
    """What is drawn as PNG is drawn as SVG and PDF, too: a picture of each title, once."""
    from matplotlib.figure import Figure

    from giajax.report import to_png
    from giajax.runtime.pictures import FORMATS, pictures_as

    save, titles = Figure.savefig, set()

    def saved(figure, *given, **options):
        save(figure, *given, **options)
        title = figure.get_suptitle()
        ours = "giajax" in (options.get("metadata") or {}).get("Software", "")
        if ours and title not in titles:
            titles.add(title)
            with pictures_as(FORMATS):
                check_pictures(to_png(figure).others)

    Figure.savefig = saved
    yield
    Figure.savefig = save


def check_pictures(others):
    """An SVG file whose text is text, and a PDF file of one page without fonts of Type 3."""
    svg, pdf = others["svg"], others["pdf"]
    root = ElementTree.fromstring(svg)
    assert root.tag.endswith("}svg")
    assert root.find(".//{*}text") is not None
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", pdf)) == 1
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf


@pytest.fixture(scope="session")
def browser():
    """A browser; a test that asks for it is skipped where there is none."""
    from docs.machinery import browse

    found = browse.installed()
    if found is None:
        pytest.skip(f"no browser, one of {', '.join(browse.BROWSERS)}: make browser")
    return found


@pytest.fixture(scope="session")
def arm_fit(tmp_path_factory):
    """The recording of a short arm, the folder of its fit by the command, and how that ended.

    Copy the folder before anything else is written into it.
    """
    from giajax.cli import main
    from small_arm import STARTS, make_run

    folder = tmp_path_factory.mktemp("arm")
    data, out, err = make_run(folder), io.StringIO(), io.StringIO()
    words = ["fit", "--data", str(data), *STARTS, "--out", str(folder / "out")]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(words)
    return data, folder / "out", (status, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def muscle_fit(tmp_path_factory):
    """The folder of a muscle's fit with its page, by the command; its recording lies beside it.

    Copy it before anything is written into it.
    """
    from giajax.cli import main

    folder = tmp_path_factory.mktemp("muscle")
    for name in ("muscle.csv", "muscle.toml"):
        shutil.copy(ROOT / "data" / "synthetic" / name, folder / name)
    run = ["fit", "--data", str(folder / "muscle.csv"), "--out", str(folder / "fit"), "--report"]
    assert main([*run, "--no-figures", "--quiet"]) == 0
    return folder / "fit"
