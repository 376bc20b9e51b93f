"""The pictures of README and pages, by the functions that giajax draws with.

python -m docs.machinery.pictures            all of them, into docs/pictures, in minutes
python -m docs.machinery.pictures arm.gif    some
"""

import sys
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.colors import LightSource

import giajax
from evidence._tracking import DELAY, INTENSITY, LENGTH_SCALE, MEAN, recorded
from giajax.apps.experiments import figure_12, one_link
from giajax.apps.filling import curve_figure, filling_curve, filling_figure
from giajax.apps.joint import correction_figure, equilibria_figure, equilibria_table, joint_figure
from giajax.apps.life import life_figure, live
from giajax.apps.mission import Mission, Operator, mission_figure
from giajax.apps.paper import explained, explanations_figure, reproduce
from giajax.apps.planning import Through, plan_command, plan_figure, plan_rows
from giajax.apps.shaping import Command, shape_command, shaping_figure
from giajax.apps.synthetic import DECAY
from giajax.apps.tracking import Air, Unknown, track_figure, usual_places
from giajax.apps.unrolling import unroll, unrolling_figure
from giajax.apps.wind import first_guess
from giajax.mechanics.joint import LARGEST_ANGLE, JointPair
from giajax.mechanics.unrolling import Unrolling
from giajax.report import (
    correlation_figure,
    draw_scene,
    new_figure,
    plain,
    recorded_figure,
    residuals_figure,
    sensitivity_figure,
    to_png,
)

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "pictures"

_NOISE = 0.01  # m, of a camera
_PACE = 2  # times as fast as the arm


def _animated() -> None:
    """The paper's experiment in air and without, from the side."""
    arm = giajax.takeichi_20m()
    still = giajax.replace(arm, {"air.density": 0.0})
    command = giajax.joint_ramps(arm.count, {1: np.deg2rad(30)}, start=0.5, duration=1.0)
    times = jnp.linspace(0.0, 25.0, 126)
    scenes = {
        title: giajax.models.arm_scene(giajax.simulate(each, command, times, solver="springs5"))
        for title, each in (("in air, C_D = 1.2", arm), ("without air", still))
    }
    figure = new_figure(8.6, 4.2, "")
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
    """The arm in three dimensions at some times, while its first two joints turn."""
    arm = giajax.takeichi_20m()
    angles = {1: np.deg2rad(30), 2: np.deg2rad(-40)}
    times = np.array([0.0, 3.0, 7.0, 25.0])
    command = giajax.joint_ramps(arm.count, angles, start=0.5, duration=1.5)
    scene = giajax.models.arm_scene(giajax.simulate(arm, command, jnp.asarray(times)))
    figure = new_figure(8.6, 4.1, "")
    figure.set_layout_engine("none")
    # A panel of three dimensions is square, and cuts off what is outside: as wide as the figure.
    panel = figure.add_axes((-0.05, -0.61, 1.0, 2.15), projection="3d", computed_zorder=False)
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
    _save("arm", to_png(figure))


_SHADES = ("#D9D9D9", "#9ECAE1", "#4C93C0", "#08519C")  # from light to dark, as time goes on


def _balloon(ends: np.ndarray, radius: float) -> np.ndarray:
    """A round body with round ends from one point to another: coordinates of its surface."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.cross(along, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    upright = np.cross(along, across)
    cap = np.linspace(0.0, np.pi / 2, 6)
    length = np.linalg.norm(ends[1] - ends[0])
    # The round ends are flat: neighbours touch in the middle alone.
    depth = 0.4 * radius
    places = np.concatenate([depth * (1 - np.cos(cap)), length - depth * (1 - np.cos(cap[::-1]))])
    radii = radius * np.concatenate([np.sin(cap), np.sin(cap[::-1])])
    turn = np.linspace(0.0, 2 * np.pi, 25)
    ring = across[:, None] * np.cos(turn) + upright[:, None] * np.sin(turn)
    centres = ends[0][:, None] + along[:, None] * places
    return centres[:, :, None] + radii[:, None] * ring[:, None, :]


def _fit() -> None:
    """The demonstration run and its fit."""
    run = giajax.read_run(ROOT / "data" / "synthetic" / "base_step.csv")
    result = giajax.fit(giajax.model_for([run]), run)
    predicted = giajax.predict(result.model, run)
    (record,) = result.runs
    _save("fit", to_png(recorded_figure(result, run, predicted, record)))
    _save("residuals", to_png(residuals_figure(result, [run], [predicted])))


def _correlation() -> None:
    """A fit of the camera's frame beside the arm: what the data can tell apart."""
    result = giajax.FitTask.load(ROOT / "fits" / "camera_frame.toml").run(check=False)
    _save("correlation", to_png(correlation_figure(result)))


def _joint() -> None:
    """One joint at rest."""
    pair = JointPair()
    end = round(float(np.rad2deg(LARGEST_ANGLE)))
    holding, _ = equilibria_table(pair, np.linspace(-end, end, 2 * end + 1))
    _save("equilibria", to_png(equilibria_figure(pair, holding, 20.0)))
    _save("corrections", to_png(correction_figure(pair.joint)))
    _save("joint", to_png(joint_figure(pair.joint, (60.0, 10.0, -2.0, -30.0))))


