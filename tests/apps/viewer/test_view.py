"""The viewer from a user's perspective: its files, its page in a browser, and its errors."""

import dataclasses
import json
import re
import time
from contextlib import nullcontext

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import giajax
from browsing import opened
from giajax import InputError
from giajax.apps.tracking import BAND, end_columns
from giajax.apps.viewer import (
    Posable,
    Show,
    Viewer,
    _stage as _backend,
    posed,
    recording,
    shown,
    words,
)
from giajax.cli import main
from giajax.models import ArmModel, Pinhole, Scene
from open_ports import open_ports
from small_arm import small_run


@pytest.fixture(scope="module")
def run_and_show(tmp_path_factory):
    """Return a small run, and the function that shows it."""
    folder = tmp_path_factory.mktemp("shown")
    return small_run(folder), shown(folder / "run.csv")


@pytest.fixture(scope="module")
def show(run_and_show):
    """Show a small arm in motion, and where a camera saw it, shifted slightly to the left."""
    scene = run_and_show[1].scene
    seen = {name: points + np.array([0.0, 0.5, 0.0]) for name, points in scene.markers.items()}
    return Show("swing", scene, seen)


@pytest.fixture
def page(browser, tmp_path):
    with opened(browser, tmp_path / "profile") as found:
        yield found


def test_a_run_is_shown_with_its_recording(run_and_show, tmp_path):
    run, found = run_and_show
    assert found.name == "run"
    assert_allclose(found.clock, run.times)
    assert set(found.recorded) <= set(found.scene.markers)
    assert found.recorded
    with pytest.raises(InputError, match=r"nothing\.csv"):
        shown(tmp_path / "nothing.csv")


def plots_of(page):
    """Return the plots of a page by title, with the curves by name."""
    data = re.search(r'id="about">(.*?)</script>', page.decode(), re.DOTALL)[1]
    return {
        plot["title"]: {curve["name"]: curve for curve in plot["curves"]}
        for plot in json.loads(data)["plots"]
    }


def test_a_page_offers_every_channel_of_a_run(tmp_path):
    times = np.linspace(0.0, 1.0, 11)
    values = {
        "joint01_command": 0.5 * times,
        "joint02_command": 0.0 * times,
        "joint01_angle": 0.4 * times + 0.01,
        "tip_z": times,
        "wind_y": 2.0 + times,
    }
    values["joint01_angle"][3] = np.nan
    giajax.write_run(tmp_path / "run.csv", times, values, definition={"arm": {"links": 2}})
    show = shown(tmp_path / "run.csv")
    plots = plots_of(recording([show]))
    titles = list(plots)
    assert titles[:3] == ["position of tip, m", "joint angle and joint command, deg", "wind, m/s"]
    assert "position of link01, m" in titles[3:]
    assert plots["position of tip, m"]["z"]["dots"] == pytest.approx(times, abs=1e-4)
    angles = plots["joint angle and joint command, deg"]
    assert list(angles) == ["joint01_angle", "joint01_command", "joint02_angle", "joint02_command"]
    assert [name for name in angles if angles[name]["chosen"]] == list(angles)[:2]
    assert angles["joint01_command"]["values"] == pytest.approx(np.rad2deg(0.5 * times), rel=1e-4)
    # A constant command is stored once.
    assert angles["joint02_command"]["values"] == [0.0]
    assert angles["joint01_angle"]["dots"][3] is None
    assert angles["joint01_angle"]["dots"][10] == pytest.approx(np.rad2deg(0.41), rel=1e-4)
    simulated = show.scene.channels["joint02_angle"]
    assert angles["joint02_angle"]["values"] == pytest.approx(np.rad2deg(simulated), rel=1e-4)
    assert angles["joint02_angle"]["dots"] == []
    assert plots["wind, m/s"]["wind_y"]["values"] == pytest.approx(2.0 + times, rel=1e-4)
    assert plots["wind, m/s"]["wind_y"]["dots"] == []


