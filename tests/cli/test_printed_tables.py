"""Tables of the command line: what is printed can be read and copied."""

import pytest
from rich.console import Console

from giajax.cli._commands import print_table
from giajax.runtime.text import ShownAsTable

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
    # Where there is room, no line is longer than the terminal.
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
