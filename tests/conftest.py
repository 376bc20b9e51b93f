"""Settings of all tests: float64, strict promotion, and every warning is an error.

The tests have tiers. Tests marked `quick` compile nothing (`make check`), `make test` omits tests
marked `slow`, and `make test-all` omits tests marked `long`. Both report this at their end.
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

# A check that raises in a compiled program calls back into Python, and JAX does not cache such
# programs, so each process would compile them again, including the largest ones. As in the command,
# a failed check therefore gives a NaN (`simulation/raising.py` tests raising). Equinox reads the
# variable when it is imported.
os.environ.setdefault("EQX_ON_ERROR", "nan")

# Programs that the tests compile get the options that `giajax.program` sets, which halves the
# compilation time. The compiler also optimises less, because most programs in a test run only once.
# XLA ends the process if an option is unknown, and the options depend on its version.
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
# Most of the time of these tests is compilation, so compiled programs are kept for later sessions.
# The environment variable shares them with the processes that the tests start.
CACHE = os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
LEAST = os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
jax.config.update("jax_compilation_cache_dir", CACHE)
jax.config.update("jax_persistent_cache_min_compile_time_secs", float(LEAST))

# The command caches a program only if a text can describe its result. Otherwise, each process
# traces the program again, which is easily overlooked. The tests therefore describe all results.


def as_shape(leaf):
    """Return the JAX shape of an array, as a program returns it."""
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf


def describing(function):
    """Wrap `giajax.runtime.programs.program`, and refuse results that a text cannot describe."""
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
        except NoStructureError:  # not cached, which is fine for arguments that only a test uses
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

# Every compiled program maps memory. A process may have 65,530 maps, which are used up after a
# thousand tests, and the compiler would then crash.
MAPS = Path("/proc/self/maps")
MOST_MAPS = 12_000


COMPILING = "/jax/core/compile/backend_compile_duration"
programs = 0


def count_programs(event, duration, **_):
    """JAX listener: count a program that is compiled or read from the cache."""
    global programs
    programs += event == COMPILING


jax.monitoring.register_event_duration_secs_listener(count_programs)


@pytest.fixture
def compiled():
    """Return a function that returns the number of programs compiled by this process so far."""
    return lambda: programs


@pytest.fixture
def own_kinds():
    """Remove the kinds that a test registers."""
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
    """Check that a test marked `quick` compiles nothing, even on a fast machine."""
    before = programs
    outcome = yield
    compiled = programs - before
    if compiled and item.get_closest_marker("quick"):
        pytest.fail(f"marked as quick, and {compiled} programs were compiled: remove the mark")
    return outcome


# All tests of these files share programs that take a minute to compile. An idle worker takes tests
# from the end of another worker's list, so tests at the start of a list stay on one worker.
FIRST = ("test_arm_suspects.py",)


def pytest_collection_modifyitems(items):
    """Move tests that one worker should run to the start."""
    items.sort(key=lambda item: item.path.name not in FIRST)


def pytest_collection_finish():
    """Freeze imported objects, so the garbage collector does not scan them in each pass."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


LEFT_OUT = pytest.StashKey[dict[str, int]]()
# Command that runs the tests of each mark.
RUN_BY = {"slow": "make test-all", "long": "make test-long"}


def pytest_deselected(items):
    """Count the tests that `make test` and `make test-all` omit; other selections omit more."""
    tiers = ("not slow and not long", "not long")
    if not items or (config := items[0].config).option.markexpr not in tiers:
        return
    counts = config.stash.setdefault(LEFT_OUT, dict.fromkeys(RUN_BY, 0))
    for mark in RUN_BY:
        counts[mark] += sum(item.get_closest_marker(mark) is not None for item in items)


def pytest_sessionfinish(session):
    """Report the number of omitted tests from each worker, which is the same for all."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = session.config.stash.get(LEFT_OUT, {})


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Receive the number from a worker of pytest-xdist that has ended."""
    node.config.stash[LEFT_OUT] = getattr(node, "workeroutput", {}).get("left_out", {})


def pytest_terminal_summary(terminalreporter, config):
    """Print which tests were omitted."""
    for mark, number in config.stash.get(LEFT_OUT, {}).items():
        if number:
            terminalreporter.write_sep("-", f"{number} {mark} tests left out: {RUN_BY[mark]}")


@pytest.fixture(autouse=True, scope="module")
def few_programs_at_a_time():
    """Clear the compiled programs of a long session; the disk cache keeps them."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(autouse=True, scope="session")
def every_picture_in_all_formats():
    """Save each figure that a test draws as PNG as SVG and PDF, too, once per title."""
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
                check_pictures(to_png(figure).others, title)

    Figure.savefig = saved
    yield
    Figure.savefig = save


def check_pictures(others, title):
    """Check that an SVG has text as text, a PDF no Type 3 fonts, and that there is a caption."""
    svg, pdf = others["svg"], others["pdf"]
    caption, _ = others["caption.txt"].decode().splitlines()
    head = title.replace("\n", " ") + ". "
    assert caption.startswith(head)
    assert caption.removeprefix(head).endswith(".")
    root = ElementTree.fromstring(svg)
    assert root.tag.endswith("}svg")
    assert root.find(".//{*}text") is not None
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", pdf)) == 1
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf


@pytest.fixture(scope="session")
def browser():
    """Return a browser, or skip the test if there is none."""
    from docs.machinery import browse

    found = browse.installed()
    if found is None:
        pytest.skip(f"no browser, one of {', '.join(browse.BROWSERS)}: make browser")
    return found


@pytest.fixture(scope="session")
def arm_fit(tmp_path_factory):
    """The recording of a short arm, the folder of its fit by the command, and the outcome.

    Copy the folder before anything else is written to it.
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
    """The folder of a muscle's fit with its page, by the command, next to its recording.

    Copy the folder before anything else is written to it.
    """
    from giajax.cli import main

    folder = tmp_path_factory.mktemp("muscle")
    for name in ("muscle.csv", "muscle.toml"):
        shutil.copy(ROOT / "data" / "synthetic" / name, folder / name)
    run = ["fit", "--data", str(folder / "muscle.csv"), "--out", str(folder / "fit"), "--report"]
    assert main([*run, "--no-figures", "--quiet"]) == 0
    return folder / "fit"