def test_plots_of_a_long_motion_of_many_joints_are_small(show):
    """Joint angles are thinned like all curves, and those that vary the most are offered."""
    count, joints = 4000, 100
    scene = show.scene
    points = np.zeros((count, 2, 3)) + scene.lines[0].points[0]
    line = dataclasses.replace(scene.lines[0], points=points)
    times = np.linspace(0.0, 400.0, count)
    channels = {f"joint{n:02d}_angle": n * np.sin(times) for n in range(1, joints + 1)}
    long = Scene((line,), {"tip": points[:, 1]}, times)
    size = len(json.dumps(plots_of(recording([Show("long", long)]))))
    plots = plots_of(recording([Show("long", dataclasses.replace(long, channels=channels))]))
    curves = plots["joint angle, deg (60 of 100 channels)"]
    assert list(curves) == [f"joint{n:02d}_angle" for n in range(41, 101)]
    assert {len(curve["values"]) for curve in curves.values()} == {300}
    assert len(json.dumps(plots)) - size < 60 * 3_500


def test_an_arm_is_posed_by_hand(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text("[arm]\nlinks = 2\n")
    arm = shown(path)
    assert isinstance(arm, Posable)
    posed = arm.show(np.array([0.5, 0.0])).scene
    link = posed.lines[0].points[0]
    assert_allclose(np.arctan2(link[1, 2], link[1, 0]), 0.5)
    path.write_text('model = "joint"\n')
    with pytest.raises(InputError, match="describes a joint: give the TOML file of an arm"):
        shown(path)


POSED = {"arm": {"links": 2}, "initial": {"first_row": True}}


def angles_of(count, lift):
    """Return two joint angles that increase by `lift` (rad) in one second."""
    times = np.linspace(0.0, 1.0, count)
    return times, {"joint01_angle": lift * times, "joint02_angle": 0.0 * times}


def test_an_arm_is_posed_by_its_recorded_angles():
    """Nothing is simulated: an arm that would fall stays at its recorded angles."""
    times, angles = angles_of(5, 0.4)
    found = posed(giajax.Run.from_arrays(times, angles, definition=POSED), "truth")
    link = found.scene.lines[0].points[:, 1]
    assert_allclose(np.arctan2(link[:, 2], link[:, 0]), 0.4 * times, atol=1e-12)
    alone = {"joint01_angle": angles["joint01_angle"]}
    with pytest.raises(InputError, match="has no joint02_angle: give the angles of all 2 joints"):
        posed(giajax.Run.from_arrays(times, alone, definition=POSED), "truth")
    angles["joint02_angle"][3] = np.nan
    with pytest.raises(InputError, match=r"has no value of an angle at 0\.75 s"):
        posed(giajax.Run.from_arrays(times, angles, definition=POSED), "truth")


def tracked_folder(folder, lift=0.4):
    """Write the part of the output of `giajax track` that is shown, for an arm of two links."""
    times, angles = angles_of(5, lift)
    giajax.write_run(folder / "estimate.csv", times, angles, definition=POSED)
    (folder / "track.json").write_text("{}")
    ends = posed(giajax.read_run(folder / "estimate.csv"), "").scene.lines
    columns = {"time_s": times}
    for link in (0, 1):
        for k, axis in enumerate("xyz"):
            mean, deviation = end_columns(link, axis)
            columns[mean] = ends[link].points[:, 1, k]
            columns[deviation] = np.full(5, 0.01 * (1 + k + 3 * link))
    table = np.stack([*columns.values()], axis=1)
    header = ",".join(columns)
    np.savetxt(folder / "bands.csv", table, delimiter=",", header=header, comments="")
    return folder


def test_a_track_is_shown_with_its_bands(tmp_path):
    found = shown(tracked_folder(tmp_path))
    assert_allclose(found.bands.centres[:, 1], found.scene.markers["tip"], atol=1e-12)
    assert_allclose(found.bands.halves[2] / BAND, [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]])
    size = BAND * np.linalg.norm([0.04, 0.05, 0.06])
    assert f"tip within {1e3 * size:.1f} mm of the estimate" in words(found, 2, "blue")
    # A file of an earlier version contains only the states.
    (tmp_path / "bands.csv").write_text("time_s\n" + 5 * "0\n")
    old = shown(tmp_path)
    assert old.bands is None
    assert any("track the run again" in note for note in old.notes)


