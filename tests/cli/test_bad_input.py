"""Bad recordings: one sentence from the library, one line and status 2 from the command line."""

import pytest

from giajax.cli import main
from giajax.recordings import read_run
from giajax.runtime.text import InputError

pytestmark = pytest.mark.quick

HEAD = "time_s,joint01_command_deg,link06_z_m\n"
GOOD = HEAD + "0,0,0.1\n0.1,30,0.2\n0.2,30,0.3\n"

# content of run.csv (None: no file), content of run.toml, and what the sentence must contain
CASES = {
    "missing file": (None, None, ["does not exist"]),
    "empty file": ("", None, ["is empty"]),
    "blank file": ("\n \n", None, ["is empty"]),
    "header only": (HEAD, None, ["no rows"]),
    "header without newline": (HEAD.strip(), None, ["no rows"]),
    "no header": ("0,0,0.1\n0.1,30,0.2\n", None, ["first line", "holds numbers"]),
    "blank first line": ("\n" + GOOD, None, ["first line", "is empty"]),
    "comment": ("# the first swing\n" + GOOD, None,
                ["line 1 is a comment, but", "name the columns: remove it"]),
    "comments": ('# swing, 3 m/s\n  # camera 2; lens 1\n"# a, b"\n' + GOOD, None,
                 ["lines 1 to 3 are comments", "remove them"]),
    "comment and a foreign header": ("#x\nt,z\n0,1\n", None, ["line 1 is a comment"]),
    "nothing but comments": ("# a\n# b\n", None, ["lines 1 to 2 are comments"]),
    "header behind a #": ("# " + GOOD, None,
                          ["line 1 comes before the numbers", ": remove the '#'\n"]),
    "header behind the last #": ("# a\n# b\n# " + GOOD, None,
                                 ["line 3 comes before", "the '#' and everything above that line"]),
    "units above": ("s,deg,m\n" + GOOD, None, ["line 2", "remove the line above the names"]),
    "title and units above": ("Run 7\n[s],[deg],[m]\n" + GOOD, None,
                              ["line 3", "remove the 2 lines above the names"]),
    "units above foreign names": ("[s],[m]\nt,z\n0,1\n", None, ["holds units", "link06_z_m"]),
    "units below": (GOOD.replace("0,0,0.1\n", "s,deg,m\n0,0,0.1\n"), None,
                    ["'time_s' has 's' in row 2"]),
    "only a time column": ("time_s\n0\n1\n", None, ["only a time column"]),
    "no time column": ("joint01_command_deg,tip_x_m\n0,1\n0,2\n", None, ["no time column"]),
    "binary file": (b"\x89PNG\r\n\x1a\n\x00\x00", None, ["not text"]),
    "NUL": (GOOD.replace("0.2", "\0"), None, ["not text"]),
    "latin-1": (GOOD.replace("joint01", "j\xfc").encode("latin-1"), None, ["not text", "UTF-8"]),
    "utf-16": (GOOD.encode("utf-16"), None, ["not text"]),
    "semicolons": (GOOD.replace(",", ";"), None, ["semicolons", "commas"]),
    "tabs": (GOOD.replace(",", "\t"), None, ["tabs", "commas"]),
    "unknown column": (GOOD.replace("link06_z_m", "height"), None, ["'height'", "--rename"]),
    "misspelt column": (GOOD.replace("link06", "link6"), None, ["'link6_z_m'", "'link06_z_m'"]),
    "unknown suffix": (GOOD.replace("z_m", "z_ft"), None, ["'link06_z_ft'", "'ft'", "m, cm or mm"]),
    "no suffix": (GOOD.replace("z_m", "z"), None, ["'link06_z'", "unit"]),
    "nameless column": (GOOD.replace("link06_z_m", ""), None, ["column 3 has no name"]),
    "duplicate column": (GOOD.replace("joint01_command_deg", "link06_z_m"), None,
                         ["'link06_z_m' is given twice"]),
    "duplicate channel": (GOOD.replace("joint01_command_deg", "link06_z_mm"), None,
                          ["'link06_z_mm' and 'link06_z_m' both give link06_z"]),
    "short row": (HEAD + "0,0,0\n1,1\n", None, ["row 3 has 2 cells", "3 columns"]),
    "long row": (HEAD + "0,0,0\n1,1,1\n2,2,2,2\n", None, ["row 4 has 4 cells"]),
    "blank row": (HEAD + "0,0,0\n\n2,2,2\n", None, ["row 3 has 1 cell,"]),
    "short quoted row": (HEAD + '0,"0",0\n1,"1"\n', None, ["row 3 has 2 cells"]),
    "line break in a cell": (HEAD + '0,"0\n",0\n', None, ["row 2", "line break"]),
    "text in a number": (GOOD.replace("0.2\n", "lost\n"), None,
                         ["'link06_z_m' has 'lost' in row 3"]),
    "decimal comma in quotes": (GOOD.replace("0.2\n", '"0,2"\n'), None, ["'0,2' in row 3"]),
    "two points": (GOOD.replace("0.2\n", "0.2.1\n"), None, ["'0.2.1' in row 3"]),
    "underscore": (GOOD.replace("0.2\n", "1_0\n"), None, ["'1_0' in row 3"]),
    "text in time": (GOOD.replace("0.1,30", "noon,30"), None, ["'time_s' has 'noon' in row 3"]),
    "time repeats": (GOOD.replace("0.2,30", "0.1,30"), None, ["row 4", "from 0.1 s to 0.1 s"]),
    "time falls": (GOOD.replace("0.2,30", "-5,30"), None, ["row 4", "increase"]),
    "time empty": (GOOD.replace("0.2,30", ",30"), None, ["time in row 4 is empty"]),
    "one row": (HEAD + "0,0,0\n", None, ["1 sample,", "at least 2"]),
    "infinite value": (GOOD.replace("0.3\n", "inf\n"), None, ["'link06_z_m' is infinite in row 4"]),
    "gap in the command": (GOOD.replace("0.1,30", "0.1,"), None,
                           ["'joint01_command_deg' is empty in row 3"]),
    "no value at all": (HEAD + "0,0,\n1,1,\n", None, ["'link06_z_m'", "no value at all"]),
    "link beyond the arm": (GOOD.replace("link06", "link21"), None, ["link 21", "20 links"]),
    "link beyond a short arm": (GOOD, "[arm]\nlinks = 5", ["link 6", "5 links"]),
    "joint beyond the arm": (GOOD.replace("joint01", "joint21"), None, ["joint 21"]),
    "no command column": ("time_s,tip_x_m\n0,0\n1,1\n", None, ["no command", "free_motion = true"]),
    "sidecar of another model": (GOOD, 'model = "muscle"', ["'muscle'", "'joint01_command_deg'"]),
    "sidecar with a checksum": (GOOD, f'sha256 = "{"0" * 64}"', ["SHA-256", "000000000000..."]),
    "sidecar with an unknown key": (GOOD, "[arm]\nmass = 1", ["run.toml", "unknown key arm.mass"]),
    "sidecar that is not TOML": (GOOD, "[arm", ["run.toml", "not valid TOML"]),
    "sidecar with a wrong value": (GOOD, "[arm]\nlink_mass_kg = -1", ["arm.link_mass_kg = -1"]),
    "sidecar with a fit": (GOOD, '[fit]\nloss = "huber"', ["must not contain [fit]"]),
    "sidecar with figures": (GOOD, "[figures.a]\ndetermined = false", ["must not contain "
        "[figures]"]),
    "noise of another column": (GOOD, "[noise]\ntip_x_m = 0.1", ["'tip_x_m'", "measured column"]),
    "free motion with commands": (GOOD, "free_motion = true", ["free_motion", "command columns"]),
    "two winds": (GOOD.replace("link06_z_m", "wind_x_m_per_s"),
                  "[wind]\nvelocity_m_per_s = [0, 0, 1]", ["constant wind"]),
    "wrong side": ("side,force_N\ninner,1\nleft,1\n", None, ["'left' in row 3", "inner or outer"]),
    "side missing": ("side,force_N\ninner,1\n,1\n", None, ["row 3", "inner or outer"]),
    "sensors of another arm": ("time_s,joint01_command_deg,link01_z_m\n0,0,0\n1,1,1\n",
                               "[sensors]\nmarker_up_m = [0.1, 0.2]",
                               ["[sensors] key marker_up_m has 2 values", "each of the 20 links"]),
    "parameter of text": ("time_s,joint01_command_deg\n0,0\n1,1\n",
                             '[arm.parameters]\n"joints.damping" = [0.1, "x"]',
                             ["arm.parameters.\"joints.damping\"",
                              "a finite number or a list of them"]),
    "model unclear": ("force_N,torque_N_m\n1,1\n", None, ["do not determine the model"]),
}  # fmt: skip


