"""The runs of data/synthetic/ are reproduced by their command lines."""

import hashlib
import importlib.util
import shutil
from pathlib import Path

import pytest

from giajax import read_run

FOLDER = Path(__file__).parents[3] / "data" / "synthetic"


def script(path):
    spec = importlib.util.spec_from_file_location("regenerate", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.long
def test_every_run_comes_out_of_the_table():
    regenerate = script(FOLDER / "regenerate.py")
    assert sorted(path.stem for path in FOLDER.glob("*.csv")) == sorted(
        [*regenerate.RUNS, *regenerate.STILL]
    )
    assert regenerate.check() == []


def test_the_runs_have_noise_gaps_and_a_truth():
    for path in FOLDER.glob("*.csv"):
        run = read_run(path)
        assert run.definition.sha256 == run.sha256
        # The true values of the simulated prototype are not parameters of a model that is fitted to
        # it.
        if path.stem != "one_link":
            assert run.definition.truth
            assert all(run.noise(name) > 0 for name in run.observations)


@pytest.fixture
def altered(tmp_path):
    """Run the script on a copy of the folder, for one of its runs."""
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    return script(tmp_path / "regenerate.py")


def restate(path, old, new, *, checksum):
    """Replace text in a run; with `checksum`, the sidecar is updated accordingly."""
    text = path.read_text()
    assert text.count(old) == 1
    before = hashlib.sha256(text.encode()).hexdigest()
    path.write_text(text.replace(old, new))
    if checksum:
        after = hashlib.sha256(path.read_bytes()).hexdigest()
        sidecar = path.with_suffix(".toml")
        sidecar.write_text(sidecar.read_text().replace(before, after))


def first_value(path):
    return path.read_text().splitlines()[1].split(",")[-1]


def test_a_changed_value_is_found_by_its_checksum(altered):
    path = altered.HERE / "base_step.csv"
    restate(path, first_value(path), "0.123", checksum=False)
    assert ["SHA-256" in sentence for sentence in altered.differences("base_step")] == [True]


@pytest.mark.slow
def test_a_changed_value_is_found_by_simulating(altered):
    path = altered.HERE / "base_step.csv"
    value = first_value(path)
    # The change is far below the noise of 0.02 m, and far above rounding on another machine.
    restate(path, value, f"{float(value) + 1e-5:.8f}", checksum=True)
    (found,) = altered.differences("base_step")
    assert "link20_z differs by" in found


@pytest.mark.slow
def test_a_changed_command_line_is_found(altered):
    meaning, options = altered.RUNS["base_step"]
    altered.RUNS["base_step"] = (meaning, options.replace("=1.12", "=1.1201"))
    sentences = altered.differences("base_step")
    assert "base_step.toml states something else than its command line" in sentences
    assert any("link20_z differs" in sentence for sentence in sentences)


def test_it_refuses_other_arguments(capsys):
    assert script(FOLDER / "regenerate.py").main(["--chek"]) == 2
    assert "usage" in capsys.readouterr().err
