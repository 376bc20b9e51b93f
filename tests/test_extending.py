"""The examples of docs/extending: as scripts, and as plug-ins of the commands in new processes."""

import subprocess
import sys
from pathlib import Path

import pytest

import giajax

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "extending"
RESULTS = {
    "cauchy_loss": "robust",
    "coffee_filter": "filter",
    "fullness_drag": "fullness",
    "hardening_joint": "hardening",
}


@pytest.mark.quick
def test_each_example_is_one_file_of_at_most_60_lines_that_asserts():
    texts = {path.stem: path.read_text() for path in EXAMPLES.glob("*.py")}
    assert texts.keys() == RESULTS.keys()
    for text in texts.values():
        assert text.count("\n") <= 60
        assert "assert" in text


@pytest.mark.slow
@pytest.mark.parametrize("name", RESULTS)
def test_an_example_is_fitted_saved_loaded_reported_asked_and_fitted_again(name, tmp_path):
    plugin, folder = EXAMPLES / f"{name}.py", RESULTS[name]

    def run(*words):
        return subprocess.run(
            [sys.executable, *map(str, words)], cwd=tmp_path, capture_output=True, text=True
        )

    done = run(plugin)
    assert done.returncode == 0, done.stderr
    command = ("-m", "giajax")
    missing = run(*command, "report", folder)
    assert missing.returncode == 2
    assert f"it was made with {name}.py: give --plugin {name}.py" in missing.stderr
    # The script has asked for the suspects of the law; workers import a plug-in, too.
    commands = {
        "cauchy_loss": [
            ("report", folder),
            ("fit", "--data", f"{folder}/prediction.csv", "--loss", "CauchyLoss"),
        ],
        "coffee_filter": [
            ("report", folder),
            ("suspects", folder),
            ("bootstrap", folder, "--size", "2", "--no-figures", "--workers", "2"),
        ],
    }
    again = [("report", folder), ("fit", "--data", f"{folder}/prediction.csv")]
    for words in commands.get(name, again):
        done = run(*command, *words, "--plugin", plugin)
        assert done.returncode == 0, done.stderr


def test_a_model_that_is_not_registered_is_refused_with_what_it_was_made_with():
    with pytest.raises(giajax.InputError, match="there is no kind of model 'balloon' here: use"):
        giajax.models.build_model("balloon", {}, {})
