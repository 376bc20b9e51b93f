"""Plans: their entries become cases, and invalid entries give one error message."""

import itertools

import numpy as np
import pytest

import giajax
import small_loops
from giajax import InputError
from giajax.schema import ChannelKind
from giajax.tasks import Plan

pytestmark = pytest.mark.quick


@pytest.fixture
def folder(tmp_path):
    small_loops.write_task(tmp_path)
    return tmp_path


def plan(folder, text):
    (folder / "plan.toml").write_text(f'fit = "loops_fit.toml"\n{text}')
    return Plan.load(folder / "plan.toml")


def test_a_grid_is_every_combination(folder):
    """Quoted and unquoted paths; lists, ranges and logarithmic ranges."""
    made = plan(
        folder,
        """
        [grid]
        loss = ["linear", "huber"]
        [grid.fix]
        offset = { from = 0, to = 1, count = 3 }
        thresholds = [[0.2], 0.3]
        [grid.start]
        elastic = { from = 0.01, to = 1, count = 3, log = true }
        """,
    )
    assert made.columns == ["loss", "fix.offset", "fix.thresholds", "start.elastic"]
    expected = itertools.product(
        ["linear", "huber"], [0.0, 0.5, 1.0], [[0.2], 0.3], pytest.approx([0.01, 0.1, 1.0]).expected
    )
    for case, values in zip(made.cases, expected, strict=True):
        assert list(case.values())[:3] == list(values[:3])
        assert case["start.elastic"] == pytest.approx(values[3])
    fit = made.fit(made.cases[-1]).definition.fit
    assert (fit.loss, fit.fix["offset"], fit.fix["thresholds"]) == ("huber", 1.0, 0.3)
    # Settings that the plan does not mention are those of the fit definition.
    assert fit.start == {"weights[0]": 0.3, "elastic": 1.0}
    assert fit.free == ["elastic", "weights[0]"]


def test_a_list_and_a_sample_with_a_grid(folder):
    made = plan(
        folder,
        """
        [[list]]
        loss = "linear"
        priors.elastic = { value = 1.0, deviation = 0.1 }
        [[list]]
        solver = "tsit5"
        [sample]
        count = 3
        [sample.fix]
        offset = { uniform = [1, 2] }
        [grid]
        data = [["loops.csv"], ["loops.csv", "other.csv"]]
        """,
    )
    assert len(made.cases) == 2 * 3 * 2
    assert made.cases[0]["priors.elastic"] == {"value": 1.0, "deviation": 0.1}
    assert made.cases[-1]["solver"] == "tsit5"
    offsets = [case["fix.offset"] for case in made.cases]
    assert offsets[::2] == offsets[1::2]
    assert offsets[:6] == offsets[6:]
    assert all(1 < offset < 2 for offset in offsets)
    assert made.fit(made.cases[1]).data == (folder / "loops.csv", folder / "other.csv")


def test_ranges_of_whole_numbers_are_whole(folder):
    """This is necessary because some keys accept only integers."""
    made = plan(
        folder,
        """
        [grid]
        max_iterations = { from = 10, to = 2, count = 3 }
        fix.offset = { from = 0, to = 1, count = 3 }
        """,
    )
    numbers = [case["max_iterations"] for case in made.cases[::3]]
    assert numbers == [10, 6, 2]
    assert {type(number) for number in numbers} == {int}
    assert [case["fix.offset"] for case in made.cases[:3]] == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("method", ["sobol", "random"])
