"""The grammar of the command line: option names, their old forms, and the help texts."""

import itertools
import re
import shlex
from pathlib import Path
from types import NoneType
from typing import get_args, get_origin, get_type_hints

import pytest
import typer

from giajax.cli import _app, main
from giajax.cli._commands import COMMANDS, GROUPS, command, old_forms, with_options

pytestmark = pytest.mark.quick

NAMES = _app.command_names()
GROUP = typer.main.get_command(_app._app_for(NAMES))
WIDTH = 80


def help_of(words, capsys, monkeypatch):
    """Return the help as a terminal of 80 columns shows it."""
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    assert main([*words, "--help"]) == 0
    return capsys.readouterr().out


def options_of(name):
    """Return the options of a command by name, without its arguments."""
    named = ((option, each) for each in GROUP.commands[name].params for option in each.opts)
    return {option: each for option, each in named if option.startswith("-")}


def meanings_of(name):
    """Return the options of a command by name: metavar, type, and whether they may be repeated."""
    each = COMMANDS[name]
    kinds = get_type_hints(with_options(each))
    for parameter in GROUP.commands[name].params:
        if parameter.opts[0].startswith("-"):
            hint = kinds[parameter.name]
            union = [each for each in get_args(hint) if each is not NoneType]
            kind = hint if get_origin(hint) is list or not union else union[0]
            several = get_origin(kind) is list
            kind = get_args(kind)[0] if several else kind
            for option in parameter.opts:
                yield option, (parameter.metavar, kind, several)


# One name has one meaning.

EXCEPTIONS = {
    "--data": "a fit is of several runs, and what is looked at or made again is one",
    "--free": "the numbers of a wind have names, and are no parameters of a model",
    "--to": "the metavar says which kind of file a command makes",
}


def test_no_option_means_two_things():
    meanings = {}
    for name in NAMES:
        for option, meaning in meanings_of(name):
            meanings.setdefault(option, {}).setdefault(meaning, []).append(name)
    two = {option: found for option, found in meanings.items() if len(found) > 1}
    assert two.keys() == EXCEPTIONS.keys(), two
    assert {metavar for metavar, _, _ in meanings["--out"]} == {"DIR"}
    assert {metavar for metavar, _, _ in meanings["--page"]} == {"FILE.html"}
    assert {metavar for metavar, _, _ in meanings["--data"]} == {"RUN.csv"}


# Options whose help texts differ, because a command says what it does with the same thing, each
# with the words that all of its texts share in lower case. All other options have one text.
SHARED = {
    "--arm": "toml file with",  # which of its sections the command reads
    "--channels": "channel",  # named to be recorded or to be used
    "--command": "run",  # what is taken from it beside the commands
    "--data": "run",  # what is done with it
    "--duration": "duration of the",  # of a run, or of the command for one
    "--free": "parameter",  # fitted instead of others, or also
    "--gusts": "intensity and length scale (m) of the gusts",  # simulated, assumed or initial
    "--max-iterations": "maximum number of",  # steps of a fit, or of each command of a design
    "--out": "folder",  # which files are written into it
    "--page": "page",  # what it shows
    "--parameter": "parameter",  # what is done with it
    "--report": ".html",  # its name
    "--resume": "in this folder",  # what is continued
    "--seed": "seed of",  # what is random
    "--strict": "exit with status 3 if",  # what fails
    "--to": "output file",  # its kind
    "--travel": "over which the branch changes",  # its unit
    "--truth": "true angles",  # what is compared with them
    "--wind": "mean wind velocity (m/s)",  # known, or the initial value of an estimate
}


def test_the_help_texts_of_an_option_say_the_same():
    texts = {}
    for name in NAMES:
        for option, each in options_of(name).items():
            text = re.sub(r" Repeatable[.]| \[default.*\]$", "", each.help or "")
            texts.setdefault(option, set()).add(text)
    several = {option: found for option, found in texts.items() if len(found) > 1}
    apart = {option: found for option, found in several.items() if option not in SHARED}
    assert apart == {}
    assert SHARED.keys() == several.keys()
    for option, words in SHARED.items():
        assert [text for text in several[option] if words not in text.lower()] == [], option