def _sensitivity() -> None:
    """When and where the paper's experiment shows C_D."""
    times = np.linspace(0.0, 25.0, 251)
    command = np.interp(times, [0.5, 1.5], [0.0, np.deg2rad(30.0)])
    run = giajax.apps.synthetic.planned(times, {"joint01_command": command}, links=20)
    found = giajax.sensitivity(
        giajax.ArmModel(giajax.takeichi_20m()), run, ["air.drag_coefficient"]
    )
    _save("sensitivity", to_png(sensitivity_figure(found, _NOISE, "What each link tells of C_D")))


def _hysteresis() -> None:
    """The paper's 1-link experiment on a simulated joint."""
    _save("fig12", to_png(figure_12(one_link())))


def _wrinkling() -> None:
    """The explanations of fig. 12 that are nearest to the text."""
    study = one_link()
    trial = study.trial("paper", "none")
    loop = trial.angles[trial.history.measured]
    _save("wrinkling", to_png(explanations_figure(explained(loop), loop)))


def _filling() -> None:
    """The arm filled with helium, and which port goes with which supply."""
    _save("filling", to_png(filling_figure(giajax.fill())))
    _save("filling_curve", to_png(curve_figure(filling_curve())))


def _unrolling() -> None:
    """The arm unrolled by gas, at the flow that fills it in the paper's time."""
    found = unroll(Unrolling(order="by gas"))
    _save("unrolling", to_png(unrolling_figure(found)))


def _life() -> None:
    """The mock-up from its roll on."""
    definition = giajax.Definition.load(ROOT / "missions" / "naraha.toml")
    _save("life", to_png(life_figure(live(Mission.from_definition(definition)))))


def _mission() -> None:
    """The mock-up, once."""
    definition = giajax.Definition.load(ROOT / "missions" / "naraha.toml")
    mission = Mission.from_definition(definition)
    _save("mission", to_png(mission_figure(mission, mission.fly(1))))


def _shaping() -> None:
    """A move of the base joint, unshaped and shaped."""
    arm = giajax.ArmModel(giajax.takeichi_20m_full())
    angles = np.zeros((2, 20))
    angles[1, 0] = np.deg2rad(5.0)
    found = shape_command(arm, Command(np.array([0.0, 30.0]), angles))
    _save("shaping", to_png(shaping_figure(found, "5 degrees within 30 s, unshaped and shaped")))


def _moves() -> None:
    """The arm of the mock-up, without joint memory, on its way through the opening."""
    stated = giajax.Definition.load(ROOT / "missions" / "naraha.toml").contents()
    del stated["arm"]["parameters"]
    mission = Mission.from_definition(giajax.Definition.parse(stated))
    operator = Operator.from_section(mission.section, mission.model.arm.count)
    target = Through(approach=np.asarray(operator.approach))
    found = plan_command(mission.model, target)
    for row in plan_rows(found):
        print(row)
    _save("moves", to_png(plan_figure(found, "Through the opening as fast as the limits allow")))


def _tracking() -> None:
    """An arm of eight links that is tracked in gusts, by a late camera."""
    model = giajax.replace(giajax.ArmModel(giajax.takeichi_20m_full(8)), {"camera.delay": DELAY})
    run, _ = recorded(model.arm, np.random.default_rng(3), 8)
    wind = first_guess(MEAN, INTENSITY, LENGTH_SCALE, DECAY)
    air = Air(wind, 0.1, places=usual_places(model))
    found = giajax.track(model, run, unknown=Unknown(air=air))
    title = "Eight links in gusts, the tip half a second late"
    _save("tracking", to_png(track_figure(found, title)))


def _paper() -> None:
    """A figure of the paper, made again."""
    for name, made in reproduce(["fig5"], ROOT / "data" / "paper"):
        _save(name, to_png(made.figure))


def _save(name: str, contents: bytes) -> None:
    (FOLDER / f"{name}.png").write_bytes(contents)


PICTURES: dict[str, Callable[[], None]] = {
    "arm.gif": _animated,
    "arm.png": _in_space,
    "fit.png residuals.png": _fit,
    "correlation.png": _correlation,
    "equilibria.png corrections.png joint.png": _joint,
    "sensitivity.png": _sensitivity,
    "fig12.png": _hysteresis,
    "wrinkling.png": _wrinkling,
    "filling.png filling_curve.png": _filling,
    "unrolling.png": _unrolling,
    "life.png": _life,
    "mission.png": _mission,
    "shaping.png": _shaping,
    "moves.png": _moves,
    "tracking.png": _tracking,
    "fig5.png": _paper,
}
"""What makes which files."""


def main(wanted: list[str]) -> None:
    """Make those that are wanted, or all."""
    jax.config.update("jax_enable_x64", True)
    FOLDER.mkdir(exist_ok=True)
    for names, make in PICTURES.items():
        if not wanted or set(wanted) & set(names.split()):
            make()
            print(names, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
