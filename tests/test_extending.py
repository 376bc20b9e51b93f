"""The examples of docs/extending, as scripts and as plug-ins of commands in new processes."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import giajax
from giajax.cli import main
from giajax.recordings import Definition, parse_column
from giajax.runtime.plugins import registered
from giajax.schema import KINDS, ChannelKind, Declaration, Group, Key, Section, with_keys

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "extending"
RESULTS = {
    "cauchy_loss": "robust",
    "coffee_filter": "filter",
    "fullness_drag": "fullness",
    "hardening_joint": "hardening",
    "strain_gauge": "strain",
    "tethered_balloon": "balloon",
    "wind_profile": "profile",
}


PAGE = (EXAMPLES.parent / "own_model.md").read_text(encoding="utf-8")
# The commands on the page about user-defined models.
COFFEE_FILTER = [
    line.replace(" --plugin coffee_filter.py", "").split()
    for line in re.findall(r"^\$ giajax (.*)$", PAGE, re.MULTILINE)
]


COMMANDS = """
import json, sys
from giajax.cli import main

for words in json.loads(sys.argv[1]):
    if status := main(words):
        sys.exit(f"{words} ended with {status}")
"""


@pytest.mark.quick
def test_the_page_on_a_model_of_ones_own_shows_the_example():
    block = re.search(r"```python\n(.*?)\n\nassert", PAGE, re.DOTALL)[1]
    assert block.strip() in (EXAMPLES / "coffee_filter.py").read_text(encoding="utf-8")
    assert len(COFFEE_FILTER) > 5
    assert PAGE.count("\n") <= 100


@pytest.mark.quick
def test_each_example_is_one_file_of_at_most_60_lines_that_asserts():
    texts = {path.stem: path.read_text() for path in EXAMPLES.glob("*.py")}
    assert texts.keys() == RESULTS.keys()
    for text in texts.values():
        assert text.count("\n") <= 60
        assert "assert" in text


# Each takes minutes. The example of the page on user-defined models tests the same functions.
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name == "coffee_filter" else pytest.mark.long)
        for name in RESULTS
    ],
)
def test_an_example_is_fitted_saved_loaded_reported_asked_and_fitted_again(
    name, tmp_path, monkeypatch, capsys
):
    plugin, folder = EXAMPLES / f"{name}.py", RESULTS[name]
    monkeypatch.chdir(tmp_path)

    def run(*words):
        done = subprocess.run([sys.executable, *words], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    run(plugin)
    file = f"{folder}/prediction.csv"
    # The script has tested for suspects of the law. Workers import a plug-in, too.
    report = ("report", folder)
    fit = ("fit", "--data", file, "--no-suspects", "--no-figures")
    commands = {
        "cauchy_loss": [report, (*fit, "--loss", "CauchyLoss")],
        "coffee_filter": [*COFFEE_FILTER, ("init", "--data", "filter.csv", "--force")],
    }
    words = [[*each, "--plugin", str(plugin)] for each in commands.get(name, [report, fit])]
    # In another process than the script, but all together, because importing JAX takes long.
    run("-c", COMMANDS, json.dumps(words))
    # The script writes a result, except that of the coffee filter, whose page uses a command.
    if checked := json.loads(Path(folder, "result.json").read_text())["gradient_check"]:
        assert checked["relative_difference"] < 1e-4
    # Without the plug-in, which this process has not imported.
    assert main(["report", folder, "--force"]) == 2
    assert f"the result was made with {name}.py: give --plugin {name}.py" in capsys.readouterr().err
    if name == "coffee_filter":
        assert main(["check", "--data", "filter.csv"]) == 2
        said = capsys.readouterr().err
        assert "or a registered model: correct the name, give --plugin FILE.py" in said


def test_a_model_that_is_not_registered_is_refused_with_what_it_was_made_with():
    with pytest.raises(giajax.InputError, match="there is no kind of model 'zeppelin': use"):
        giajax.models.build_model("zeppelin", {}, {})


class _Balloon(Group):
    volume = Declaration(1.0, "m^3", "volume when full", key=Key("volume_m3"))


@with_keys(_Balloon(""))
class BalloonSection(Section):
    """`[balloon]`."""


def balloon(kind="balloon", **more):
    """Return a class of models that is not registered yet."""
    body = {
        "__module__": "balloons",
        "kind": kind,
        "channels": (ChannelKind("fullness", "balloonNN_fullness", "ratio", "output"),),
        **dict.fromkeys(("prepare", "predict", "definition"), lambda self: None),
        **more,
    }
    return type("Balloon", (giajax.AbstractModel,), body)


def row(column, quantity, part="output", **more):
    """Return the channels of a model with one channel."""
    return (ChannelKind("cord", column, quantity, part, **more),)


@pytest.mark.quick
@pytest.mark.usefixtures("own_kinds")
def test_a_registered_model_with_channels_is_a_kind_of_runs_with_columns_and_a_section():
    earlier = Definition.parse({"origin": "before"})
    with pytest.raises(giajax.InputError, match="not in the column table"):
        parse_column("balloon02_fullness")
    giajax.register(balloon(section=BalloonSection))
    assert parse_column("balloon02_fullness").index == 2
    values = {"balloon01_fullness": [1.0, 0.9]}
    run = giajax.Run.from_arrays([0.0, 1.0], values, definition={"balloon": {"volume_m3": 2}})
    assert run.model == "balloon"
    assert run.definition.section(BalloonSection).values() == {"volume": 2.0}
    assert run.definition.contents() == {"balloon": {"volume_m3": 2}}
    assert earlier.section(BalloonSection).values() == {}
    assert earlier.merged_with(run.definition).contents().keys() == {"origin", "balloon"}
    with pytest.raises(giajax.InputError, match=r"unknown key balloon.volume: did you mean"):
        Definition.parse({"balloon": {"volume": 2}})
    assert type(giajax.model_for([run])) is registered("model", "balloon")
    # A notebook cell that was changed and is run again.
    other = type("BalloonSection", (Section,), {})
    giajax.register(balloon(section=other, timed=False))
    assert giajax.Run.from_arrays(None, values).definition.section(other) == other()


@pytest.mark.quick
@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"kind": "camera"}, r"a section \[camera\] already exists: give the model another kind"),
        (
            {"channels": (ChannelKind("tip", "tip_x", "angle", "output"),)},
            "a channel tip_x already exists, the length 'tip_position': declare tip_x, the angle",
        ),
        (
            {"channels": (ChannelKind("force", "force", "torque", "output"),)},
            "a channel force already exists, the force 'force'",
        ),
        (
            {"channels": (ChannelKind("fullness", "fullness", "litres", "output"),)},
            "the channel fullness has the unknown quantity 'litres': use time, angle",
        ),
        (
            {"kind": property(lambda self: "kite")},
            r"Balloon.kind is <property .*: make it a "
            r"string",
        ),
        ({"kind": "contents"}, "no section can have the name 'contents': give the model another"),
        ({"kind": "my kite"}, "no section can have the name 'my kite': give the model another"),
        ({"channels": ("height",)}, r"channels is \('height',\): make it a tuple of .*ChannelKind"),
        (
            {"channels": row("x(", "length")},
            r"the channel x\( is not a valid name: use letters, digits",
        ),
        (
            {"channels": row("aNN_bNN", "length")},
            "the channel aNN_bNN is not a valid name: .* NN at most once",
        ),
        ({"channels": row("time", "length")}, "the channel time of the row .* rename it"),
        ({"channels": row("cord", "length", "measured")}, "has the unknown part 'measured': use"),
        (
            {"channels": row("cord", "text")},
            "the channel cord is a text channel without values: give them",
        ),
        (
            {"channels": row("cord", "length", noise="position")},
            "cord refers to the unknown noise key 'position': use position_m, or omit it",
        ),
        (
            {"channels": row("cord", "force", noise="position_m")},
            "cord refers to the unknown noise key 'position_m': omit it",
        ),
    ],
)
def test_a_kind_that_contradicts_what_there_is_is_refused(more, said):
    kinds, wrong = dict(KINDS), balloon(**{"kind": "wrong", **more})
    with pytest.raises(giajax.InputError, match=said):
        giajax.register(wrong)
    assert kinds == KINDS
    assert registered("model", "wrong") is None


@pytest.mark.quick
@pytest.mark.usefixtures("own_kinds")
def test_the_model_of_a_package_is_imported_where_a_sidecar_names_it(tmp_path, monkeypatch):
    class Entry:
        def load(self):
            channels = (ChannelKind("fullness", "fullness", "ratio", "output"),)
            return balloon(kind="packaged", channels=channels)

    def entries(group, name):
        return [Entry()] if (group, name) == ("giajax.models", "packaged") else []

    monkeypatch.setattr("importlib.metadata.entry_points", entries)
    data = tmp_path / "balloon.csv"
    data.write_text("time_s,fullness\n0,1\n1,0.9\n")
    with pytest.raises(giajax.InputError, match="not in the column table"):
        giajax.read_run(data)
    data.with_suffix(".toml").write_text('model = "packaged"\n')
    run = giajax.read_run(data)
    assert run.kind.name == "packaged"
    # A worker process receives only the run.
    monkeypatch.setattr("giajax.runtime.plugins._CLASSES", {})
    del KINDS["packaged"]
    assert run.kind.outputs == ("fullness",)
    with pytest.raises(giajax.InputError, match=r"model = 'other' must be .*, or a registered"):
        Definition.parse({"model": "other"})
    giajax.register(balloon(kind="mute", channels=()))
    with pytest.raises(giajax.InputError, match="'mute' is a model that declares no channels"):
        Definition.parse({"model": "mute"})


@pytest.mark.quick
@pytest.mark.usefixtures("own_kinds")
def test_a_fit_of_several_kinds_one_of_which_is_ones_own_is_loaded():
    kite = balloon(kind="kite", channels=row("cord", "length"), definition=lambda self: {})
    sized = {"definition": lambda self: {"size": 3}, "from_definition": classmethod(from_size)}
    giajax.register(kite)
    giajax.register(balloon(**sized))
    bench = giajax.Run.from_arrays(
        None, {"pressure": [1e5], "contraction": [0.1], "phase": ["fill"], "force": [1.0]}
    )
    runs = [giajax.Run.from_arrays([0.0, 1.0], {name: [1.0, 2.0]}) for name in FULL]
    model = giajax.model_for([bench, *runs])
    stored = model.definition()
    assert stored["muscle"]
    assert stored["definitions"] == {"balloon": {"size": 3}}
    loaded = giajax.models.build_model(model.kind, stored, {})
    assert [part.kind for part in loaded.parts] == ["muscle", "kite", "balloon"]
    needs = balloon(kind="needs", channels=row("needs", "length"), __annotations__={"size": float})
    with pytest.raises(
        giajax.InputError, match="the model Balloon cannot be created from defaults"
    ):
        needs.for_runs(runs)


FULL = ("cord", "balloon01_fullness")


def from_size(cls, definition):
    assert definition == {"size": 3}
    return cls()
