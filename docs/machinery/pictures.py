"""Draw the pictures of the README and the pages with the commands that the gallery shows.

python -m docs.machinery.pictures            all pictures, into docs/pictures; takes many minutes
python -m docs.machinery.pictures fig5.png   only the named ones

The last command below a picture ends with a comment that names the file in `giajax-out`. Pictures
that no command draws are drawn by this module.
"""

import contextlib
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.colors import LightSource

import giajax
from evidence._tracking import DELAY, INTENSITY, LENGTH_SCALE, MEAN, recorded
from giajax.apps.experiments import one_link
from giajax.apps.mission import Mission, Operator
from giajax.apps.paper import explained, explanations_figure
from giajax.apps.planning import Through, plan_command, plan_figure
from giajax.apps.synthetic import DECAY
from giajax.apps.tracking import Air, Unknown, track_figure, usual_places
from giajax.apps.wind import first_guess
from giajax.cli import main as command
from giajax.report import draw_scene, new_figure, plain, to_png

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "pictures"
GALLERY = ROOT / "docs" / "gallery.md"

_SHOWN = re.compile(
    r"!\[[^\]]+\]\(pictures/([\w.]+)\)$.*?^```\n(.*?)^```$", re.DOTALL | re.MULTILINE
)
_PACE = 2  # speed of the animation relative to the arm


def _animated() -> None:
    """Animate the paper's experiment in air and without air, seen from the side."""
    arm = giajax.takeichi_20m()
    still = giajax.replace(arm, {"air.density": 0.0})
    command = giajax.joint_ramps(arm.count, {1: np.deg2rad(30)}, start=0.5, duration=1.0)
    times = jnp.linspace(0.0, 25.0, 126)
    scenes = {
        title: giajax.models.arm_scene(giajax.simulate(each, command, times, solver="springs5"))
        for title, each in (("in air, C_D = 1.2", arm), ("without air", still))
    }
    figure = new_figure(8.6, 4.2, "", "")
    panels = dict(zip(scenes, figure.subplots(1, 2, sharey=True), strict=True))
    low, high = np.array([scene.extent() for scene in scenes.values()]).transpose(1, 0, 2)
    title = figure.suptitle("", fontsize=10, x=0.01, ha="left")

    def draw(sample: int) -> None:
        for name, panel in panels.items():
            panel.clear()
            draw_scene(panel, scenes[name], sample)
            plain(panel, name)
            panel.set_xlim(-0.5, 20.5)
            panel.set_ylim(low[:, 2].min() - 0.3, high[:, 2].max() + 0.3)
            panel.set_xlabel("along the straight arm (m)")
        figure.axes[0].set_ylabel("height (m)")
        title.set_text(f"The base joint turns by 30 degrees within a second: {times[sample]:.1f} s")

    animation = FuncAnimation(figure, draw, len(times))
    rate = _PACE * (len(times) - 1) / float(times[-1])
    animation.save(FOLDER / "arm.gif", writer=PillowWriter(fps=round(rate)), dpi=80)


