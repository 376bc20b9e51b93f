"""A newcomer's first hour: a clone, the README from top to bottom, a user's file, mistakes.

The clone contains the committed state. The commands run as printed, in an environment created only
by them, and the instructions in messages are followed literally.
"""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from browsing import opened
from docs.machinery import browse
from giajax.models import arm_scene

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
OWN = {"air.drag_coefficient": 1.3, "joints.pitch_stiffness": 3.1, "joints.damping": 0.05}
NOISE = 0.015  # m
_PATIENCE = 300.0  # s, waiting time for a page
LINKS = ("link03", "link08", "link14", "link20")


class Terminal:
    """Runs command lines in a folder; exported variables are kept for later lines."""

    def __init__(self, folder, home):
        self.folder = folder
        self._known = home / "exported"
        self._opened = home / "opened"
        browser = home / "browser"
        browser.write_text(f'#!/bin/sh\necho "$1" >> {self._opened}\n')
        browser.chmod(0o755)
        # Remove the environment that runs the tests.
        ours = re.compile(r"PYTHON|VIRTUAL_ENV|JAX|XLA|EQX|GIAJAX|PYTEST|MAKE|MFLAGS|BROWSER")
        self._environment = {k: v for k, v in os.environ.items() if not ours.match(k)}
        cache = str(home / "programs")
        self._environment |= {"BROWSER": str(browser), "JAX_COMPILATION_CACHE_DIR": cache}
        self._environment["PYTHON"] = sys.executable

    def start(self, line):
        known = self._known
        script = (
            f"[ ! -f {known} ] || . {known}; {line}\nended=$?; export -p > {known}; exit $ended"
        )
        return subprocess.Popen(
            ["bash", "-c", script],
            cwd=self.folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def run(self, line, status=0):
        """Run a line and return its output on both streams."""
        process = self.start(line)
        said = "".join(process.communicate())
        assert process.returncode == status, f"{line}\n{said}"
        return said

    def last_opened(self):
        """Return the address with which a line has opened a browser."""
        return self._opened.read_text().split()[-1]

    @contextlib.contextmanager
    def serving(self, line):
        """Run a line until Ctrl-C; yield the address with which it opens a browser."""
        self._opened.unlink(missing_ok=True)
        process = self.start(line)
        late = time.monotonic() + _PATIENCE
        try:
            while not (self._opened.exists() and self._opened.read_text().endswith("\n")):
                assert process.poll() is None, process.communicate()
                assert time.monotonic() < late, f"{line}: no page was opened"
                time.sleep(0.1)
            yield self.last_opened()
        finally:
            os.killpg(process.pid, signal.SIGINT)
            try:
                process.communicate(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                raise


def record(path):
    """Write a user's recording: its motion, links and noise differ from those of all examples."""
    times = np.linspace(0.0, 25.0, 251)
    arm = giajax.replace(giajax.takeichi_20m(), OWN)
    command = giajax.joint_ramps(arm.count, {1: np.deg2rad(25.0)}, start=1.0, duration=2.0)
    markers = arm_scene(giajax.simulate(arm, command, jnp.asarray(times))).markers
    draw = np.random.default_rng(2026)
    heights = [markers[name][:, 2] + NOISE * draw.standard_normal(len(times)) for name in LINKS]
    degrees = np.interp(times, [1.0, 3.0], [0.0, 25.0])
    columns = ["time_s", "joint01_command_deg", *(f"{name}_z_m" for name in LINKS)]
    rows = np.column_stack([times, degrees, *heights])
    np.savetxt(path, rows, "%.6g", delimiter=",", header=",".join(columns), comments="")


def estimates(text):
    """Return value and error of each parameter in a printed table."""
    rows = re.findall(r"^(\w+\.\w+) +(\S+) +(\S+) ", text, re.MULTILINE)
    return {name: (value, error) for name, value, error in rows}


def same(shown, found):
    """Compare a printed value, except for the last digit, which depends on the processor."""
    if shown == found or "-" in (shown, found):
        return shown == found
    return abs(float(shown) - float(found)) < 1.1 * 10.0 ** -len(shown.partition(".")[2])


def look(address, tmp_path, script):
    """Open a page in Chromium, and check that it is drawn, with an empty console.

    Without Chromium, no page is opened, and the test is reported as skipped at its end.
    """
    browser = browse.installed()
    if browser is None:
        return
    with opened(browser, tempfile.mkdtemp(dir=tmp_path)) as page:
        page.open(address)
        page.wait(script, seconds=120.0)
        assert page.complaints == []


def test_the_readme_from_top_to_bottom_with_a_file_of_ones_own(tmp_path):
    clone = tmp_path / "giajax"
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("without a checkout of git nothing can be cloned")
    subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
    terminal = Terminal(clone, tmp_path)
    readme = (clone / "README.md").read_text(encoding="utf-8")
    record(clone / "run.csv")
    done = {}
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL):
        if language == "text":
            (clone / "shown.csv").write_text(block)
            terminal.run("giajax check --data shown.csv")
        elif language == "python":
            (clone / "shown.py").write_text(block)
            terminal.run("python shown.py")
        elif block.startswith("parameter "):
            printed, shown = estimates(done["make demo"]), estimates(block)
            assert printed.keys() == shown.keys()
            for name, numbers in shown.items():
                assert all(map(same, numbers, printed[name])), name
        else:
            for line in block.splitlines():
                words = line.partition("#")[0].strip()
                done[words] = follow(terminal, words, clone, tmp_path)
    assert {"make demo", "make test", "giajax view giajax-out/run"} <= done.keys()
    found = json.loads((clone / "giajax-out" / "run" / "result.json").read_text())
    assert found["status"] == "converged"
    assert found["verdict"]["status"] == "adequate"
    for path, truth in OWN.items():
        one = found["parameters"][path]
        assert abs(one["value"] - truth) < 4 * one["standard_error"]
    make_mistakes(terminal, clone, estimates(done["giajax fit --data run.csv"]))
    if browse.installed() is None:
        pytest.skip("all commands ran, but no page was opened, because there is no browser")


def follow(terminal, line, clone, tmp_path):
    """Follow a line of the README, and check its results."""
    if line == "make test":
        # This test runs within `make test`, so only check that the command would run.
        said = terminal.run("make --dry-run test")
        assert "pytest" in said
        return said
    if line.startswith("giajax view"):
        with terminal.serving(line) as address:
            drawn = "[...document.querySelectorAll('canvas')].some((one) => one.width > 300)"
            look(address, tmp_path, drawn)
        return ""
    said = terminal.run(line)
    if line == "make demo":
        # A missing extra is installed with the command in the message.
        refused = terminal.run(".venv/bin/giajax report giajax-out/base_step", status=2)
        terminal.run(refused.partition("installed: ")[2])
        # The commands at the end of the demonstration work.
        for each in re.findall(r"^  (\. .*|\.venv/.*)$", said, re.MULTILINE):
            terminal.run(f"({each})")
        look(terminal.last_opened(), tmp_path, "document.body.dataset.drawn")
    elif line.startswith("giajax init"):
        state_noise(clone / "run.toml")
    elif line.startswith("giajax report"):
        page = clone / "giajax-out" / "run" / "report.html"
        look(page.as_uri(), tmp_path, "document.body.dataset.drawn")
    return said


def state_noise(sidecar):
    """Enable a line that `giajax init` has offered."""
    offered, text = "# position_m = 0.01 ", sidecar.read_text()
    assert text.count(offered) == 1
    sidecar.write_text(text.replace(offered, f"position_m = {NOISE} "))


def make_mistakes(terminal, clone, printed):
    """Make typical mistakes of a first day, and correct each one as its message says."""
    header, rows = (clone / "run.csv").read_text().split("\n", 1)
    for wrong, status in (("joint1_comand_deg", 2), ("joint01_command_rad", 0)):
        name = f"{wrong}.csv"
        (clone / name).write_text(header.replace("joint01_command_deg", wrong) + "\n" + rows)
        said = terminal.run(f"giajax check --data {name}", status=status)
        (advice,) = re.findall(rf"--rename {wrong}=\w+", said)
        mended = terminal.run(f"giajax check --data {name} --strict {advice}")
        assert "joint01_command " in mended
        assert f"column '{wrong}'" not in mended
    # The correct name is among those that the fit has printed, so nothing is fitted again.
    wrong = "air.drag_coeficient"
    said = terminal.run(f"giajax fit --data run.csv --free {wrong}", status=2)
    (right,) = re.findall(rf"'{wrong}': did you mean '(\S+)'\?", said)
    assert right in printed
