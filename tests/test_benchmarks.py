"""The benchmarks run, compare what they claim to compare, and write what they show."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def benchmark(name, *options):
    """Run a benchmark in the root of the project, as users do, and return its output.

    Status 1 means that a limit is exceeded, which matters only for `make bench` on an idle machine.
    """
    command = [sys.executable, "-m", f"benchmarks.{name}", *map(str, options)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert ended.returncode in (0, 1), ended.stderr
    assert "Traceback" not in ended.stderr, ended.stderr
    return ended.stdout


def printed_by(program, *arguments):
    """Run a Python program in the root of the project and return its output."""
    command = [sys.executable, "-c", program, *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.mark.long
def test_the_benchmark_runs(tmp_path):
    out = tmp_path / "new" / "bench.json"
    printed = benchmark("bench", "--quick", "--out", out)
    found = json.loads(out.read_text())
    assert set(found["chosen"]) == set(found["run"]) >= set(found["gradient"])
    if absent := found["absent"]:
        assert all(f"{name} is left out: {why}"[:60] in printed for name, why in absent.items())
        # Any other reason means that a peer is broken.
        assert all("no C compiler is there" in why or "casadi" in why for why in absent.values())
        pytest.skip(str(absent))
    for name, chosen in found["chosen"].items():
        assert chosen["error"] < found["problem"]["tip_accuracy_m"], name
    # The derivatives are computed in at least four ways.
    assert len(found["gradient"]) >= 4
    for name, gradient in found["gradient"].items():
        assert gradient["error"] < 0.05, name
    assert all(ratio > 0 for ratio in found["ratios"].values())
    # Three optimisers with two simulations must find one optimum.
    assert len(found["fits"]) == 3
    for name, each in found["fits"].items():
        assert each["standard_errors_off"] < 0.01, name
    for what in ("evaluation", "run", "gradient", "batch"):
        assert f"{what}: MuJoCo in C over giajax" in found["ratios"]
    assert "gradient: the plain arm over a stiffness of each joint" in found["ratios"]
    for heading in ("One evaluation", "from half the drag", "full air", "Ratios"):
        assert heading in printed
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


def history(path, ratios, **problem):
    """Append a line to the history, and write the output of `make bench`."""
    each = {"commit": "before", "problem": {"links": 20} | problem, "ratios": ratios}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(each) + "\n")
    return path


@pytest.mark.quick
@pytest.mark.parametrize(("fall", "status"), [(0.21, 1), (0.19, 0), (-0.5, 0)])
def test_a_ratio_that_fell_by_a_fifth_fails(tmp_path, fall, status):
    """Compared with the last line for the same problem; a ratio that is not stored is new."""
    stored = history(tmp_path / "history.jsonl", {"run": 9.0, "fit": 9.0})
    history(stored, {"run": 2.0, "fit": 4.0})
    history(stored, {"run": 90.0}, links=3)
    now = {"run": 2.0 * (1 - fall), "fit": 4.0, "new": 0.1}
    found = history(tmp_path / "bench.json", now)
    command = [sys.executable, "-m", "benchmarks.history", str(found), "--history", str(stored)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert ended.returncode == status, ended.stderr
    said = f"'run' fell from 2.00 (before) to {2 - 2 * fall:.2f}: "
    assert ended.stderr.startswith(said) if status else ended.stderr == ""
    assert ended.stderr.count("\n") == status


@pytest.mark.quick
@pytest.mark.parametrize(("ratios", "said"), [({}, "was not measured"), ({"run": "NaN"}, "fell")])
def test_a_ratio_that_is_missing_or_no_number_fails(tmp_path, ratios, said):
    """Ratios of two cores, of giajax's own solvers and of studies are not checked."""
    others = {"batch: a": 9.0, "giajax: b": 9.0, "studies: c": 9.0}
    stored = history(tmp_path / "history.jsonl", {"run": 2.0, **others})
    found = history(tmp_path / "bench.json", {name: float(x) for name, x in ratios.items()})
    command = [sys.executable, "-m", "benchmarks.history", str(found), "--history", str(stored)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert ended.returncode == 1
    assert said in ended.stderr
    assert ended.stderr.count("\n") == 1


def test_a_ratio_says_how_many_times_as_long_as_giajax_a_peer_takes():
    one = {"giajax": {"min": 2.0}, "CasADi in C": {"min": 1.0}}
    both = {"giajax springs5": {"min": 2.0}, "MuJoCo, drag in C": {"min": 6.0}}
    arms = {"plain": {}, "memory": {"run": {"ratio": 4.0}, "slopes": {"ratio": 2.0}}}
    found = {"evaluation": one, "batch": one, "fits": one, "run": both, "gradient": both}
    found |= {"arms": arms, "each": {"Jacobian": {"ratio": 3.0}}}
    found |= {"processes": {"next": {"wall": 2.0}, "refits": 10.0}}
    program = "import json, sys; from benchmarks.bench._ratios import ratios; "
    program += "print(json.dumps(ratios(json.loads(sys.argv[1]))))"
    ratios = json.loads(printed_by(program, json.dumps(found)))
    assert ratios["evaluation: CasADi over giajax"] == 0.5
    assert ratios["run: MuJoCo in C over giajax"] == 3.0
    assert ratios["run: the plain arm over memory"] == 0.25
    assert ratios["gradient: the plain arm over memory"] == 0.5
    assert ratios["gradient: the plain arm over a stiffness of each joint"] == 1 / 3
    assert ratios["studies: ten fits over 60 refits"] == 2.0


def test_evaluations_on_a_device_are_timed_by_the_number_of_items():
    """A CPU takes the place of the GPU, which test machines lack. Each call is said to take 6 s."""
    program = """
import json
import jax
from benchmarks.bench import _batch

def timed(calls, repeats):
    for call in calls.values():
        call()
    return {name: {"min": 6.0, "median": 12.0} for name in calls}

jax.config.update("jax_enable_x64", True)
_batch.in_turns = timed
print(json.dumps(_batch.on_device(2, 1, 3, jax.devices("cpu")[0], (2, 8))))
"""
    assert json.loads(printed_by(program)) == {
        "cpu, 2 items": {"min": 1.0, "median": 2.0},
        "cpu, 8 items": {"min": 0.25, "median": 0.5},
    }


def test_the_table_shows_what_a_machine_with_a_gpu_measures():
    spread = {"min": 1e-6, "median": 2e-6}
    each = {"seconds": 0.5, "ratio": 3.0}
    alone = {"wall": 4.5, "compile": 1.5, "iterations": 7, "peak_megabytes": 600.0}
    found = {
        "absent": {},
        "problem": {"links": 20, "seconds": 25.0, "batch": 256},
        "chosen": {},
        "run": {},
        "gradient": {},
        "evaluations": {},
        "batch": {"giajax": spread},
        "gpu": {"a GPU, 4096 items": {"min": 3e-8, "median": 4e-8}},
        "arms": {"plain": {"tolerance": 1e-4, "error": 1e-5, "steps": [9, 1]}},
        "each": {"Jacobian": each, "gradient": each},
        "fits": {},
        "processes": {"cold": alone, "next": alone, "refits": 12.25},
        "ratios": {"studies: ten fits over 60 refits": 0.5},
        "machine": {"load_before": 0.0, "cores": 2},
    }
    found["arms"]["plain"] |= {"run": each, "slopes": each}
    program = "import json, sys; from rich.console import Console; "
    program += "from benchmarks.bench._tables import show; "
    program += "show(json.loads(sys.argv[1]), Console(width=200))"
    printed = printed_by(program, json.dumps(found))
    lines = {" ".join(re.split(r"[\s│┃]+", line)).strip() for line in printed.splitlines()}
    assert "a GPU, 4096 items 0.03 / 0.04" in lines
    assert "60 refits 12.2" in lines
    assert "studies: ten fits over 60 refits 0.50 1.00 missed" in lines
    assert "a stiffness of each joint: Jacobian 500 3.00 (6)" in lines


@pytest.mark.quick
def test_nothing_stored_is_no_failure(tmp_path):
    found = history(tmp_path / "bench.json", {"run": 0.1})
    command = [sys.executable, "-m", "benchmarks.history", str(found)]
    command += ["--history", str(tmp_path / "none")]
    assert subprocess.run(command, cwd=ROOT).returncode == 0


@pytest.mark.long
def test_the_benchmark_of_stiff_joints_runs(tmp_path):
    benchmark("stiffness", "--quick", "--out", tmp_path / "out")
    found = json.loads((tmp_path / "out" / "stiffness.json").read_text())
    at_error = found["seconds_at_error"]["30"]["0.0001"]
    assert set(at_error) == {"tsit5", "springs5", "kvaerno5"}
    assert all(seconds > 0 for seconds in at_error.values())
    # From 16 to 64 steps, at most a fifth of the order of 5 may be lost.
    errors = found["order"]["3"]["at every time"]
    assert errors[0] / errors[-1] > 4**4.5
    for name in ("order.png", "work_precision.png"):
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_the_benchmark_of_size_runs():
    """One case, because the others compile arms for half a minute."""
    found = json.loads(benchmark("size", "100,000 samples", "--quick"))
    assert found["peak_megabytes"] > 50
    assert found["status"] == "converged"


@pytest.mark.long
def test_the_benchmark_of_links_runs_beside_another_checkout(tmp_path):
    out = tmp_path / "links.json"
    printed = benchmark("links", "--quick", "--beside", ROOT, "--out", out)
    found = json.loads(out.read_text())
    assert set(found["here"]) == set(found["beside"]) == {"3", "6"}
    assert "6 links" in printed
    assert "of the other" in printed


@pytest.mark.parametrize("name", ["links", "fit_process"])
def test_a_folder_without_source_is_not_measured(name, tmp_path):
    """Otherwise, the installed package would be compared with itself."""
    command = [sys.executable, "-m", f"benchmarks.{name}", "--quick", "--beside", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1].startswith(f"{tmp_path} has no giajax in src")


@pytest.mark.long
def test_the_benchmark_of_cores_runs(tmp_path):
    out = tmp_path / "cores.json"
    benchmark("cores", "--quick", "--out", out)
    found = json.loads(out.read_text())
    assert found["short runs"]["standard errors apart"] <= 1e-6


@pytest.mark.long
def test_the_benchmark_of_the_right_model_runs(tmp_path):
    out = tmp_path / "right_model.json"
    benchmark("right_model", "--quick", "--out", out)
    found = json.loads(out.read_text())["arms"]
    assert {"plain", "memory", "memory and full air"} <= set(found)
    assert all(each["error"] <= 1e-4 for each in found.values())


@pytest.mark.long
def test_the_benchmark_of_commands_runs(tmp_path):
    out = tmp_path / "commands.json"
    printed = benchmark("commands", "--quick", "--out", out)
    found = json.loads(out.read_text())
    assert set(found) == {"check", "fit"}
    warm = found["fit"]["here"]["warm"]
    assert warm["compiled"] == warm["cached"]
    assert warm["clock_s"] < found["fit"]["here"]["cold"]["clock_s"]
    assert "compiled again" in printed


@pytest.mark.long
def test_the_benchmark_of_batches_runs(tmp_path):
    out = tmp_path / "new" / "batch.json"
    benchmark("batch", "--quick", "--out", out)
    found = json.loads(out.read_text())
    layouts = {"items first, 1", "items first, 4", "items last, 4", "one by one, 4"}
    assert layouts <= set(found["evaluation"])
    assert {f"{layout}, springs5" for layout in layouts} <= set(found["run"])
    assert all(seconds > 0 for part in ("evaluation", "run") for seconds in found[part].values())


@pytest.mark.long
def test_the_benchmark_of_the_scans_runs():
    size = ["--samples", "500", "--thresholds", "5", "--repeats", "1"]
    rows = json.loads(benchmark("hysteresis", *size, "--json"))
    found = {row["method"]: row for row in rows}
    assert list(found) == ["scan", "associative", "numpy"]
    for row in found.values():
        assert row["sum_of_gradient"] == found["numpy"]["sum_of_gradient"]
        assert row["gradient_s"] > 0
        assert row["peak_mib"] >= row["history_mib"] >= 0


@pytest.mark.long
def test_the_cost_of_every_option_is_measured(tmp_path):
    out = tmp_path / "options.json"
    benchmark("options", "--quick", "--out", out)
    found = json.loads(out.read_text())["options"]
    assert found["plain"]["ratio"] == 1
    assert all(each["min"] > 0 for each in found.values())
    # The arms are tiny and run only a few times; `make bench` checks the limits.
    assert {each["allowed"] for each in found.values()} == {1.0, 1.5, 2.0, None}


@pytest.mark.long
def test_hard_fits_end_and_say_why(tmp_path):
    """Four steps of a fit of two windows, and complete fits of three links."""
    out = tmp_path / "hard.json"
    benchmark("hard", "--quick", "--out", out)
    found = json.loads(out.read_text())
    (swing,) = found["pendulum"]["linear"]
    assert (swing["reason"], swing["iterations"]) == ("iterations", 4)
    assert set(found["impossible"]) == {"y and z swapped", "a random walk", "a constant"}
    for each in found["impossible"].values():
        assert each["reason"] in ("cannot_fit", "crawl", "rough", "optimum")
        assert each["iterations"] < 50  # the fit ended before its steps were used up


@pytest.mark.long
def test_all_corners_lead_to_the_optimum_in_few_steps(tmp_path):
    """The times are not checked here."""
    out = tmp_path / "hard.json"
    benchmark("hard", "--out", out)
    swings = json.loads(out.read_text())["pendulum"]
    ends = [end for each in swings.values() for end in each]
    assert len(ends) == 32
    assert all(end["optimum"] for end in ends)
    assert max(end["iterations"] for end in ends) <= 25


@pytest.mark.slow
def test_the_benchmark_of_the_start_runs():
    assert re.search(r"ratio +[0-9.]+, at most 1.5", benchmark("startup", "--quick"))


@pytest.mark.long
def test_the_benchmark_of_the_noise_runs(tmp_path):
    printed = benchmark("noise", "--quick", "--out", tmp_path / "noise.json")
    each = json.loads((tmp_path / "noise.json").read_text())["joint_loops"]
    assert f"ratio {each['ratio']:.2f}" in printed
    assert set(each["seconds"]) == set(each["iterations"]) == {"white", "correlated"}


@pytest.mark.long
def test_the_benchmark_of_the_tolerance_runs(tmp_path):
    out = tmp_path / "tolerance.json"
    printed = benchmark("tolerance", "--quick", "--out", out)
    (each,) = json.loads(out.read_text()).values()
    # The times require an idle machine, but the errors do not.
    assert max(each["off_in_standard_errors"]) < 0.01
    assert "of the former" in printed


def compared(*paths):
    """Return the errors of definitions as `benchmarks.tolerance --all` finds them."""
    program = """
import json
import pathlib
import sys
import jax
from benchmarks.tolerance import as_defined

jax.config.update("jax_enable_x64", True)
print(json.dumps([as_defined(pathlib.Path(path)) for path in sys.argv[1:]]))
"""
    return json.loads(printed_by(program, *map(str, paths)))


@pytest.mark.long
def test_the_tolerance_of_a_definition_with_its_own_settings():
    """The initial angles of its run are free, too; an algebraic model has no tolerance."""
    found, without = compared("fits/dfki_double_pendulum.toml", "fits/joint.toml")
    assert without is None
    assert found["tolerances"][0] > 1e-10
    assert 0 < found["off_in_standard_errors"][0] < 0.01


@pytest.mark.long
def test_a_fit_that_does_not_converge_is_not_compared(tmp_path):
    definition = (ROOT / "fits" / "base_step.toml").read_text()
    definition = definition.replace("../data", str(ROOT / "data"))
    path = tmp_path / "short.toml"
    path.write_text(definition.replace("[fit]\n", "[fit]\nmax_iterations = 1\n"))
    (found,) = compared(path)
    assert list(found) == ["reason"]
    assert "no optimum was reached after 1" in found["reason"]


@pytest.mark.long
def test_the_benchmark_of_a_fit_as_a_process_runs(tmp_path):
    benchmark("fit_process", "--quick", "--out", tmp_path / "fit.json")
    processes = json.loads((tmp_path / "fit.json").read_text())["processes"]["here"]
    cold, warm = processes["cold"], processes["warm"]
    # The program of the fit is worth caching.
    assert cold["cached"] == 0 < warm["cached"]
    assert warm["compiled"] < cold["compiled"]
    assert 0 < warm["first_iteration_s"] < warm["processor_s"]
    assert warm["estimates"] == cold["estimates"]
