"""Run the tests of `raising.py` in a process in which a failed check of Equinox raises."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FILE = Path(__file__).with_name("raising.py")


@pytest.mark.slow
def test_failed_checks_raise_in_a_library_that_sets_nothing():
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(FILE)]
    # This is Equinox's default, which the session of these tests has changed.
    environment = {**os.environ, "EQX_ON_ERROR": "raise"}
    done = subprocess.run(
        words, cwd=FILE.parents[2], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "7 passed" in done.stdout