@pytest.mark.parametrize("name", NAMES)
def test_a_command_that_draws_has_formats_and_a_resolution(name):
    known = options_of(name)
    said = [COMMANDS[name].examples, *(each.help or "" for each in GROUP.commands[name].params)]
    draws = "--figures" in known or re.search(
        r"\bPNG\b|[.]png|(pictures|figures), and", " ".join(said)
    )
    assert ("--format" in known, "--dpi" in known) == (bool(draws),) * 2


WRITTEN = ("--out", "--to", "--page", "--copy")
BESIDE = ("init", "profile")  # commands that write next to their input


@pytest.mark.parametrize("name", NAMES)
def test_what_writes_has_force_and_quiet_and_what_prints_has_neither(name):
    known = options_of(name)
    writes = name in BESIDE or any(option in known for option in WRITTEN)
    for option, text in (
        ("--force", "Overwrite existing files."),
        ("--quiet", "Print errors only."),
    ):
        assert (option in known) == writes
        assert not writes or known[option].help == text


# Former forms.

OLD = [
    (name, form, *pair)
    for name in NAMES
    for form, pair in old_forms(GROUP.commands[name], COMMANDS[name]).items()
]
VALUE = "7"


def typed(line):
    """Return the words of a form after the command, with a value for each metavar."""
    words = line.split()[2:]
    return [word if word.startswith("--") else value_for(word) for word in words]


def value_for(metavar):
    """Return a value with the beginning ("last:F") and the file ending of a metavar."""
    return metavar[: metavar.rfind(":") + 1] + VALUE + Path(metavar).suffix


def arguments(line):
    """Return the words of a line that are not values of options."""
    words = line.split()
    return [word for before, word in itertools.pairwise(words) if not before.startswith("--")]


def required(name, *lines):
    """Return words for the required parameters of a command that none of these lines gives."""
    words = []
    for each in GROUP.commands[name].params:
        if each.required and not any(each.opts[0] in line.split() for line in lines):
            if each.opts[0].startswith("-"):
                words += [each.opts[0], VALUE]
            elif not any(each.metavar in arguments(line) for line in lines):
                words.append(VALUE)
    return words


def parsed(name, words):
    return GROUP.commands[name].make_context(name, list(words)).params


def note(old, new):
    return f"note: {old} is now {new}; the old form works until 1 December 2027\n"


WITH_VALUE = [
    (name, old, new) for name, form, old, new in OLD if form[:2] == "--" and len(typed(old)) == 2
]
QUIET = [(name, old, new) for name, _, old, new in OLD if "--quiet" in options_of(name)]
# Without forms of which only the value is old, or which have no replacement.
APART = [(name, old, new) for name, form, old, new in OLD if " " not in form and typed(new)]


def test_there_are_old_forms():
    assert len(OLD) >= 39
    assert len(set(_app.old_forms())) == len(OLD)


@pytest.mark.parametrize(("name", "form", "old", "new"), OLD)
def test_an_old_form_is_the_new_one_with_a_note(name, form, old, new, capsys):
    before, beside = typed(old), required(name, old, new)
    after = before if " " in form else typed(new)
    found = parsed(name, [*before, *beside])
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == note(old, new)
    assert found == parsed(name, [*after, *beside])
    assert capsys.readouterr().err == (said.err if " " in form else "")


@pytest.mark.parametrize(("name", "old", "new"), WITH_VALUE)
def test_an_old_form_with_an_equals_sign(name, old, new, capsys):
    before, beside = typed(old), required(name, old, new)
    found = parsed(name, ["=".join(before), *beside])
    assert capsys.readouterr().err == note(old, new)
    assert found == parsed(name, [*before, *beside])


@pytest.mark.parametrize(("name", "old", "new"), QUIET)
def test_a_quiet_command_has_no_note(name, old, new, capsys):
    parsed(name, [*typed(old), *required(name, old, new), "--quiet"])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("name", "old", "new"), APART)
