"""Former tracebacks, endless loops and silent misreadings: one sentence and status 2."""

import os
import re
from pathlib import Path

import pytest

from giajax.cli import main
from giajax.recordings import Definition, Run, read_run, windows, write_files
from giajax.runtime import limits as _limits
from giajax.runtime.text import InputError

pytestmark = pytest.mark.quick

ROOT = Path(__file__).resolve().parents[2]

HEAD = "time_s,joint01_command_deg,link06_z_m\n"
DEEP, ABOVE = "more than 32 levels deep", "number above 1,000"
GOOD = HEAD + "0,0,0.1\n0.1,30,0.2\n0.2,30,0.3\n"
MANY = ",".join(["time_s", *(f"link{index}_z_m" for index in range(100_000))])
LEAP = HEAD + "".join(f"{time},0,0\n" for time in (0, 0.01, 0.02, 0.03, 40, 50, 60))
BODY = "[[arm.point_masses]]\nlink = 25\nmass_kg = 1\nposition_m = 0.5\n"

# content of run.csv, content of run.toml, and a required part of the message
CASES = {
    "links of 5,000 digits": (GOOD, f"[arm]\nlinks = {'9' * 5_000}", ["more than 64 bits"]),
    "links in hexadecimal": (GOOD, f"[arm]\nlinks = 0x{'f' * 50_000}", ["more than 64 bits"]),
    "links = 1e9": (GOOD, "[arm]\nlinks = 1000000000", ["arm.links", "from 1 to 1000"]),
    "links = 100000": (GOOD, "[arm]\nlinks = 100000", ["arm.links", "from 1 to 1000"]),
    "a list of 2,000 links": (GOOD, f"[arm]\nlink_mass_kg = [{'1,' * 2_000}]",
                              ["2000 values", "1000 links"]),
    "a body on no link": (GOOD, BODY, ["link 25", "20 links"]),
    "a mesh of 1e9 rows": (GOOD, "[hysteresis]\nrows = 1000000000", ["from 2 to 1000"]),
    "deep lists": (GOOD, f"[truth]\na = {'[' * 20_000}{']' * 20_000}", [DEEP]),
    "deep tables": (GOOD, f"truth = {'{a = ' * 5_000}1{'}' * 5_000}", [DEEP]),
    "a deep heading": (GOOD, f"[{'a.' * 20_000}a]", [DEEP]),
    "a deep key": (GOOD, f"{'a.' * 400_000}a = 1", [DEEP]),
    "a deep quoted key": (GOOD, f"""{'"a" . ' * 20_000}a = 1""", [DEEP]),
    "a sidecar of 2 MB": (GOOD, "#" * 2_000_000, ["2,000,000 bytes", "at most 1,048,576"]),
    "a parameter outside its bounds": (GOOD, '[arm.parameters]\n"air.drag_coefficient" = -5',
                                       ["arm.parameters", "air.drag_coefficient", "-5", "50"]),
    "an element outside its bounds": (GOOD, '[arm.parameters]\n"links.mass[2]" = -1', ["mass[2]"]),
    "a key and a path": (GOOD, '[arm]\nlink_mass_kg = 1\nparameters."links.mass" = 2',
                         ["links.mass twice", "link_mass_kg"]),
    "a path quoted and not": (GOOD, '[arm.parameters]\n"air.density" = 1\nair.density = 2',
                              ["'air.density' twice"]),
    "noise in two units": (GOOD, "[noise]\nlink06_z_m = 0.1\nlink06_z_cm = 1",
                           ["'link06_z_cm'", "'link06_z_m'", "remove one"]),
    "a key of a megabyte": (GOOD, f"[arm]\n{'q' * 1_000_000} = 1", ["unknown key arm.qqq"]),
    "noise of a megabyte": (GOOD, f"[noise]\n{'q' * 1_000_000} = 1", ["[noise] key 'qqq"]),
    "a quoted key of a megabyte": (GOOD, f'[arm]\n"{"q " * 500_000}" = 1', ["unknown key arm."]),
    "a value of a megabyte": (GOOD, f'[arm]\nlinks = "{"q" * 1_000_000}"', ["arm.links = 'qqq"]),
    "a long cell": (GOOD.replace("0.2\n", "1" * 140_000 + "\n"), None, ["140,000 characters"]),
    "a long quoted cell": (GOOD.replace("0.2\n", f'"{"1" * 140_000}"\n'), None, ["row 3", "1,000"]),
    "a long name": (GOOD.replace("link06_z_m", "l" * 140_000), None, ["row 1", "140,000"]),
    "joint 999...": (GOOD.replace("01", "9" * 900), None, [f"joint with a {ABOVE}"]),
    "joint 1001": (GOOD.replace("01", "1001"), None, ["'joint1001_command_deg'", ABOVE]),
    "100,000 columns": (f"{MANY}\n{'0,' * 100_000}0\n", None, ["100,001 columns", "10,000"]),
    "times to 1e300": (GOOD.replace("0.2,30", "1e300,30"), None, ["1e+300 s", "row 4"]),
    "times from -1e308": (GOOD.replace("0,0,", "-1e308,0,"), None, ["-1e+308 s", "row 2"]),
    "a gap of 1e6 s": (GOOD.replace("0.2,30", "1e6,30"), None, ["row 4", "3600 s"]),
    "a long run": (HEAD + "".join(f"{hour * 3600},0,0\n" for hour in range(40)), None,
                   ["lasts 140400 s"]),
    "no time between": (GOOD.replace("0.1,30", "1e-300,30"), None, ["row 3", "1e-09 s"]),
    "from s to ms": (LEAP, None, ["from 0.03 s to 40 s", "row 6", "milliseconds"]),
    "an absurd value": (GOOD.replace("0.2\n", "1e200\n"), None, ["1e+200", "row 3"]),
    "text after a quote": (GOOD.replace("0.2\n", '"1"2\n'), None, ["row 3", "quotation mark"]),
    "text before a quote": (GOOD.replace("0.2\n", '1"2"\n'), None, ["'1\"2\"' in row 3"]),
    "an open quote": (GOOD.replace("0.2\n", '"12\n'), None, ["row 3", "quotation mark"]),
    "a name after a quote": (GOOD.replace("link06_z_m", '"link06"_z_m'), None, ["row 1"]),
    "digits of another script": (GOOD.replace("0.2\n", "\u0661\n"), None, ["'\u0661' in row 3"]),
    "an i without a dot": (GOOD.replace("0.2\n", "\u0131nf\n"), None, ["'\u0131nf' in row 3"]),
}  # fmt: skip


