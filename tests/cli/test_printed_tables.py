"""Tables of the command line can be read and copied."""

import re
import shlex
from types import SimpleNamespace

import pytest
from rich.console import Console

import small_loops
from giajax.cli import main
from giajax.cli._commands import print_table
from giajax.cli._fit import Progress
from giajax.fitting import Iteration
from giajax.runtime.text import ShownAsTable, format_range
from giajax.tasks import FitTask
from page_reader import Page

NAMES = ("links.inertia_transverse", "joints.pitch_stiffness", "air.drag_coefficient")
MEANING = "what a reader wants to know of it, in a sentence that goes over several lines"
HEADINGS = ["parameter", "unit", "value", "meaning"]
ROWS = [[name, "kg m^2", 0.00436747, MEANING] for name in NAMES]


@pytest.mark.quick
@pytest.mark.parametrize("width", ["30", "60", "80", "200"])
def test_a_terminal_shows_every_name_and_number_whole(monkeypatch, capsys, width):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", width)
    print_table(HEADINGS, ROWS)
    said = capsys.readouterr().out
    assert "\N{HORIZONTAL ELLIPSIS}" not in said
    lines = said.splitlines()
    for name in NAMES:
        assert any(line.startswith(f"{name} ") and "0.0043675" in line for line in lines)
    assert all(word in said.split() for word in MEANING.split())
    # If the terminal is wide enough, no line is longer than it.
    if int(width) >= 80:
        assert max(map(len, lines)) <= int(width)


@pytest.mark.quick
def test_elsewhere_a_row_is_a_line(capsys):
    print_table(HEADINGS, ROWS)
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(ROWS)


class Shown(ShownAsTable):
    def _table(self):
        return "Several", HEADINGS[:2], [(name, MEANING) for name in NAMES]


@pytest.mark.quick
def test_rich_shows_every_name_whole():
    console = Console(width=50, color_system=None)
    with console.capture() as captured:
        console.print(Shown())
    for name in NAMES:
        assert name in captured.get()


FREE = ("joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping", "air.drag_coefficient")
MANY = [f"{path}[{index}]" for index, path in enumerate(FREE * 2)]


def progress_lines(paths, capsys, monkeypatch):
    """Return the heading and one row of the progress of a fit of these parameters."""
    monkeypatch.setattr("giajax.fitting.column_factors", lambda model: {})
    progress = Progress(SimpleNamespace(model=None, nuisances=()))
    capsys.readouterr()
    progress(Iteration(0, 1589.52, 0.0, True, dict.fromkeys(paths, 1234.5)))
    return capsys.readouterr().err.splitlines()


@pytest.mark.quick
def test_progress_has_whole_names_where_no_terminal_is(capsys, monkeypatch):
    heading, row = progress_lines(FREE, capsys, monkeypatch)
    assert heading.split() == ["cost", "step", "taken", *FREE]
    assert row.split() == ["0", "1589.52", *["1234.5"] * 4]


@pytest.mark.quick
@pytest.mark.parametrize(("paths", "shown"), [(FREE, 4), (MANY, 3), (FREE[:1], 1)])
def test_progress_in_80_columns_cuts_no_name(paths, shown, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    lines = progress_lines(paths, capsys, monkeypatch)
    assert max(map(len, lines)) <= 80
    *head, row = lines
    if shown < len(paths):
        assert head.pop() == f"({len(paths) - shown} more parameters do not fit in the terminal)"
    assert len(row.split()) == 2 + shown
    ends = [match.end() for match in re.finditer(r"\S+", row)][2:]
    for path, (start, end) in zip(paths, zip([34, *ends], ends, strict=False), strict=False):
        assert "".join(line[start:end].strip() for line in head) == path


@pytest.mark.quick
def test_an_interval_ends_where_the_error_says():
    assert format_range((1.08671, 1.13291), 0.0121) == "1.087 .. 1.133"
    assert format_range((0.0, None), 0.0121) == "0.000 .. open"
    assert format_range((1.08671, 1.13291)) == "1.0867 .. 1.1329"


@pytest.mark.quick
def test_what_follows_can_be_pasted(tmp_path, monkeypatch, capsys):
    """Each command names the next one, with names that a shell must not split."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "my runs"
    folder.mkdir()
    (folder / "run.csv").write_text(
        "t,joint01_command_deg,link06_z_m\n0,0,0.1\n0.1,30,0\n0.2,30,0\n"
    )
    words = ["check", "--data", "my runs/run.csv", "--rename", "t=time_s"]
    seen = []
    for _ in range(3):
        assert main(words) == 0
        (line,) = re.findall(r"next: giajax (.*)$", capsys.readouterr().out, re.MULTILINE)
        words = shlex.split(line)
        seen.append(words[0])
    assert seen == ["init", "check", "fit"]
    assert words == ["fit", "--data", "my runs/run.csv", "--rename", "t=time_s"]


def test_each_parameter_of_the_tables_of_a_fit_can_be_pasted(tmp_path, monkeypatch, capsys):
    """The fit has a value for each run, and a parameter that the data do not determine."""
    monkeypatch.chdir(tmp_path)
    small_loops.write_task(tmp_path)
    definition = small_loops.DEFINITION.replace("offset = 0.1", "").replace(
        '"weights[0]"]', '"weights[0]", "offset", "previous_extremes"]\nper_run = ["offset"]'
    )
    (tmp_path / "two.toml").write_text(
        definition.replace('data = ["loops.csv"]', 'data = ["loops.csv", "other.csv"]')
    )
    (tmp_path / "plan.toml").write_text('fit = "two.toml"\n[grid]\nloss = ["soft_l1"]\n')

    def table(command):
        """Return the cells of the first table that a command prints."""
        assert main(command.split()) == 0
        lines = capsys.readouterr().out.partition("\n\n")[0].splitlines()
        return [re.split(r"\s{2,}", line.strip()) for line in lines]

    tables = [
        table("fit two.toml --out fit --no-figures --no-suspects"),
        table("compare fit fit"),
        table("profile fit --parameter offset --no-figures"),
        table("bootstrap fit --size 2 --no-figures"),
    ]
    swept = dict(list(zip(*table("sweep plan.toml")[:2], strict=True))[2:-1])
    assert main(["report", "fit"]) == 0
    page = Page((tmp_path / "fit" / "report.html").read_bytes()).rows
    # The page has the tables of estimates, of profiles and of repetitions.
    assert sum(row[:2] in (["parameter", "run"], ["quantity", "run"]) for row in page) == 3
    runs = {"all", "loops", "other"}
    tables.append([["parameter", "run"], *(row for row in page if {*row[1:2]} & runs)])

    seen = set(swept)
    for (_, heading, *_), *rows in tables:
        assert heading == "run"
        assert runs >= {row[1] for row in rows}
        seen |= {row[0] for row in rows}
    assert seen == {"elastic", "weights[0]", "offset", "previous_extremes[0]"}
    for path in seen:
        again = FitTask.load("two.toml").on_top(free=[path], origin="the test").prepare()
        assert path in [one.path for one in again.setup.parameters]

    # What the data do not determine is marked.
    (compared,) = (row for row in tables[1] if row[0] == "previous_extremes[0]")
    for cell in (*compared[3:5], swept[compared[0]]):
        assert cell.endswith(" (not determined)")
