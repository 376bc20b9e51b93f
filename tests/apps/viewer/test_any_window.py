"""The camera of every page with an arm shows all of the arm, and the arm fills half the window."""

import dataclasses
import itertools
import time

import numpy as np
import pytest

from arm_in_window import READY, check, check_file, resize
from browsing import opened
from docs.machinery.browse import WIDTHS
from giajax.apps.driving import Cockpit, Session, TipCamera
from giajax.apps.viewer import Posable, Show, Viewer, brick, edges, outline, recording
from giajax.mechanics.arm import takeichi_20m
from giajax.models import ArmModel, Block, Line, Scene


def lifted(count=9):
    """Return the scene of an arm of ten links that is lifted and turned."""
    ends = np.arange(11.0)
    lift = np.linspace(0.0, 0.3, count)
    lines = []
    for link in range(10):
        points = np.zeros((count, 2, 3))
        for end in (0, 1):
            far = ends[link + end]
            points[:, end, 0] = far * np.cos(lift)
            points[:, end, 1] = far * 0.3 * np.sin(lift)
            points[:, end, 2] = far * np.sin(lift)
        lines.append(Line("link", points, np.array([0.15, 0.15])))
    return Scene(tuple(lines), {"tip": lines[-1].points[:, 1]}, 0.1 * np.arange(count))


def beside_a_building(tilt, bend):
    """Return the scene of an arm of 20 links beside a wall; angles from upright by sample, deg."""
    turned = np.deg2rad(np.add.outer(tilt, np.zeros(20)) + np.outer(bend, np.linspace(0, 1, 20)))
    steps = np.stack([np.sin(turned), np.zeros_like(turned), np.cos(turned)], axis=-1)
    ends = np.concatenate([np.zeros((len(tilt), 1, 3)), np.cumsum(steps, axis=1)], axis=1)
    lines = [Line("link", ends[:, k : k + 2], np.array([0.15, 0.15])) for k in range(20)]
    front = Block("front", np.array([10.1, 0.0, 3.15]), np.array([0.2, 8.0, 8.3]), np.eye(3))
    return Scene(tuple(lines), {"tip": ends[:, -1]}, 10.0 * np.arange(len(tilt)), (), (front,))


def ends_of(scene):
    return np.concatenate([line.points.reshape(-1, 3) for line in scene.lines])


def test_an_outline_has_the_arm_at_every_sample():
    """In any direction, no point of a surface is more than 5 cm outside the outline."""
    scene = lifted()
    found = outline(scene)
    random = np.random.default_rng(0).normal(size=(50, 3))
    directions = random / np.linalg.norm(random, axis=1, keepdims=True)
    farthest = np.max(ends_of(scene) @ directions.T + 0.15, axis=0)
    missing = farthest - np.max(found @ directions.T, axis=0)
    assert np.all(missing < 0.05)
    assert len(found) <= 240


@pytest.fixture
def page(browser, tmp_path):
    with opened(browser, tmp_path / "profile") as found:
        resize(found, WIDTHS[0])
        yield found


def test_a_file_shows_all_of_the_arm(page, tmp_path):
    """The page is that of `giajax view --page`, `mission --page` and `life`."""
    page.draw_no_scene()
    out = tmp_path / "lift.html"
    scene = lifted()
    seen = {"tip": scene.markers["tip"] + 0.1}
    out.write_bytes(recording([Show("a </script> lift", scene, seen)]))
    page.open(out.as_uri())
    page.wait(READY, 120)
    check(page, ends_of(scene))
    legend = page.evaluate("document.getElementById('legend').innerText")
    for row in ("a </script> lift", "recorded markers", "grid of 1 m"):
        assert row in legend
    options = "[...document.querySelectorAll('#legend option')].map((one) => one.textContent)"
    assert page.evaluate(options) == ["position of tip, m"]
    inked = (
        "(() => { const c = document.querySelector('#legend canvas'); return c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data.some((part) => part > 0); })()"
    )
    page.wait(inked, 120)
    assert not page.complaints


def press(page, key, code):
    for kind in ("keyDown", "keyUp"):
        names = {"key": " " if key == "Space" else key, "code": key, "windowsVirtualKeyCode": code}
        page.call("Input.dispatchKeyEvent", type=kind, **names)


