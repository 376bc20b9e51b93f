"""The benchmark runs, compares what it says it compares, and writes what it shows."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_the_benchmark_runs(tmp_path):
    out = tmp_path / "new" / "bench.json"
    command = [sys.executable, str(ROOT / "benchmarks" / "bench.py"), "--quick", "--out", str(out)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(out.read_text())
    assert set(found["chosen"]) == set(found["run"]) > set(found["gradient"])
    for name, chosen in found["chosen"].items():
        assert chosen["error"] < found["problem"]["tip_accuracy_m"], name
    # Three ways to the same derivatives.
    for name, gradient in found["gradient"].items():
        assert gradient["error"] < 0.05, name
    assert all(ratio > 0 for ratio in found["ratios"].values())
    for heading in ("value + 4", "One evaluation", "Ratios"):
        assert heading in ended.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["new"]