def test_a_sample_has_the_distributions_that_are_asked_for(folder, method):
    made = plan(
        folder,
        f"""
        [sample]
        count = 500
        seed = 3
        method = "{method}"
        [sample.start]
        elastic = {{ log_uniform = [0.01, 1] }}
        [sample.fix]
        offset = {{ normal = [2, 0.5] }}
        thresholds = {{ uniform = [-1, 3] }}
        """,
    )
    drawn = {name: np.array([case[name] for case in made.cases]) for name in made.columns}
    loose = {"sobol": 0.02, "random": 0.12}[method]
    assert np.mean(np.log10(drawn["start.elastic"])) == pytest.approx(-1, abs=loose)
    assert np.mean(drawn["fix.offset"]) == pytest.approx(2, abs=loose)
    assert np.std(drawn["fix.offset"]) == pytest.approx(0.5, abs=loose)
    assert np.mean(drawn["fix.thresholds"]) == pytest.approx(1, abs=loose)
    assert np.std(drawn["fix.thresholds"]) == pytest.approx(4 / np.sqrt(12), abs=loose)
    assert np.corrcoef(*(drawn[name] for name in made.columns[:2]))[0, 1] == pytest.approx(
        0, abs=2 * loose
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("girt = 1", "unknown key 'girt'"),
        ("schema_version = 2", "schema_version is not 1"),
        ('data = ["loops.csv"]', "must have either fit"),
        ("out = 1", "out is not a string: give the name of a folder"),
        ("grid = 1", "grid has the wrong type: give a table"),
        ("list = []", "give a list of tables"),
        ("[grid]\nlos = [1]", r"\[grid\]: unknown key 'los'"),
        ("[grid]\nout = ['a']", r"\[grid\]: unknown key 'out'"),
        ("[grid]\nuncertainty.offset = [0.1]", "uncertainty has no effect in a sweep"),
        ("[grid]\nfix = [1]", "fix must be a table of parameter paths"),
        ("[grid]\nloss = 'huber'", "loss is 'huber': give a non-empty list, or a range"),
        ("[grid]\nloss = []", "give a non-empty list, or a range"),
        ("[grid.fix]\noffset = { from = 1, to = 2 }", "give a non-empty list, or a range"),
        (
            "[grid.fix]\noffset = { from = 1, to = 2, count = 0 }",
            "two numbers and a positive count",
        ),
        (
            "[grid.fix]\noffset = { from = -1.7e308, to = 1.7e308, count = 3 }",
            "is too wide a range",
        ),
        ("[grid.fix]\noffset = { normal = [1, 2] }", "give a non-empty list, or a range"),
        (
            "[[list]]\nfix.offset = { from = 1, to = 2, count = 2 }",
            "must be one value: put a range",
        ),
        ("[[list]]\nfix.offset = { uniform = [1, 2] }", "must be one value: put a range"),
        ("[grid.fix]\noffset = {from = -1, to = 2, count = 2, log = true}", "is logarithmic"),
        ("[grid]\nloss = ['linear', 'hubert']", "fit 2: fit.loss = 'hubert' must be"),
        ("[grid.fix]\noffset = ['a']", "fit 1: fit.fix.offset = 'a' must be a finite number"),
        ("[sample]\nsize = 2", r"\[sample\]: unknown key 'size'"),
        ("[sample]\nfix.offset = { uniform = [0, 1] }", "count: give a positive number of draws"),
        ("[sample]\ncount = 2", "draws nothing"),
        ("[sample]\ncount = 2\nseed = -1", "seed: give zero or a positive whole number"),
        ("[sample]\ncount = 2\nmethod = 'grid'", "unknown method: give 'sobol' or 'random'"),
        ("[sample]\ncount = 2\nfix.offset = 1", "give a table of uniform"),
        ("[sample]\ncount = 2\nfix.offset = { uniform = [2, 1] }", "lower end first"),
        ("[sample]\ncount = 2\nfix.offset = { log_uniform = [-1, 1] }", "both positive"),
        ("[sample]\ncount = 2\nfix.offset = { normal = [1, 0] }", "a positive standard deviation"),
        ("[grid]\nfix.offset = [1]\n[[list]]\nfix.offset = 2", "has fix.offset in two of grid"),
        (
            "[grid.fix]\n" + "\n".join(f"p{n} = {list(range(1000))}" for n in range(3)),
            "at most 100,000",
        ),
    ],
)
def test_what_a_plan_may_not_say(folder, text, words):
    with pytest.raises(InputError, match=words) as caught:
        plan(folder, text)
    assert "\n" not in str(caught.value)
    assert "plan.toml" in str(caught.value)