@pytest.mark.parametrize(
    ("damaged", "sentence"),
    [
        (lambda text: text + "1,2\n", r"bands\.csv: row 7 has 2 cells"),
        (
            lambda text: text[: text.rindex("\n", 0, -1) + 1],
            r"bands\.csv has missing rows or cells",
        ),
        (
            lambda text: text[: text.rindex(",") + 1] + "\n",
            r"bands\.csv has missing rows or cells",
        ),
        (
            lambda text: text[: text.rindex(",") + 1] + "six\n",
            r"bands\.csv: .* but must have a number",
        ),
        (lambda text: "", r"bands\.csv is empty"),
    ],
)
def test_damaged_bands_are_one_sentence(damaged, sentence, tmp_path):
    path = tracked_folder(tmp_path) / "bands.csv"
    path.write_text(damaged(path.read_text()))
    with pytest.raises(InputError, match=sentence) as refused:
        shown(tmp_path)
    assert "\n" not in str(refused.value)


def test_bands_and_truth_are_on_the_page(page, tmp_path):
    folder = tmp_path / "tracked"
    folder.mkdir()
    times, angles = angles_of(9, 0.42)
    true = tmp_path / "true.csv"
    giajax.write_run(true, times, angles, definition=POSED)
    out = tmp_path / "seen.html"
    given = ["view", str(tracked_folder(folder)), "--truth", str(true), "--page", str(out)]
    assert main(given) == 0
    page.open(out.as_uri())
    page.wait("document.querySelector('[role=slider]') !== null")
    assert not page.complaints
    found = [shown(folder), posed(giajax.read_run(true), "truth")]
    viewer = Viewer(found, overlay=True)
    try:
        balls = viewer.stages[0]._handles["bands/ellipsoids"][0]
        # The ellipsoid surrounds the balloon, whose radius is 15 cm.
        assert_allclose(balls.batched_scales, 0.15 + found[0].bands.halves[0], rtol=1e-6)
        assert "bands" not in viewer.stages[1].layers()
        page.open(viewer.address)
        page.wait("document.body.innerText.includes('95 % regions of the ends of links')")
        page.wait("document.body.innerText.includes('truth')")
        assert not page.complaints
    finally:
        viewer.close()


def test_a_file_plays_without_a_server(show, page, tmp_path):
    out = tmp_path / "swing.html"
    out.write_bytes(recording([show, dataclasses.replace(show, name="again")]))
    assert (
        b'<meta http-equiv="Content-Security-Policy" content="default-src \'none\''
        in (out.read_bytes()[:1000])
    )
    page.open(out.as_uri())
    # The clock is running.
    page.wait("document.querySelector('[role=slider]') !== null")
    first = page.evaluate("document.querySelector('[role=slider]').ariaValueNow")
    page.wait(f"document.querySelector('[role=slider]').ariaValueNow != '{first}'")
    assert page.evaluate("document.querySelector('[role=slider]').ariaValueMax") == "4"
    assert not page.complaints


def test_the_page_plays_and_hides(show, page):
    viewer = Viewer([show])
    try:
        page.open(viewer.address)
        page.wait(
            "document.body.innerText.includes('RMS distance to the recorded markers 500.0 mm')"
        )
        button = "[...document.querySelectorAll('button')].find(b => b.innerText == 'play')"
        page.wait(f"!!{button}")
        page.evaluate(f"{button}.click()")
        page.wait("!document.body.innerText.includes('time 0.00 s')")
        assert viewer.player.playing
        # Besides the boxes of viser: "repeat", and then the layers.
        box = "document.querySelectorAll('input[type=checkbox]:not([id^=mantine])')[1]"
        layer = viewer.stages[0]._layers["balloons"]
        assert layer.visible
        page.evaluate(f"{box}.click()")
        end = time.monotonic() + 10
        while layer.visible:
            assert time.monotonic() < end
            time.sleep(0.02)
        assert not page.complaints
    finally:
        viewer.close()


