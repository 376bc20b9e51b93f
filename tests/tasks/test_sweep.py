"""A sweep: its table, failures, continuation, and compiled programs that the fits share."""

import json
import re

import jax
import polars as pl
import pytest

import giajax
import small_loops
from giajax import InputError
from giajax.cli import main
from giajax.cli._sweep import _show
from giajax.tasks import Plan

PLAN = """
fit = "loops_fit.toml"
[grid]
loss = ["linear"]
fix.offset = [0.1, 0.2]
start."weights[0]" = [0.3, 0.8]
free = [["elastic", "weights[0]"], ["elastic", "nothing"]]
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Return the folder of a plan, and its table by the command line."""
    folder = tmp_path_factory.mktemp("sweep")
    small_loops.write_task(folder)
    (folder / "plan.toml").write_text(PLAN)
    words = ["sweep", str(folder / "plan.toml"), "--out", str(folder / "out")]
    assert main([*words, "--quiet"]) == 1
    return folder, words


def test_the_table_has_a_row_for_each_fit(swept):
    folder, _ = swept
    table = pl.read_parquet(folder / "out" / "sweep.parquet")
    assert table.schema == {
        "key": pl.String, "status": pl.String, "message": pl.String,
        "loss": pl.String, "fix.offset": pl.Float64,
        "start.weights[0]": pl.Float64, "free": pl.String,
        "value.elastic": pl.Float64, "error.elastic": pl.Float64,
        "value.weights[0]": pl.Float64, "error.weights[0]": pl.Float64,
        "cost": pl.Float64, "reduced_chi_square": pl.Float64, "verdict": pl.String,
        "iterations": pl.Int64, "seconds": pl.Float64, "worker": pl.String,
        "validation.output of other": pl.Float64,
    }  # fmt: skip
    assert table["fix.offset"].to_list() == [0.1] * 4 + [0.2] * 4
    assert table["status"].to_list() == ["converged", "failed"] * 4
    good, bad = table[::2], table[1::2]
    assert all("nothing" in message for message in bad["message"])
    assert bad["value.elastic"].null_count() == 4
    # Both initial guesses give the same estimate. The true value is 0.8 only with an offset of 0.1.
    assert good["value.weights[0]"][0] == pytest.approx(good["value.weights[0]"][1], rel=1e-4)
    assert abs(good["value.weights[0]"][0] - 0.8) < 3 * good["error.weights[0]"][0]
    assert good["verdict"].to_list() == ["adequate"] * 2 + ["inadequate"] * 2
    # With the true values, the residual is the noise of 0.005.
    assert good["validation.output of other"].to_list()[:2] == pytest.approx([0.005] * 2, rel=0.3)
    assert {json.loads(text)[1] for text in bad["free"]} == {"nothing"}


def test_a_sweep_goes_on_and_compiles_nothing(swept, compiled, capsys):
    """One more value of a fixed parameter; fits of the same structure share their programs."""
    folder, words = swept
    path = folder / "out" / "sweep.parquet"
    before, files = pl.read_parquet(path), len(list((folder / "out" / "fits").iterdir()))
    assert main([*words, "--dry-run"]) == 0
    assert "of which 4 are already done" in capsys.readouterr().out
    (folder / "plan.toml").write_text(PLAN.replace("[0.1, 0.2]", "[0.1, 0.2, 0.15]"))
    programs = compiled()
    assert main(words) == 1
    assert compiled() == programs
    printed = capsys.readouterr()
    assert "4 of 12 fits are already done" in printed.err
    assert "12 fits: 6 converged, 6 failed" in printed.out
    # Each estimate has its error, and a suitable number of digits.
    assert re.search(r"converged +0\.\d+ ± 0\.\d+ +0\.\d+ ± 0\.\d+ +adequate", printed.out)
    after = pl.read_parquet(path)
    # The failed fit was repeated.
    assert after[:8].drop("seconds").equals(before.drop("seconds"))
    assert after[:8:2].equals(before[::2])
    assert len(list((folder / "out" / "fits").iterdir())) == files + 2


def test_the_table_of_another_plan_is_kept(swept):
    folder, _ = swept
    other = Plan.parse({"fit": "loops_fit.toml", "grid": {"fix": {"offset": [0.1]}}}, folder)
    with pytest.raises(InputError, match="is the table of another plan"):
        giajax.sweep(other, out=folder / "out")
    small = {"data": [str(folder / "missing.csv")]}
    with pytest.raises(InputError, match=r"missing\.csv no longer exists"):
        giajax.sweep(small, out=folder / "other")


def test_a_file_that_changes_meanwhile_fails_its_fits(swept, tmp_path):
    small_loops.write_task(tmp_path)
    plan = Plan.parse({"fit": "loops_fit.toml"}, tmp_path)
    (task,) = plan.tasks()
    small_loops.write_loops(tmp_path / "loops.csv", (0, 1, -0.5), seed=1)
    with pytest.raises(InputError, match="has changed since the sweep began"):
        task.call()


def test_what_runs_have_for_themselves_is_in_the_table(tmp_path):
    """It is shown next to the mean; predicted runs of the same name are shown by their paths."""
    small_loops.write_task(tmp_path)
    (tmp_path / "more").mkdir()
    small_loops.write_loops(tmp_path / "more" / "loops.csv", (0, 1, -0.5), seed=1)
    definition = small_loops.DEFINITION.replace("[fit.fix]\noffset = 0.1", "[fit.fix]")
    definition = definition.replace('"weights[0]" = 0.3', "offset = 0.3")
    definition = definition.replace('"weights[0]"]', '"weights", "offset"]\nper_run = ["offset"]')
    (tmp_path / "loops_fit.toml").write_text(definition)
    files = {
        "data": [["loops.csv", "other.csv"]],
        "validation": [["loops.csv", "more/loops.csv"]],
    }
    plan = Plan.parse({"fit": "loops_fit.toml", "grid": files}, tmp_path)
    (row,) = giajax.sweep(plan, out=tmp_path / "out").to_dicts()
    own = [row[f"value.offset of {name}"] for name in ("loops", "other")]
    assert own[0] != own[1]
    assert row["value.offset"] == pytest.approx(sum(own) / 2, rel=1e-12)
    for name in ("loops", "other"):
        error = row[f"error.offset of {name}"]
        assert abs(row[f"value.offset of {name}"] - 0.1) < 4 * error < 0.01
    predicted = [name for name in row if name.startswith("validation.")]
    assert predicted == [
        f"validation.output of loops ({tmp_path / name})"
        for name in ("loops.csv", "more/loops.csv")
    ]
    assert all(0.001 < row[name] < 0.01 for name in predicted)


def test_32_bit_is_refused(swept):
    folder, _ = swept
    with jax.enable_x64(False), pytest.raises(InputError, match="computes in 32-bit"):
        giajax.sweep(folder / "plan.toml", out=folder / "narrow")
    assert not (folder / "narrow").exists()


@pytest.mark.quick
def test_what_a_fit_does_not_determine_is_marked(capsys):
    columns = {
        "status": ["converged", "not_converged", "failed"],
        "verdict": ["adequate", None, None],
    }
    columns |= {"value.gain": [2.34567, 2.0, None], "error.gain": [None, None, None]}
    _show(pl.DataFrame({**columns, "message": ["", "", "no such file"]}), [])
    rows = capsys.readouterr().out.splitlines()
    assert rows[1].split() == ["converged", "2.34567", "(not", "determined)", "adequate"]
    assert rows[2].split() == ["not_converged", "2", "-"]
    assert rows[3].split() == ["failed", "-", "-"]