def test_the_plotted_curves_are_chosen_by_keyboard(page, tmp_path):
    """On a phone: joint angles and commands, of which the keys choose another curve."""
    scene = lifted()
    angles = {f"joint{n:02d}_angle": n * 0.01 * scene.times for n in range(1, 21)}
    command = np.full(len(scene.times), np.deg2rad(30.0))
    channels = {**angles, "joint01_command": command, "joint20_command": 0.1 * command}
    show = Show("a lift", dataclasses.replace(scene, channels=channels))
    out = tmp_path / "lift.html"
    out.write_bytes(recording([show], dark=True))
    page.draw_no_scene()
    resize(page, WIDTHS[1])
    page.open(out.as_uri())
    page.wait(READY, 120)
    # Whether there is a curve in the third colour: the page plays, so its picture always changes.
    third = (
        "(() => { const c = document.querySelector('#legend canvas'), copy = new OffscreenCanvas("
        "c.width, c.height).getContext('2d', { willReadFrequently: true }); "
        "copy.drawImage(c, 0, 0); const all = copy.getImageData(0, 0, c.width, c.height).data; "
        "for (let i = 0; i < all.length; i += 4) if (all[i + 3] > 100 && "
        "[47, 191, 149].every((part, k) => Math.abs(all[i + k] - part) < 20)) return true; "
        "return false; })()"
    )
    chosen = (
        "[...document.querySelectorAll('#legend label')].filter((one) => "
        "one.firstChild.checked).map((one) => one.textContent).join()"
    )
    assert page.evaluate(chosen) == "x,y,z"
    page.evaluate("document.querySelector('#legend select').focus()")
    press(page, "ArrowDown", 40)
    selected = "document.querySelector('#legend select').selectedOptions[0].textContent"
    page.wait(f"{selected} === 'joint angle and joint command, deg'")
    assert page.evaluate(chosen) == "joint20_angle,joint20_command"
    assert not page.evaluate(third)
    press(page, "Tab", 9)
    press(page, "Space", 32)
    page.wait(f"{chosen} === 'joint01_angle,joint20_angle,joint20_command'")
    page.wait(third)
    for _ in range(21):  # the last of the curves, which scrolls into view
        press(page, "Tab", 9)
    label = "document.activeElement.parentElement"
    assert page.evaluate(f"{label}.textContent") == "joint20_command"
    box = page.evaluate(
        f"(() => {{ const a = {label}.getBoundingClientRect(), "
        "b = document.querySelector('#legend fieldset').getBoundingClientRect(); "
        "return [a.top - b.top, b.bottom - a.bottom, a.left, innerWidth - a.right]; })()"
    )
    assert min(box) > -2
    assert page.evaluate("document.documentElement.scrollWidth") == WIDTHS[1]
    assert not page.complaints


@pytest.mark.parametrize(
    ("tilt", "bend", "upright"),
    [
        pytest.param([0.0, 0.0, 0.0], [0.0, 60.0, 130.0], True, id="mission"),
        pytest.param([-90.0, -45.0, 0.0, 0.0], [0.0, 0.0, 0.0, 130.0], False, id="life"),
    ],
)
def test_an_arm_beside_a_building(tilt, bend, upright, browser, tmp_path):
    scene = beside_a_building(tilt, bend)
    file = tmp_path / "page.html"
    file.write_bytes(recording([Show("arm", scene)]))
    check_file(browser, tmp_path / "profile", file, ends_of(scene), upright=upright)


def test_edges_of_a_wall_are_those_of_the_whole():
    """A frame of eight boxes has the edges of its outline and of its hole, and no others."""
    boxes = []
    for x, y in itertools.product((-1, 0, 1), repeat=2):
        if (x, y) != (0, 0):
            boxes.append(brick().vertices + np.array([x, y, 0.0]))
    found = edges(boxes)
    lengths = np.linalg.norm(found[:, 0] - found[:, 1], axis=1)
    assert lengths == pytest.approx(1.0)
    # Of the outline 12 pieces in each plane, of the hole 4, and 4 + 4 edges between the planes.
    assert len(found) == 2 * (12 + 4) + 8
    across = found.mean(axis=1)
    outside = np.isclose(np.abs(across[:, :2]).max(axis=1), 1.5)
    hole = np.isclose(np.abs(across[:, :2]).max(axis=1), 0.5)
    assert np.all(outside | hole)
    assert len(edges([brick().vertices])) == 12