def test_fits_by_an_edited_plug_in_are_others(folder, monkeypatch):
    keys = set()
    for digest in ("one", "one", "two", None):
        added = {} if digest is None else {folder / "laws.py": digest}
        monkeypatch.setattr("giajax.runtime.plugins._PLUGINS", added)
        keys.add(tuple(task.key for task in plan(folder, '[grid]\nloss = ["huber"]').tasks()))
    assert len(keys) == 3


def test_fits_by_an_edited_loss_that_a_module_registers_are_others(folder, monkeypatch):
    body = {"rho": lambda self, r: r**2, "__module__": "planned"}
    giajax.register(type("PlannedLoss", (giajax.fitting.AbstractLoss,), body))
    keys = {"huber": set(), "PlannedLoss": set()}
    for digest in ("one", "two"):
        there = {"planned": ("planned.py", f"sha256 {digest}")}
        monkeypatch.setattr("giajax.runtime.plugins.source", there.get)
        for loss, known in keys.items():
            known.add(plan(folder, f'[grid]\nloss = ["{loss}"]').tasks()[0].key)
    assert {loss: len(known) for loss, known in keys.items()} == {"huber": 1, "PlannedLoss": 2}


@pytest.mark.usefixtures("own_kinds")
@pytest.mark.parametrize("what", ["model", "sensor"])
def test_fits_of_what_only_columns_name_are_others_where_its_module_is(tmp_path, monkeypatch, what):
    (tmp_path / "kite.csv").write_text("time_s,joint01_angle_deg,cord_m\n0,0,1\n1,0,2\n")
    (tmp_path / "plan.toml").write_text('data = ["kite.csv"]\n')
    keys = set()
    row = ChannelKind("cord", "cord", "length", "output")
    body = {"__module__": "kites", "kind": f"planned_{what}"}
    if what == "model":
        methods = dict.fromkeys(("prepare", "predict", "definition"), lambda self: None)
        (tmp_path / "kite.csv").write_text("time_s,cord_m\n0,1\n1,2\n")
        parent, body = giajax.AbstractModel, {**body, "channels": (row,), **methods}
    else:
        shown = {"channel": row, "values": lambda self, motion: motion.times}
        parent, body = giajax.models.AbstractSensor, {**body, **shown}
    giajax.register(type("Kite", (parent,), body))
    for digest in ("one", "two"):
        there = {"kites": ("kites.py", f"sha256 {digest}")}
        monkeypatch.setattr("giajax.runtime.plugins.source", there.get)
        keys.add(Plan.load(tmp_path / "plan.toml").tasks()[0].key)
    assert len(keys) == 2


def test_fits_are_known_by_their_content(folder):
    """The key depends on the content of the files, sidecars, settings and samples, not on paths."""
    text = '[grid]\nloss = ["linear", "huber"]'
    before = [task.key for task in plan(folder, text).tasks()]
    assert len(set(before)) == 2
    moved = folder / "moved"
    moved.mkdir()
    small_loops.write_task(moved)
    (moved / "loops_fit.toml").write_text(f"# a comment\n{small_loops.DEFINITION}")
    assert [task.key for task in plan(moved, text).tasks()] == before
    assert [task.key for task in plan(moved, text.replace("linear", "soft_l1")).tasks()] == [
        task.key for task in plan(moved, "[grid]\nloss = ['soft_l1', 'huber']").tasks()
    ]
    (moved / "loops.toml").write_text('model = "hysteresis"\n')
    assert not set(before) & {task.key for task in plan(moved, text).tasks()}
    (moved / "loops.toml").unlink()
    small_loops.write_loops(moved / "loops.csv", (0, 1, -0.5), seed=1)
    assert not set(before) & {task.key for task in plan(moved, text).tasks()}
    (moved / "loops.csv").unlink()
    with pytest.raises(InputError, match=r"loops\.csv no longer exists"):
        plan(moved, text).tasks()