# A command prints the message of the reader in one line; five cases suffice to check this.
BY_COMMAND = {"missing file", "semicolons", "text in a number", "sidecar with a wrong value",
              "model unclear"}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bad_recordings(tmp_path, capsys, case):
    content, sidecar, parts = CASES[case]
    path = tmp_path / "run.csv"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    if sidecar is not None:
        (tmp_path / "run.toml").write_text(sidecar)
    before = {item.name: item.read_bytes() for item in tmp_path.iterdir()}

    with pytest.raises(InputError) as caught:
        read_run(path)
    line = f"giajax: {caught.value}\n"
    if case in BY_COMMAND:
        assert main(["check", "--data", str(path)]) == 2
        assert capsys.readouterr() == ("", line)
    assert line.count("\n") == 1
    assert "run." in line
    for part in parts:
        assert part in line
    # Long enough to name the cause and the remedy, short enough to read.
    assert len(line.replace(str(tmp_path), "")) < 420
    assert {item.name: item.read_bytes() for item in tmp_path.iterdir()} == before


def test_a_directory_and_another_kind_of_file(tmp_path, capsys):
    (tmp_path / "runs.csv").mkdir()
    assert main(["check", "--data", str(tmp_path / "runs.csv")]) == 2
    assert "is a directory" in capsys.readouterr().err
    assert main(["check", "--data", str(tmp_path / "run.xlsx")]) == 2
    assert ".csv or .parquet" in capsys.readouterr().err


@pytest.mark.parametrize("model", ["nowhere", "missing.toml", "missing.json"])
def test_a_model_that_is_not_there(tmp_path, capsys, model):
    run = tmp_path / "run.csv"
    run.write_text("time_s,joint01_command_deg,link01_z_m\n0,0,0\n1,1,1\n")
    assert main(["predict", str(tmp_path / model), "--data", str(run)]) == 2
    error = capsys.readouterr().err
    assert f"{model} does not exist: give the folder of a fit, its result.json, or a TOML" in error