def test_the_gate_is_the_only_door(show):
    before = open_ports()
    viewer = Viewer([show])
    try:
        assert open_ports() - before == {int(viewer.address.split(":")[2].split("/")[0])}
    finally:
        viewer.close()


def test_a_viser_that_listens_elsewhere_is_not_used(show, monkeypatch):
    """This version does not request its socket from `websockets` in the known way."""
    before = open_ports()
    monkeypatch.setattr(_backend, "_listening_at", lambda *_: nullcontext())
    with pytest.raises(InputError, match=r"opens a port that other accounts can reach: pip inst"):
        Viewer([show])
    assert open_ports() == before


def test_sliders_move_the_arm(page):
    chain = giajax.takeichi_20m(2)
    viewer = Viewer([Posable(ArmModel(chain), "arm")])
    try:
        page.open(viewer.address)
        page.wait("document.querySelectorAll('[role=slider]').length == 2")
        page.evaluate("document.querySelectorAll('[role=slider]')[0].focus()")
        for _ in range(4):
            for kind in ("keyDown", "keyUp"):
                page.call(
                    "Input.dispatchKeyEvent", type=kind, key="ArrowRight", code="ArrowRight",
                    windowsVirtualKeyCode=39,
                )  # fmt: skip
        # All four commands of half a degree have arrived.
        height = float(np.sum(chain.links.length)) * np.sin(np.deg2rad(2.0))
        page.wait(f"document.body.innerText.match(/tip at [0-9.]+, 0.000, {height:.3f}/)")
        link = viewer.stages[0].show.scene.lines[0].points[0]
        assert_allclose(np.rad2deg(np.arctan2(link[1, 2], link[1, 0])), 2.0, atol=1e-6)
        assert not page.complaints
    finally:
        viewer.close()


def test_markers_are_where_a_camera_sees_them(show, page):
    """Rendered by the browser, and compared with our projection: within one pixel."""
    camera = Pinhole(
        position=[1.5, -6.0, 0.8], rotation=[0.05, 0.02, np.pi / 2 + 0.1], focal_length=600.0,
        centre=[319.5, 239.5], size=(640, 480),
    )  # fmt: skip
    view = camera.view()
    viewer = Viewer([show])
    try:
        for layer in ("balloons", "markers", "air"):
            viewer.stages[0].visible(layer, False)
        viewer.server.scene.remove_by_name("/grid")
        page.open(viewer.address)
        page.wait("document.body.innerText.includes('play')")
        sample = 25
        viewer.player.seek(float(show.clock[sample]))
        viewer.draw()
        time.sleep(1.0)
        client = next(iter(viewer.server.get_clients().values()))
        turn = Rotation.from_matrix(np.asarray(view.axes)).as_quat(scalar_first=True)
        field = 2 * float(np.arctan(240 / 600))
        picture = client.get_render(
            480, 640, wxyz=turn, position=np.asarray(view.centre), fov=field, transport_format="png"
        )
    finally:
        viewer.close()
    weights = picture[..., 3] / 255
    rows, columns = np.indices(weights.shape)
    for name, points in show.recorded.items():
        expected = np.asarray(camera.project(jnp.asarray(points[sample])).pixels)
        near = weights * (np.hypot(columns - expected[0], rows - expected[1]) < 6)
        assert near.sum() > 3, name
        found = np.array([(near * columns).sum(), (near * rows).sum()]) / near.sum()
        assert np.linalg.norm(found - expected) < 1.0, name


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["nothing.csv"],
            "nothing.csv does not exist: give a run, the folder of a fit, or the TOML",
        ),
        (["arm.toml", "arm.toml"], "the TOML file of an arm contains no motion, so it must be"),
        (["arm.toml", "--page", "page.html"], "page.html exists"),
        (["arm.toml", "--port", "70000", "--no-browser"], "the port is 70000"),
        (
            ["arm.toml", "--host", "", "--no-browser"],
            "the host is '', which is not an address: give",
        ),
    ],
)
def test_errors_are_one_sentence(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text("[arm]\nlinks = 2\n")
    (tmp_path / "page.html").write_text("mine")
    assert main(["view", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert (tmp_path / "page.html").read_text() == "mine"