def _in_space() -> None:
    """Draw the arm in three dimensions at several times, while its first two joints turn."""
    arm = giajax.takeichi_20m()
    angles = {1: np.deg2rad(30), 2: np.deg2rad(-40)}
    times = np.array([0.0, 3.0, 7.0, 25.0])
    command = giajax.joint_ramps(arm.count, angles, start=0.5, duration=1.5)
    scene = giajax.models.arm_scene(giajax.simulate(arm, command, jnp.asarray(times)))
    figure = new_figure(8.6, 4.1, "", "The arm at four times of a motion, with its shadow.")
    figure.set_layout_engine("none")
    # A 3D panel is square and clips its contents, so it is as wide as the figure.
    panel: Any = figure.add_axes((-0.05, -0.61, 1.0, 2.15), projection="3d", computed_zorder=False)
    light = LightSource(azdeg=300, altdeg=50)
    for sample, time in enumerate(times):
        for line in scene.lines:
            body = _balloon(line.points[sample], float(line.radii[0]))
            panel.plot_surface(
                *body,
                color=_SHADES[sample],
                lightsource=light,
                linewidth=0,
                antialiased=False,
                zorder=sample,
            )
        aside = (-0.8, 0.0, -0.9) if time == 0 else (0.3, 0.0, 0.1)
        place = scene.markers["tip"][sample] + np.asarray(aside)
        panel.text(*place, f"{time:.0f} s", fontsize=9)
    low, high = scene.extent()
    panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    panel.set_box_aspect(high - low, zoom=0.8)
    panel.set(xticks=range(0, 21, 5), yticks=range(-10, 1, 2), zticks=range(-1, 4))
    panel.set(ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    panel.view_init(elev=24, azim=-60)
    panel.set_xlabel("x, ahead (m)", labelpad=14)
    panel.set_ylabel("y, left (m)", labelpad=8)
    panel.set_zlabel("z, up (m)")
    panel.tick_params(labelsize=8)
    (FOLDER / "arm.png").write_bytes(to_png(figure))


_SHADES = ("#D9D9D9", "#9ECAE1", "#4C93C0", "#08519C")  # early to late, light to dark


def _balloon(ends: np.ndarray, radius: float) -> np.ndarray:
    """Return surface coordinates of a cylinder with rounded ends between two points."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.cross(along, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    upright = np.cross(along, across)
    cap = np.linspace(0.0, np.pi / 2, 6)
    length = np.linalg.norm(ends[1] - ends[0])
    # Flattened ends: neighbouring bodies touch only at their centres.
    depth = 0.4 * radius
    places = np.concatenate([depth * (1 - np.cos(cap)), length - depth * (1 - np.cos(cap[::-1]))])
    radii = radius * np.concatenate([np.sin(cap), np.sin(cap[::-1])])
    turn = np.linspace(0.0, 2 * np.pi, 25)
    ring = across[:, None] * np.cos(turn) + upright[:, None] * np.sin(turn)
    centres = ends[0][:, None] + along[:, None] * places
    return centres[:, :, None] + radii[:, None] * ring[:, None, :]


def _wrinkling() -> None:
    """Draw the explanations of fig. 12 that are closest to the paper's text."""
    study = one_link()
    trial = study.trial("paper", "none")
    loop = trial.angles[trial.history.measured]
    (FOLDER / "wrinkling.png").write_bytes(to_png(explanations_figure(explained(loop), loop)))


def _moves() -> None:
    """Draw the planned motion of the mock-up's arm through the opening, without joint memory."""
    stated = giajax.Definition.load(ROOT / "missions" / "naraha.toml").contents()
    del stated["arm"]["parameters"]
    mission = Mission.from_definition(giajax.Definition.parse(stated))
    operator = Operator.from_section(mission.section, mission.model.arm.count)
    target = Through(approach=np.asarray(operator.approach))
    found = plan_command(mission.model, target)
    title = "Through the opening as fast as the limits allow"
    (FOLDER / "moves.png").write_bytes(to_png(plan_figure(found, title)))


def _tracking() -> None:
    """Draw the tracking of an eight-link arm in gusts, with a delayed camera."""
    model = giajax.replace(giajax.ArmModel(giajax.takeichi_20m_full(8)), {"camera.delay": DELAY})
    run, _ = recorded(model.arm, np.random.default_rng(3), 8)
    wind = first_guess(MEAN, INTENSITY, LENGTH_SCALE, DECAY)
    air = Air(wind, 0.1, places=usual_places(model))
    found = giajax.track(model, run, unknown=Unknown(air=air))
    title = "Eight links in gusts, the tip half a second late"
    (FOLDER / "tracking.png").write_bytes(to_png(track_figure(found, title)))


DRAWN_HERE: dict[str, Callable[[], None]] = {
    "arm.gif": _animated,
    "arm.png": _in_space,
    "wrinkling.png": _wrinkling,
    "moves.png": _moves,
    "tracking.png": _tracking,
}
"""Function that draws each picture without a command."""


def shown() -> dict[str, list[str]]:
    """Return the command lines that the gallery shows for each picture."""
    found = _SHOWN.findall(GALLERY.read_text(encoding="utf-8"))
    return {name: block.replace("\\\n", "").splitlines() for name, block in found}


def drawn(names: Iterable[str], folder: Path) -> Iterator[tuple[str, bytes]]:
    """Run the commands of the gallery in an empty folder, and yield each picture with its name.

    Raises:
        RuntimeError: a command fails.
    """
    for source in ("data", "fits", "missions"):
        (folder / source).symlink_to(ROOT / source)
    done = []
    for name in names:
        lines = shown()[name]
        for words in (shlex.split(line, comments=True) for line in lines):
            if words not in done:
                with contextlib.chdir(folder):
                    status = command(words[1:])
                if status:
                    raise RuntimeError(f"{shlex.join(words)} ended with {status}")
                done.append(words)
        file = lines[-1].partition("# ")[2]
        yield name, (folder / "giajax-out" / file).read_bytes()


def main(wanted: list[str]) -> None:
    """Draw the named pictures, or all pictures."""
    jax.config.update("jax_enable_x64", True)
    names = [name for name in shown() if not wanted or name in wanted]
    for name in (name for name in names if name in DRAWN_HERE):
        DRAWN_HERE[name]()
        print(name, flush=True)
    with TemporaryDirectory() as folder:
        others = (name for name in names if name not in DRAWN_HERE)
        for name, contents in drawn(others, Path(folder)):
            (FOLDER / name).write_bytes(contents)
            print(name, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
