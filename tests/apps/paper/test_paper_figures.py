"""The figures of the paper: compared with other tolerances and another engine, and as files."""

import csv
import io
import json
import re

import numpy as np
import pytest

from giajax.apps.paper import (
    FIGURES,
    SHOWN_LINKS as LINKS,
    STEP_AT,
    STEP_DEG,
    TOLERANCE,
    Reproduced,
    Sources,
    heights,
    reproduced_files,
    reproduced_record,
    reproduction_page,
    stored_record,
)
from giajax.cli._paper import INVERSE, NAMES
from giajax.mechanics.arm import takeichi_20m
from giajax.report import new_figure
from giajax.schema.parameters import replace
from giajax.simulation import joint_steps
from peers.compiling import NoCompilerError


@pytest.mark.quick
def test_the_command_knows_every_figure():
    assert tuple(FIGURES) == (*NAMES, INVERSE)


@pytest.fixture
def shown():
    figure = new_figure(4, 3, "A title", "A line.")
    figure.subplots().plot([0, 1], [0, 1])
    return Reproduced(
        "A <title>",
        Sources("the model.", "a stiffness.", "nothing."),
        figure,
        ("link", "z, m"),
        ((6, 0.25),),
        {"time_s": np.array([0.0, 1.0]), "z_m": ["", "0.5"]},
        {"seeds": np.arange(2)},
    )


@pytest.mark.quick
def test_a_figure_becomes_a_picture_and_its_numbers(shown):
    files = reproduced_files("fig0", shown)
    assert list(files) == ["fig0.png", "fig0.csv", "fig0.json"]
    assert files["fig0.png"].startswith(b"\x89PNG")
    rows = list(csv.DictReader(io.StringIO(files["fig0.csv"].decode())))
    assert rows == [{"time_s": "0", "z_m": ""}, {"time_s": "1", "z_m": "0.5"}]
    record = json.loads(files["fig0.json"])
    assert record["sources"]["assumed"] == "a stiffness."
    assert record["table"] == {"headings": ["link", "z, m"], "rows": [[6, 0.25]]}
    assert record["columns"]["time_s"] == [0, 1]
    assert record["seeds"] == [0, 1]


@pytest.mark.quick
def test_the_sources_stand_below_the_picture(shown):
    text = shown.figure.get_supxlabel()
    for word in ("Printed in the paper: the model.", "Assumed: a stiffness.", "Reconstructed: no"):
        assert word in text


@pytest.mark.quick
def test_the_page_shows_each_figure_with_its_sources(shown):
    page = reproduction_page([reproduced_record(name, shown) for name in ("fig0", "fig1")]).decode()
    assert re.findall(r'src="(.*?)"', page) == ["fig0.png", "fig1.png"]
    assert re.findall(r'href="(.*?)"', page) == [
        "fig0.csv", "fig0.json", "fig1.csv", "fig1.json",
    ]  # fmt: skip
    assert page.count("<dd>a stiffness.</dd>") == 2
    assert "A &lt;title&gt;" in page
    assert "<title>" in page
    assert "A <title>" not in page


@pytest.mark.quick
def test_a_figure_that_is_whole_is_known_again(shown, tmp_path):
    assert stored_record(tmp_path, "fig0") is None
    files = reproduced_files("fig0", shown)
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    assert stored_record(tmp_path, "fig0") == reproduced_record("fig0", shown)
    for name, broken in (
        ("fig0.png", files["fig0.png"][:-4]),
        ("fig0.csv", b""),
        ("fig0.json", files["fig0.json"][:-9]),
        ("fig0.json", files["fig0.json"].replace(b'"name": "fig0"', b'"name": "fig1"')),
        ("fig0.json", re.sub(b'"giajax": "', b'"giajax": "0.', files["fig0.json"])),
        ("fig0.json", b"[]"),
    ):
        (tmp_path / name).write_bytes(broken)
        assert stored_record(tmp_path, "fig0") is None, (name, broken)
        (tmp_path / name).write_bytes(files[name])


@pytest.fixture(scope="module")
def curves():
    return heights()


ROWS = [link - 1 for link in LINKS]


@pytest.mark.slow
def test_halved_tolerances_move_no_curve_of_fig_5(curves):
    _, z = curves
    _, finer = heights(TOLERANCE / 2)
    for air in ("with", "without"):
        assert np.abs(z[air] - finer[air])[:, ROWS].max() < 1e-5
    # Check that the curves vary, and that the air has an effect.
    assert np.ptp(z["without"][:, 19]) > 10 > 2 * np.ptp(z["with"][:, 19])


@pytest.mark.slow
@pytest.mark.parametrize("air", ["with", "without"])
def test_fig_5_is_that_of_mujoco(curves, air):
    """The centre of a link is halfway between its ends."""
    mujoco_c = pytest.importorskip("peers.mujoco_c", reason="mujoco is not installed")
    times, z = curves
    arm = takeichi_20m()
    if air == "without":
        arm = replace(arm, {"air.drag_coefficient": 0.0})
    command = joint_steps(arm.count, {1: np.deg2rad(STEP_DEG)}, time=STEP_AT)
    try:
        peer = mujoco_c.MujocoInC(arm, command)
    except NoCompilerError as error:
        pytest.skip(str(error))
    ends = peer.ends(times, 0.005)[..., 2]
    centres = (ends + np.concatenate([np.zeros((len(times), 1)), ends[:, :-1]], axis=1)) / 2
    assert np.abs(z[air] - centres)[:, ROWS].max() < 1e-4
