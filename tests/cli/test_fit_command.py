"""`giajax fit` on a short arm: its files, its output, and the ways in which it ends."""

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from evidence._kills import SLOWLY
from giajax import InputError
from giajax.cli import main
from giajax.fitting import load_result
from giajax.recordings import read_run
from small_arm import NOISE, START, STARTS, TRUTH, make_run

FILES = {
    "result.json", "prediction.csv", "prediction.toml", "recorded.png", "residuals.png",
    "correlation.png",
}  # fmt: skip


def giajax(*arguments):
    """Return exit status, standard output and error; fits do not test omitted effects."""
    if arguments[0] == "fit":
        # The test would compile another program. The fit of `arm_fit` includes it.
        arguments = (*arguments, "--no-suspects")
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main([str(argument) for argument in arguments])
    return status, out.getvalue(), err.getvalue()


def contents(folder):
    return {str(p): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture
def fitted(arm_fit):
    return arm_fit


@pytest.fixture
def data(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return make_run(tmp_path)


@pytest.mark.slow
def test_a_result_that_cannot_be_written_is_printed(data, monkeypatch):
    def fail(*_, **__):
        raise InputError("no space left: make some")

    monkeypatch.setattr("giajax.report.write_result", fail)
    status, out, err = giajax("fit", "--data", data, *STARTS, "--max-iterations", "1")
    assert status == 2
    assert json.loads(out)["parameters"]["air.drag_coefficient"]["value"] > 0
    told = "because not all of its files could be written:\ngiajax: no space left: make some\n"
    assert err.endswith(told)


@pytest.mark.slow
def test_numbers_without_figures(data):
    options = ["--max-iterations", "1", "--out", "out", "--no-figures"]
    _, out, _ = giajax("fit", "--data", data, *STARTS, *options)
    assert {path.name for path in (data.parent / "out").iterdir()} == {
        "journal.jsonl",
        *(name for name in FILES if not name.endswith(".png")),
    }
    assert "wrote out: result.json, prediction.csv, prediction.toml\n" in out
    # The fit ended early, and can be continued.
    assert out.endswith("to continue the fit: giajax fit --resume out --max-iterations 2\n")


def test_it_finds_the_truth(fitted):
    _, folder, (status, _, _) = fitted
    assert status == 0
    result = load_result(folder)
    for path, truth in TRUTH.items():
        estimate = result.parameters[path]
        assert estimate.value != START[path]
        assert abs(estimate.value - truth) < 3.5 * estimate.standard_error
    assert 0.7 < result.reduced_chi_square < 1.4


def test_every_key_of_the_result(fitted):
    data, folder, _ = fitted
    record = json.loads((folder / "result.json").read_text(), parse_constant=pytest.fail)
    number = (int, float)
    assert record["status"] == "converged"
    assert "converged" in record["message"]
    assert record["model"] == "arm"
    for path, estimate in record["parameters"].items():
        assert set(estimate) == {
            "value", "standard_error", "unit", "lower", "upper", "free", "remark",
            "interval", "freedom", "sandwich_error", "prior_share", "sources", "noise_error",
        }  # fmt: skip
        assert estimate["prior_share"] is None
        assert estimate["sources"] == {}
        assert estimate["free"] == (path in TRUTH)
        assert isinstance(estimate["unit"], str)
        assert isinstance(estimate["remark"], str)
        if estimate["free"]:
            assert isinstance(estimate["value"], float)
            assert isinstance(estimate["standard_error"], float)
            assert estimate["lower"] < estimate["value"] < estimate["upper"]
            low, high = estimate["interval"]
            assert low < estimate["value"] < high
            assert estimate["sandwich_error"] > 0
        else:
            assert estimate["standard_error"] is None
            assert estimate["remark"]
    assert record["parameters"]["links.mass"]["upper"] is None
    assert record["parameters"]["joints.damping"]["unit"] == "N m s/rad"
    assert set(record["correlation"]["parameters"]) == set(TRUTH)
    assert np.allclose(np.diag(record["correlation"]["matrix"]), 1)
    (run,) = record["runs"]
    assert run["path"] == str(data)
    assert run["sha256"] == read_run(data).sha256
    assert set(run["channels"]) == {"link02_y", "link04_y", "link04_z"}
    for channel in run["channels"].values():
        assert channel["unit"] == "m"
        assert channel["rmse"] == pytest.approx(NOISE, rel=0.5)
        assert channel["n"] == 36
    for key in ("cost", "reduced_chi_square"):
        assert isinstance(record[key], float)
    assert isinstance(record["iterations"], int)
    assert record["gradient_check"]["relative_difference"] < 1e-4
    assert record["tolerance_effect"]["largest_in_standard_errors"] < 0.1
    assert all(isinstance(record["seconds"][key], number) for key in ("compile", "run"))
    assert {"python", "giajax", "jax", "diffrax"} <= set(record["versions"])
    for finding in record["findings"]:
        assert set(finding) == {"code", "paths", "sentence", "advice"}
    config = record["config"]
    assert config["free"] == [path for path in record["parameters"] if path in TRUTH]
    assert config["start"] == START
    assert config["loss"] == "linear"
    assert config["runs"] == [{"noise": {"position_m": NOISE}, "from_s": 0.0, "rows": 41}]


def test_the_files_it_writes(fitted):
    data, folder, _ = fitted
    assert {path.name for path in folder.iterdir()} == FILES
    run = read_run(data)
    predicted = read_run(folder / "prediction.csv")
    for name, values in load_result(folder).predict(run).items():
        assert np.allclose(predicted.observations[name], values, rtol=1e-8, atol=1e-12)
    status, out, _ = giajax("check", "--data", folder / "prediction.csv")
    assert status == 0
    assert "link04_z" in out


def test_what_it_prints(fitted):
    _, folder, (_, out, err) = fitted
    lines = err.splitlines()
    assert lines[0] == "compiling ..."
    numbered = [line.split() for line in lines if line[:4].strip().isdigit()]
    iterations = load_result(folder).iterations
    assert [int(line[0]) for line in numbered] == list(range(iterations + 1))
    assert numbered[-1][3] in ("yes", "no")
    assert len(numbered[-1]) == 4 + len(TRUTH)
    # Without a terminal, no name is wrapped.
    assert all(path in lines[1] for path in TRUTH)

    assert "compiling" not in out
    for part in [*TRUTH, "value", "error", "bounds", "remark", "status", "converged in",
                 "reduced chi-square", "RMSE", "gradient check", "solver tolerance",
                 "per unit of mass", "result.json", str(folder)]:  # fmt: skip
        assert part in out


def test_the_same_fit_again_writes_over_and_another_does_not(fitted, tmp_path, monkeypatch):
    data, folder, _ = fitted
    folder = shutil.copytree(folder, tmp_path / "copy")
    base = ["fit", "--data", data, "--out", folder, "--quiet", "--no-figures"]
    monkeypatch.chdir(tmp_path)
    before = contents(folder)
    other = make_run(tmp_path, seed=8)
    for change, part in [
        ([*base, *STARTS, "--loss", "huber"], "loss"),
        ([*base, *STARTS, "--fix", "air.density=1.1"], "fix"),
        ([*base, *STARTS, "--free", "air.drag_coefficient"], "free"),
        (base, "start"),
        (["fit", "--data", other, "--out", folder, *STARTS], "other data"),
    ]:
        status, out, err = giajax(*change)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert err.startswith(f"giajax: {folder} contains a result computed")
        assert part in err
        assert "--force" in err
        assert contents(folder) == before

    (folder / "result.json").touch()
    stamp = (folder / "result.json").stat().st_mtime_ns
    assert giajax(*base, *STARTS) == (0, "", "")
    assert (folder / "result.json").stat().st_mtime_ns > stamp
    prediction = str(folder / "prediction.csv")
    again, first = (
        np.genfromtxt(io.BytesIO(files[prediction]), delimiter=",", skip_header=1)
        for files in (contents(folder), before)
    )
    # The compiler's threads may sum in another order.
    np.testing.assert_allclose(again, first, rtol=0, atol=1e-5)


def test_force_writes_over(data, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.json").write_text("{}")
    base = ["fit", "--data", data, "--out", out, "--quiet", "--no-figures"]
    base += ["--max-iterations", "1"]
    status, _, err = giajax(*base)
    assert status == 2
    assert "not a giajax result" in err
    assert contents(out) == {str(out / "result.json"): b"{}"}
    assert giajax(*base, "--force")[0] == 1
    assert load_result(out).status == "not_converged"


def test_a_fit_that_does_not_converge_says_so_and_is_written(data, tmp_path):
    status, out, err = giajax("fit", "--data", data, *STARTS, "--max-iterations", "1")
    assert status == 1
    assert "NOT CONVERGED" in out
    assert "giajax-out/run" in out
    assert err.splitlines()[0] == "compiling ..."
    assert load_result(tmp_path / "giajax-out" / "run").status == "not_converged"


def test_json_is_alone_on_standard_output(data, tmp_path):
    options = ["--max-iterations", "1", "--json", "--no-figures", "--out", "here"]
    status, out, err = giajax("fit", "--data", data, *STARTS, *options)
    assert status == 1
    assert "compiling" in err
    assert out == (tmp_path / "here" / "result.json").read_text()
    assert json.loads(out)["status"] == "not_converged"


DEFINITION = """
[fit]
data = ["run.csv"]
free = ["air.drag_coefficient", "joints.pitch_stiffness", "joints.damping"]
loss = "soft_l1"
[fit.start]
air.drag_coefficient = 0.8
joints.damping = 0.07
[fit.fix]
joints.yaw_stiffness = 4.0
[noise]
position_m = 0.02
[figures."air.drag_coefficient"]
value = 1.1
standard_errors = 4.0
[figures."joints.yaw_stiffness"]
determined = false
[figures."joints.damping"]
relative_error = 1e-9
"""


@pytest.mark.slow
def test_a_definition_and_what_goes_before_it(tmp_path, monkeypatch):
    # Data files are relative to the definition, the output folder to the current directory.
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    monkeypatch.chdir(here)
    make_run(there)
    (there / "drag.toml").write_text(DEFINITION)
    status, out, _ = giajax("fit", there / "drag.toml", "--no-figures")
    assert status == 0
    record = json.loads((here / "giajax-out" / "drag" / "result.json").read_text())
    config = record["config"]
    assert config["loss"] == "soft_l1"
    assert config["free"] == [
        "air.drag_coefficient", "joints.pitch_stiffness", "joints.damping"
    ]  # fmt: skip
    assert config["start"] == {"air.drag_coefficient": 0.8, "joints.damping": 0.07}
    assert config["fix"] == {"joints.yaw_stiffness": 4.0}
    # The noise in the definition takes precedence over the sidecar, which still gives the arm.
    assert record["runs"][0]["channels"]["link04_z"]["noise"] == pytest.approx(0.02)
    assert config["definition"]["arm"]["links"] == 4
    verdicts = {line.split()[1]: line.split()[0] for line in out.splitlines()
                if line.startswith(("reached", "MISSED"))}  # fmt: skip
    assert verdicts == {
        "air.drag_coefficient": "reached",
        "joints.yaw_stiffness": "MISSED",
        "joints.damping": "MISSED",
    }

    # The command line takes precedence over both, path by path.
    status, out, _ = giajax(
        "fit", "--config", there / "drag.toml", "--start", "joints.damping=0.08", "--fix",
        "air.drag_coefficient=1.0", "--loss", "linear", "--max-iterations", "1", "--tolerance",
        "1e-8", "--out", "b", "--no-figures",
    )  # fmt: skip
    config = json.loads((here / "b" / "result.json").read_text())["config"]
    assert config["free"] == ["joints.pitch_stiffness", "joints.damping"]
    assert config["start"] == {"joints.damping": 0.08}
    assert config["fix"] == {"joints.yaw_stiffness": 4.0, "air.drag_coefficient": 1.0}
    assert config["loss"] == "linear"
    assert (config["solver"], config["tolerance"]) == ("springs5", 1e-8)
    assert config["definition"]["simulation"]["tolerance"] == 1e-8


@pytest.mark.slow
def test_a_channel_is_renamed_on_the_way(data):
    data.write_text(data.read_text().replace("link04_z_m", "tip height"))
    data.with_suffix(".toml").write_text("[arm]\nlinks = 4")
    status, out, _ = giajax(
        "fit", "--data", data, "--rename", "tip height=link04_z_m", "--free", "joints.damping",
        "--max-iterations", "1", "--out", "out", "--no-figures",
    )  # fmt: skip
    assert status == 1
    channels = load_result(data.parent / "out").runs[0].channels
    assert list(channels) == ["link02_y", "link04_y", "link04_z"]
    assert channels["link04_z"].n == 36
    # The sidecar no longer gives the noise.
    assert channels["link04_z"].noise == pytest.approx(NOISE, rel=0.5)
    assert "noise that was not stated is estimated" in out


def test_an_interruption_in_the_loop_writes_the_best_so_far(data, tmp_path, monkeypatch):
    import giajax.cli._fit as command

    shown = command.Progress.__call__

    def interrupt(self, iteration):
        shown(self, iteration)
        if iteration.number == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(command.Progress, "__call__", interrupt)
    status, out, err = giajax("fit", "--data", data, *STARTS, "--no-figures", "--out", "out")
    assert status == 130
    assert "interrupted after 2 iterations" in out
    assert "Traceback" not in err
    result = load_result(tmp_path / "out")
    assert (result.status, result.iterations) == ("interrupted", 2)


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["compiling", "1"])
def test_ctrl_c_of_the_process(data, tmp_path, moment):
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    del environment["JAX_COMPILATION_CACHE_DIR"]
    code = SLOWLY.format(seconds=1.0)
    process = subprocess.Popen(
        [sys.executable, "-c", code, "fit", "--data", str(data), *STARTS, "--out", "out"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=environment,
    )
    # The lines are read while the fit runs. They must arrive immediately, also in a pipe.
    for line in process.stderr:
        if line.split()[0] == moment:
            process.send_signal(signal.SIGINT)
            break
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Traceback" not in err
    if moment == "compiling":
        assert (out, err) == ("", "giajax: interrupted\n")
        assert not (tmp_path / "out").exists()
    else:
        assert "interrupted after" in out
        assert load_result(tmp_path / "out").status == "interrupted"
        # The compiled step is kept for the next process.
        assert any("step" in path.name for path in (tmp_path / "cache" / "giajax").rglob("*"))


CSV = "time_s,joint01_command_deg,link04_z_m\n0,0,0.1\n0.1,30,0.2\n0.2,30,0.3\n"
CSV += "0.3,30,0.4\n0.4,30,0.5\n0.5,30,0.6\n"  # more values than there are parameters

LOOP = "input,output\n0,0\n1,1\n0,0.2\n1,1\n0,0.2\n1,1\n"

# Errors that only a fit detects; errors in files are tested with their reader.
# run.csv (None: no file), run.toml, further arguments, and a required part of the message
BAD = {
    "missing file": (None, "", [], ["does not exist"]),
    "nothing measured": ("time_s,joint01_command_deg\n0,0\n1,1\n", "", [], ["no measured"]),
    "sidecar against the columns": (CSV, 'model = "muscle"', [], ["'muscle'"]),
    "another model": ("side,force_N\ninner,1\nouter,1\n", "", [], ["a joint run must have"]),
    "no such parameter": (CSV, "", ["--free", "air.drag_coeficient"],
                          ["did you mean 'air.drag_coefficient'?"]),
    "no such start": (CSV, "", ["--start", "drag_coefficient=1"], ["'air.drag_coefficient'"]),
    "no such fix": (CSV, "", ["--fix", "joint.damping=1"], ["'joints.damping'"]),
    "no such element": (CSV, "", ["--free", "links.mass[20]"], ["from 0 to 19"]),
    "start outside its bounds": (CSV, "", ["--start", "joints.damping=-1"], ["between 0 and"]),
    "start on its bound": (CSV, "", ["--start", "joints.damping=0"], ["strictly between"]),
    "fix outside its bounds": (CSV, "", ["--fix", "joints.damping=-1"], ["between 0 and"]),
    "start that is not finite": (CSV, "", ["--start", "joints.damping=nan"], ["PATH=VALUE"]),
    "start that is no number": (CSV, "", ["--start", "joints.damping=low"], ["PATH=VALUE"]),
    "start without a value": (CSV, "", ["--start", "joints.damping"], ["PATH=VALUE"]),
    "start without a path": (CSV, "", ["--start", "=1"], ["PATH=VALUE"]),
    "start of other elements": (CSV, "", ["--start", "camera.origin=0.1,0"],
                                ["2 values", "3 elements"]),
    "start twice": (CSV, "", ["--start", "joints.damping=1", "--start", "joints.damping=2"],
                    ["twice"]),
    "free and fixed": (CSV, "", ["--free", "joints.damping", "--fix", "joints.damping=1"],
                       ["both free and fixed"]),
    "start and fixed": (CSV, "", ["--start", "joints.damping=1", "--fix", "joints.damping=1"],
                        ["give only one of them"]),
    "unknown solver": (CSV, "", ["--solver", "euler"], ["no solver 'euler'", "dopri8"]),
    "solver of a loop": (LOOP, "", ["--solver", "tsit5"], ["neither a solver nor"]),
    "no tolerance": (CSV, "", ["--tolerance", "0"], ["fit.tolerance", "positive"]),
    "unknown loss": (CSV, "", ["--loss", "cauchy"], ["'cauchy'", "huber"]),
    "no iterations": (CSV, "", ["--max-iterations", "0"], ["--max-iterations"]),
    "wrong rename": (CSV, "", ["--rename", "z"], ["OLD=NEW"]),
    "unknown option": (CSV, "", ["--fre", "joints.damping"], ["--fre"]),
    "a folder that is a file": (CSV, "", ["--out", "run.csv"], ["is a file"]),
    "a run of another arm": (CSV, "[arm]\nlinks = 4", ["--data", "other.csv"], ["disagree"]),
    "no such definition": (CSV, "", ["none.toml"], ["none.toml"]),
    "no such key": (CSV, "", ["definition.toml"], ["unknown key fit.dta", "fit.data"]),
    "no such figure": (CSV, "", ["figures.toml"], ["'joints.damping'"]),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_status_2(tmp_path, monkeypatch, case):
    content, sidecar, arguments, parts = BAD[case]
    monkeypatch.chdir(tmp_path)
    if content is not None:
        (tmp_path / "run.csv").write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
    if sidecar:
        (tmp_path / "run.toml").write_text(sidecar)
    (tmp_path / "other.csv").write_text(CSV)
    (tmp_path / "definition.toml").write_text('[fit]\ndta = ["run.csv"]\n')
    (tmp_path / "figures.toml").write_text("[figures.'joints.dampng']\ndetermined = false\n")
    before = contents(tmp_path)
    status, out, err = giajax("fit", "--data", "run.csv", *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("giajax: ")
    assert (err.count("\n"), err[-1]) == (1, "\n")
    for part in parts:
        assert part in err
    assert contents(tmp_path) == before
    assert [path for path in tmp_path.iterdir() if path.is_dir()] == []


@pytest.mark.parametrize("arguments", [[], ["empty.toml"]])
def test_no_data_is_bad_usage(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.toml").write_text("[fit]\n")
    status, out, err = giajax("fit", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "--data" in err
    assert os.listdir(tmp_path) == ["empty.toml"]


def test_help_imports_neither_jax_nor_matplotlib():
    code = (
        "import sys; from giajax.cli import main; status = main(['fit', '--help']); "
        "heavy = {'jax', 'equinox', 'matplotlib'} & set(sys.modules); "
        "sys.exit(f'imported {heavy}' if heavy else status)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("", 0)
    assert "--start PATH=VALUE" in done.stdout
    assert "giajax fit --data run.csv" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_what_is_odd_in_a_recording_comes_first_and_stays_in_the_result(tmp_path, capsys):
    path = make_run(tmp_path)
    sidecar = path.with_suffix(".toml")
    sidecar.write_text("\n".join(x for x in sidecar.read_text().split("\n") if "sha256" not in x))
    lines = path.read_text().splitlines()
    for row in (9, 30):
        lines[row] = ",".join([*lines[row].split(",")[:-1], "-9999"])
    path.write_text("\n".join(lines) + "\n")
    main(["fit", "--data", str(path), "--max-iterations", "1", "--out", str(tmp_path / "o"),
          "--no-figures", "--no-suspects"])  # fmt: skip
    said = capsys.readouterr().err
    assert said.index("note: run: 2 cells of column 'link04_z_m' are -9999") < said.index("cost")
    record = json.loads((tmp_path / "o" / "result.json").read_text())
    assert record["findings"][0]["code"] == "odd_recording"