def refused(capsys, *arguments):
    """Return the message with which a command line is refused."""
    assert main(list(map(str, arguments))) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"giajax: [^\n]+\n", err)
    return err


@pytest.mark.parametrize("case", CASES)
def test_a_run_beyond_the_limits_is_refused(tmp_path, capsys, case):
    content, sidecar, parts = CASES[case]
    path = tmp_path / "run.csv"
    path.write_text(content, encoding="utf-8")
    if sidecar is not None:
        (tmp_path / "run.toml").write_text(sidecar)

    err = refused(capsys, "check", "--data", path, "--json")
    with pytest.raises(InputError) as caught:
        read_run(path)

    assert err == f"giajax: {caught.value}\n"
    assert ": " in str(caught.value).removeprefix(str(path))
    for part in parts:
        assert part in err
    assert len(err.replace(str(tmp_path), "")) < 800


def test_what_is_within_the_limits_is_read(tmp_path):
    path = tmp_path / "run.csv"
    rows = "".join(f"{1.7e9 + second},0,0\n" for second in range(5))
    path.write_text(HEAD.replace("06", "1000") + rows)
    path.with_suffix(".toml").write_text(
        f"[arm]\nlinks = 1000\n[truth]\ntext = '{'[' * 100}'\n# {'[' * 100}{'a.' * 100}\n"
        f"[noise]\nlink1000_z_m = 1\n"
    )
    assert read_run(path).channels["link1000_z"].index == 1000


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--start", "air.drag_coefficient=1_0"], ["1_0"]),
        (["--fix", "air.drag_coefficient=\u0661"], ["must be PATH=VALUE"]),
        (["--starts", "1_0"], ["--starts is '1_0'"]),
        (["--starts", "\u0661"], ["--starts is '\u0661'"]),
        (["--starts", "9" * 5_000], ["--starts is '999"]),
        (["--window", "1_0"], ["--window is '1_0'"]),
        (["--window", "\u0661.5"], ["--window is '\u0661.5'"]),
        (["--tolerance", "nan"], ["--tolerance is 'nan'"]),
        (["--out", "x" * 300], ["300 bytes", "255"]),
        (["--out", "folder/that/is/not/" + "x" * 300], ["300 bytes", "255"]),
        (["--out", "a\0b"], ["'a\\x00b'", "character"]),
        (["--loss", "q" * 1_000_000], ["must be"]),
        (["--q" + "q" * 1_000_000], ["--qqq"]),
        (["--data", "a\0.csv"], ["'a\\x00.csv'"]),
        (["--data", "y" * 300 + ".csv"], ["304 bytes"]),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_wrong_word_on_the_command_line(tmp_path, capsys, monkeypatch, options, parts):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text(GOOD)
    err = refused(capsys, "fit", "--data", "run.csv", *options)
    for part in parts:
        assert part in err
    assert len(err) < 600
    assert os.listdir() == ["run.csv"]


def test_numbers_are_still_taken(capsys):
    words = ["--starts", "3", "--window", "1e1", "--tolerance=.5", "--seed", "0"]
    assert "no.csv does not exist" in refused(capsys, "fit", "--data", "no.csv", *words)


