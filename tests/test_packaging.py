"""Installation: tested version bounds, one version everywhere, and a wheel that works."""

import itertools
import os
import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from giajax.fitting import load_result

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION = PROJECT["version"]
EXTRAS = ("bench", "mujoco", "report", "view", "cluster", "posterior", "ros", "docs", "test")


def pinned(name):
    """Return the versions in a constraints file, by lower-case name."""
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    pairs = (line.split("==") for line in lines if line and not line.startswith("#"))
    return {name.lower(): Version(version) for name, version in pairs}


def lower_bounds():
    """Return the lower bounds of the package, its tests and its documentation."""
    extras = PROJECT["optional-dependencies"]
    several = (extras[name] for name in EXTRAS)
    texts = [*PROJECT["dependencies"], *itertools.chain.from_iterable(several)]
    bounds = {}
    for requirement in map(Requirement, texts):
        if requirement.name == "giajax":
            continue
        (bound,) = requirement.specifier
        assert bound.operator == ">=", requirement
        bounds[requirement.name.lower()] = Version(bound.version)
    return bounds


@pytest.mark.quick
def test_the_lowest_versions_that_are_tested_are_those_that_are_allowed():
    assert pinned("constraints-lowest.txt") == lower_bounds()


@pytest.mark.quick
def test_the_usual_versions_are_allowed():
    usual = pinned("constraints.txt")
    assert {name: usual[name] >= bound for name, bound in lower_bounds().items()} == dict.fromkeys(
        lower_bounds(), True
    )


@pytest.mark.quick
def test_one_version_everywhere():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", citation, re.MULTILINE)[1] == VERSION
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (\S+)", changelog, re.MULTILINE)
    assert VERSION in headings


def run(*command, cwd):
    """Run a process that cannot access the packages of this environment."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    ended = subprocess.run(
        list(map(str, command)), cwd=cwd, env=environment, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.long
def test_a_wheel_in_a_clean_environment_runs_the_demonstration(tmp_path):
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    download = [*pip, "download", "--no-deps", "--dest", tmp_path / "index", "hatchling"]
    if subprocess.run(download, capture_output=True).returncode:
        pytest.skip("no package index can be reached")
    wheels = tmp_path / "wheels"
    run(*pip, "wheel", "--no-deps", "--wheel-dir", wheels, ROOT, cwd=tmp_path)
    (wheel,) = wheels.iterdir()
    assert wheel.name == f"giajax-{VERSION}-py3-none-any.whl"
    clean = tmp_path / "clean"
    venv.create(clean, with_pip=True)
    scripts = clean / ("Scripts" if os.name == "nt" else "bin")
    constraints = ROOT / "constraints.txt"
    run(scripts / "python", *pip[1:], "install", wheel, "-c", constraints, cwd=tmp_path)
    giajax = scripts / "giajax"
    run(giajax, "examples", "--copy", tmp_path / "examples", cwd=tmp_path)
    data = tmp_path / "examples" / "data" / "synthetic" / "base_step.csv"
    printed = run(giajax, "fit", "--data", data, "--out", tmp_path / "out", cwd=tmp_path)
    assert "air.drag_coefficient" in printed
    drag = load_result(tmp_path / "out").parameters["air.drag_coefficient"]
    assert abs(drag.value - 1.12) < 4 * drag.standard_error