def test_an_old_form_beside_the_new_one_is_refused(name, old, new, capsys):
    before, after = typed(old), typed(new)
    assert main([name, *before, *after, *required(name, old, new)]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    # If the option is now an argument, a word is left over.
    expected = "is also given: omit one of them" if "--" in new else "unexpected extra argument"
    assert expected in said


def test_words_behind_two_dashes_and_too_many(capsys):
    assert parsed("check", ["--", "-7"])["data"] == Path("-7")
    assert parsed("profile", ["7", "a", "--level", "0.5", "--", "-b"])["parameter"] == ["a", "-b"]
    assert parsed("report", ["--", "-7"])["result"] == Path("-7")
    capsys.readouterr()
    assert main(["check", "a.csv", "b.csv"]) == 2
    assert "unexpected extra argument(s) (b.csv)" in capsys.readouterr().err
    assert main(["check", "a.csv", "--data", "b.csv"]) == 2
    assert "but --data is also given: omit one of them" in capsys.readouterr().err
    assert main(["suspects", "a", "--most"]) == 2
    assert "option '--rows' requires an argument" in capsys.readouterr().err.lower()
    assert main(["report", "a", "--out"]) == 2
    assert "option '--page' requires an argument" in capsys.readouterr().err


def test_an_old_option_that_is_given_again_counts_last(capsys):
    words = ["--model", "first", "--model", "-last", "--data", "run.csv"]
    assert parsed("predict", words)["model"] == Path("-last")
    assert capsys.readouterr().err.count("note: ") == 1


def test_a_note_is_of_words_that_are_understood(capsys):
    assert main(["check", "a.csv", "--foo"]) == 2
    assert "note" not in capsys.readouterr().err


# Help texts.


def test_every_command_has_a_group_of_the_help(capsys, monkeypatch):
    text = help_of([], capsys, monkeypatch)
    sections = dict(re.findall(r"^(\w[\w ]*):\n((?:  \w.*\n)+)", text, re.MULTILINE))
    assert list(sections) == list(GROUPS.values())
    shown = [line.split()[0] for rows in sections.values() for line in rows.splitlines()]
    assert shown == NAMES
    assert sorted(shown) == sorted(COMMANDS)
    assert NAMES[:4] == ["check", "fit", "report", "view"]
    with pytest.raises(TypeError, match="group"):
        command("")
    with pytest.raises(ValueError, match="there is no group 'odd'"):
        command("", group="odd")


@pytest.mark.parametrize("name", ["", *NAMES])
def test_help_is_whole_in_80_columns(name, capsys, monkeypatch):
    text = help_of([name] if name else [], capsys, monkeypatch)
    assert [line for line in text.splitlines() if len(line) > WIDTH] == []
    cut = [line for line in text.splitlines() if "…" in line or "..." in line]
    # Three dots mark an argument that may be repeated.
    assert [line for line in cut if not re.search(r"(ARGS\]|RESULT\}?|WHAT\}?)\.\.\.", line)] == []


@pytest.mark.parametrize("name", ["", *NAMES])
def test_every_example_of_a_help_says_what_it_does(name, capsys, monkeypatch):
    text = help_of([name] if name else [], capsys, monkeypatch)
    block = re.search(r"^  Examples?:\n(.*?)(?:\n\n|\Z)", text, re.MULTILINE | re.DOTALL)[1]
    examples = re.split(r"^    (?=giajax )", block, flags=re.MULTILINE)[1:]
    assert len(examples) > 0
    described = re.compile(r"^.{30}(?<=  )\S", re.MULTILINE)
    assert [each for each in examples if not described.search(f"    {each}")] == []
    for each in examples:
        line = re.sub(r" *\\\n +", " ", each).splitlines()[0]
        words = shlex.split(re.sub(r"(?<=\S)  +\S.*", "", line))
        assert words[1] in COMMANDS
        parsed(words[1], words[2:])
        assert capsys.readouterr().err == ""