def test_what_is_no_file_is_not_opened(tmp_path, capsys):
    pipe = tmp_path / "run.csv"
    os.mkfifo(pipe)
    assert "is a pipe, but must be a file" in refused(capsys, "check", "--data", pipe)
    assert "is a pipe" in refused(capsys, "init", "--data", pipe)
    zero = tmp_path / "zero.csv"
    zero.symlink_to("/dev/zero")
    assert "is a device, but must be a file" in refused(capsys, "check", "--data", zero)
    assert "is a device" in refused(capsys, "fit", "/dev/zero", "--data", zero)
    run = tmp_path / "good.csv"
    run.write_text(GOOD)
    os.mkfifo(run.with_suffix(".toml"))
    assert "good.toml is a pipe" in refused(capsys, "check", "--data", run)


def test_a_run_larger_than_the_limit_is_not_read(tmp_path, capsys):
    run = tmp_path / "run.csv"
    with run.open("wb") as file:
        file.truncate(_limits.RUN_BYTES + 1)  # a sparse file, which uses no disk space
    assert "1,073,741,825 bytes" in refused(capsys, "check", "--data", run)


def test_a_broken_link_is_no_missing_sidecar(tmp_path, capsys):
    run = tmp_path / "run.csv"
    run.write_text(GOOD)
    sidecar = run.with_suffix(".toml")
    sidecar.symlink_to(tmp_path / "moved.toml")
    assert "run.toml is a link to a file that does not exist" in refused(
        capsys, "check", "--data", run
    )
    assert "exists and is not overwritten" in refused(capsys, "init", "--data", run)


def test_a_definition_cannot_name_what_no_file_is_called(tmp_path, capsys):
    definition = tmp_path / "fit.toml"
    definition.write_text('[fit]\ndata = ["a\\u0000.csv"]')
    assert "character that is not allowed in a path" in refused(capsys, "fit", definition)
    definition.write_text("[fit]\nstarts = 1000000000")
    assert "fit.starts" in refused(capsys, "fit", definition)


def test_plain_data_have_the_limits_of_files():
    deep: list = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(InputError, match="more than 32 levels deep"):
        Definition.parse({"truth": {"deep": deep}})
    with pytest.raises(InputError, match="more than 64 bits"):
        Definition.parse({"arm": {"links": 10**5_000}})


def test_a_window_far_too_short_asks_for_no_memory():
    run = Run.from_arrays(
        [0.0, 1.0], {"joint01_angle": [0.0, 1.0]}, definition={"initial": {"first_row": True}}
    )
    with pytest.raises(InputError, match="fewer than 4 samples"):
        windows(run, 1e-300)


def test_nothing_is_written_through_a_link(tmp_path, monkeypatch):
    other = tmp_path / "other"
    other.write_text("mine")
    path = tmp_path / "run.csv"

    path.symlink_to(other)
    with pytest.raises(InputError, match="exists and is not overwritten"):
        write_files({path: b"new"}, force=False)
    write_files({path: b"new"}, force=True)
    assert not path.is_symlink()
    assert path.read_bytes() == b"new"
    assert other.read_text() == "mine"

    # If root writes to it, /dev/full must not be replaced by a file.
    for name, to in (("pipe", None), ("device", "/dev/full")):
        place = tmp_path / f"{name}.csv"
        os.mkfifo(place) if to is None else place.symlink_to(to)
        with pytest.raises(InputError, match=f"is a {name}, which is not overwritten"):
            write_files({place: b"new"}, force=True)
        assert place.is_fifo() or place.is_char_device()

    # Another user guesses the temporary name.
    monkeypatch.setattr("secrets.token_hex", lambda bytes: "guessed")
    planted = tmp_path / ".guessed.part"
    planted.symlink_to(other)
    with pytest.raises(InputError, match="cannot be written"):
        write_files({path: b"newer"}, force=True)
    assert other.read_text() == "mine"
    assert path.read_bytes() == b"new"
    assert planted.is_symlink()


def test_temporary_names_differ_and_suit_every_name(tmp_path, monkeypatch):
    before: list[str] = []
    replace = os.replace

    def watched(part, path):
        before.append(Path(part).name)
        replace(part, path)

    monkeypatch.setattr("os.replace", watched)
    path = tmp_path / ("n" * 255)
    write_files({path: b"1"}, force=True)
    write_files({path: b"2"}, force=True)
    assert len(set(before)) == 2
    assert path.read_bytes() == b"2"
    assert os.listdir(tmp_path) == [path.name]


def test_the_page_has_every_limit():
    page = (ROOT / "docs" / "data_contract.md").read_text(encoding="utf-8")
    (section,) = re.findall(r"^## Limits\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
    for name, value in vars(_limits).items():
        if name.isupper() and name != "WHOLE":
            number = f"{value:,}" if isinstance(value, int) else f"{value:g}".replace("e+", "e")
            assert f"| {number.replace('e-09', 'e-9')} " in section, name