# The first bytes of the two formats, after the size of the first box of an MP4 file.
_STARTS = {"mp4": (4, b"ftyp"), "webm": (0, b"\x1aE\xdf\xa3")}


def test_a_video_of_the_scene_is_saved(page, tmp_path):
    out = tmp_path / "lift.html"
    out.write_bytes(recording([Show("a lift", lifted(), {})]))
    page.open(out.as_uri())
    page.wait(READY, 120)
    resize(page, WIDTHS[1])
    page.evaluate(
        """(() => {
          const saved = window.saved = {};
          const address = URL.createObjectURL;
          URL.createObjectURL = (blob) => {
            blob.arrayBuffer().then((data) => { saved.data = [...new Uint8Array(data)]; });
            return address(blob);
          };
          HTMLAnchorElement.prototype.click = function () { saved.name = this.download; };
        })()"""
    )
    button = (
        "[...document.querySelectorAll('#legend button')].find((b) => /video/.test(b.textContent))"
    )
    assert page.evaluate(f"{button}.textContent") == "record a video"
    page.evaluate(f"{button}.click()")
    assert page.evaluate(f"{button}.textContent") == "stop and save the video"
    time.sleep(5.0)
    page.evaluate(f"{button}.click()")
    page.wait("window.saved.data && window.saved.name", 60)
    stem, ending = page.evaluate("window.saved.name").split(".")
    at, start = _STARTS[ending]
    data = bytes(page.evaluate("window.saved.data.slice(0, 64)"))
    assert stem == "giajax_a_lift"
    assert data[at : at + len(start)] == start
    assert page.evaluate("window.saved.data.length") > 500
    assert page.evaluate(f"{button}.textContent") == "record a video"
    assert not page.complaints


def test_a_live_page_shows_all_of_the_arm(page):
    viewer = Viewer([Posable(ArmModel(takeichi_20m(4)), "arm")])
    try:
        page.draw_no_scene()
        page.open(viewer.address)
        page.wait(READY, 120)
        check(page, ends_of(viewer.shows[0].scene))
        # The viser settings contain the address, and a button shows them.
        token = viewer.address.split("/")[3]
        having = (
            f"[...document.querySelectorAll('input')].filter((o) => o.value.includes('{token}'))"
        )
        assert page.evaluate(f"{having}.map((one) => one.style.display)") == ["none"]
        assert not page.complaints
    finally:
        viewer.close()


def test_the_panel_of_a_narrow_live_page_opens_and_its_time_is_plotted(page):
    viewer = Viewer([Show("a lift", lifted())])
    try:
        page.draw_no_scene()
        resize(page, WIDTHS[1])
        page.open(viewer.address)
        page.wait(READY, 120)
        page.wait("document.querySelector('.collapsed') !== null", 120)
        page.evaluate("window.panel = document.querySelector('.collapsed'), 0")
        height = "panel.getBoundingClientRect().height"
        closed = page.evaluate(height)
        # The line in the plot is at the time of this slider.
        page.wait("document.querySelector('[role=slider]')?.ariaValueNow === '0'")
        page.evaluate("panel.querySelector('[style*=\"height: 3.5em\"]').click()")
        page.wait(f"{height} > {3 * closed}")
        assert not page.complaints
    finally:
        viewer.close()


# What a user can read in a page: its texts, the values of its inputs and its title.
READ = """[document.title, document.body.innerText, ...[...document.querySelectorAll("input")]
  .filter((one) => one.offsetWidth).map((one) => one.value)].join()"""


def test_the_page_of_a_drive_shows_all_of_the_arm(page):
    """Its token can only be read in the address bar, in the path by which the page is reloaded."""
    model = ArmModel(takeichi_20m(4))
    cockpit = Cockpit(Session(model), TipCamera(model))
    try:
        page.draw_no_scene()
        page.open(cockpit.address)
        scene = "document.getElementById('view').contentWindow"
        page.wait(f"{scene}.eval({READY!r})", 120)
        check(page, ends_of(cockpit._scene(cockpit.session.pose)))
        token = cockpit.address.split("/")[3]
        assert page.evaluate("location.href") == cockpit.address
        of_scene = READ.replace("document", f"{scene}.document")
        for text, title in ((READ, "giajax drive"), (of_scene, "giajax: arm")):
            assert page.evaluate(text).startswith(title)
            assert token not in page.evaluate(text)
        assert not page.complaints
    finally:
        cockpit.close()
