"""Figs 5 and 19 and table 3 of the paper, and its inversion for unpublished parameters."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...mechanics.arm import Arm, takeichi_20m
from ...recordings import Run
from ...report import (
    BLUE,
    DEGREE,
    GREEN,
    GREY,
    INK,
    LIGHT,
    VERMILLION,
    columns_of,
    new_figure,
    plain,
)
from ...runtime.arrays import Array, Float
from ...runtime.programs import program
from ...schema.parameters import replace
from ...simulation import Signal, integrate, joint_steps, simulate
from ._contenders import (
    CONTENDERS,
    HEIGHTS,
    LINKS,
    STEP,
    WINDOW,
    Fits,
    Reproduced,
    Sources,
    compared,
    concordance,
    relative_error,
    times_of,
)

STARTS_AT = 0.5  # The base joint begins to bend at this time, s. Table 3 starts 9.5 s later.
_TOLERANCE = 1e-6
_MAX_STEPS = 20_000

# Without these parameters the joints have no hysteretic element.
_REMEMBERING = {"joints.memory.strength": 0.03, "joints.memory.yield_angle": 0.003}


class Unknown(NamedTuple):
    """A quantity of the comparison that the paper does not print: its label and its range.

    The label contains the unit of the range. `unit` is the value of that unit in SI.
    """

    label: str
    lower: float
    upper: float
    unit: float = 1.0


_DEGREE = float(np.deg2rad(1.0))

UNKNOWNS = {
    "stiffness": Unknown("arm: pitch stiffness, N m/rad", 1.0, 10.0),
    "damping": Unknown("arm: damping, N m s/rad", 0.005, 0.5),
    "drag": Unknown("arm: C_D", 0.5, 2.0),
    "strength": Unknown("arm: hysteretic joint torque, N m", 0.003, 0.3),
    "yield": Unknown("arm: yield angle of the hysteretic torque, rad", 0.001, 0.03),
    "reach": Unknown("arm: base angle relative to that of the model", 0.5, 1.5),
    "angle": Unknown("base joint: angle, deg", 10.0, 60.0, _DEGREE),
    "lasting": Unknown("base joint: duration of the bend, s", 0.25, 6.0),
    "back": Unknown("base joint: time of the return, s", 8.0, 22.0),
    "model_stiffness": Unknown("model: pitch stiffness, N m/rad", 1.0, 10.0),
    "model_damping": Unknown("model: damping, N m s/rad", 0.005, 0.5),
    "model_drag": Unknown("model: C_D", 0.5, 2.0),
}
"""The unknowns of the search, each with the range within which its logarithm is varied."""


class Compared(NamedTuple):
    """Result of a comparison.

    Attributes:
        cells: cells of table 3, %: links 2, 6, 12 and 20 with air, then without air.
        nearest: smallest absolute displacement of each link of the arm in the compared window, m.
        crossed: whether that displacement changes its sign in the window.
    """

    cells: Float[Array, " cell"]
    nearest: Float[Array, " link"]
    crossed: Array


def compared_arms(values: Float[Any, " unknown"]) -> Compared:
    """Return table 3 for one arm and one model, from the values of `UNKNOWNS` in their order, SI.

    The arm is the paper's with hysteretic joints. The model has no hysteresis, and is evaluated
    with its C_D and with C_D = 0. A term of the concordance has a pole where the arm's displacement
    crosses 0. The cells are therefore smooth functions of the parameters only between such
    crossings. A sample with a displacement of exactly 0 contributes no term and no derivative.
    Derivatives are in forward mode. Cells are NaN if a simulation fails.
    """
    known = dict(zip(UNKNOWNS, values, strict=True))
    paper = takeichi_20m()
    arm = replace(
        takeichi_20m(parameters=_REMEMBERING),
        {
            **_springs(known, ""),
            "joints.memory.strength": known["strength"],
            "joints.memory.yield_angle": known["yield"],
        },
    )
    model = replace(paper, _springs(known, "model_"))
    vacuum = replace(model, {"air.drag_coefficient": jnp.zeros_like(known["model_drag"])})
    bend = known["lasting"], known["back"]
    recorded = _heights(arm, _there_and_back(known["reach"] * known["angle"], *bend))
    command = _there_and_back(known["angle"], *bend)
    cells = [_concordance(_heights(each, command), recorded) for each in (model, vacuum)]
    size = jnp.abs(recorded)
    return Compared(
        100 * jnp.concatenate(cells),
        jnp.min(size, axis=0),
        jnp.min(recorded, axis=0) * jnp.max(recorded, axis=0) < 0,
    )


@program
def linearised(
    logarithms: Float[Array, " unknown"],
) -> tuple[Compared, Float[Array, "cell unknown"]]:
    """Return the comparison and the derivatives of its cells by the logarithms of `UNKNOWNS`."""

    def push(tangent: Array) -> tuple[Array, Array, Compared]:
        def cells(at: Array) -> tuple[Array, Compared]:
            out = compared_arms(jnp.exp(at))
            return out.cells, out

        _, slope, out = jax.jvp(cells, (logarithms,), (tangent,), has_aux=True)
        return slope, out.cells, out

    basis = jnp.eye(len(UNKNOWNS), dtype=logarithms.dtype)
    slopes, _, out = jax.vmap(push, out_axes=(1, None, None))(basis)
    return out, slopes


@program
def evaluated(logarithms: Float[Array, " unknown"]) -> Compared:
    """Return the comparison at the logarithms of `UNKNOWNS`."""
    return compared_arms(jnp.exp(logarithms))


def _springs(known: Mapping[str, Array], of: str) -> dict[str, Array]:
    paths = {
        "joints.pitch_stiffness": "stiffness",
        "joints.damping": "damping",
        "air.drag_coefficient": "drag",
    }
    return {path: known[of + name] for path, name in paths.items()}


def _there_and_back(angle: Array, lasting: Array, back: Array, joints: int = 20) -> Signal:
    """Return a command of the base joint to an angle and back, differentiable by its knots."""
    first = jnp.full_like(back, STARTS_AT)
    times = jnp.stack([first, first + lasting, back, back + lasting])
    base = jnp.zeros((4, joints), angle.dtype)
    values = base.at[1:3, 0].set(angle)
    slopes = base.at[0, 0].set(angle / lasting).at[2, 0].set(-angle / lasting)
    return Signal(times, values, slopes, jnp.full((4,), jnp.inf, angle.dtype))


def _heights(arm: Arm, command: Signal) -> Float[Array, "sample link"]:
    """Return the heights of the compared links at the compared times, m."""
    first, last = WINDOW
    rows = np.linspace(first, last, round((last - first) / STEP) + 1)
    tolerance = jnp.asarray(_TOLERANCE)
    motion = integrate(
        arm,
        command,
        jnp.asarray(np.concatenate([[0.0], rows])),
        None,
        None,
        jnp.zeros((2, arm.count)),
        (tolerance, tolerance),
        solver="springs5",
        max_steps=_MAX_STEPS,
        derivatives="forward",
        steps_for="derivatives",
    )
    return motion.link_centres[1:, np.asarray(LINKS) - 1, 2]


def _concordance(
    model: Float[Array, "sample link"], experiment: Float[Array, "sample link"]
) -> Float[Array, " link"]:
    """Return `concordance` of each link, differentiable; samples at exactly 0 have no term."""
    counts = experiment != 0
    size = jnp.abs(jnp.where(counts, experiment, 1))
    terms = jnp.where(counts, 1 - jnp.abs(model - experiment) / size, 0)
    return jnp.sum(terms, axis=0) / jnp.sum(counts, axis=0, dtype=terms.dtype)


_SHARED = ("stiffness", "damping", "drag")


@dataclasses.dataclass(frozen=True)
class Reading:
    """An assumption about the differences between the arm and the paper's model.

    Attributes:
        free: names of the `UNKNOWNS` that are estimated.
        shared: names of the unknowns that have the same value in the arm and in the model.
    """

    label: str
    free: tuple[str, ...]
    shared: tuple[str, ...] = ()

    def spread(self) -> np.ndarray:
        """Return the matrix from free logarithms to all logarithms, shape (unknown, free)."""
        names = list(UNKNOWNS)
        table = np.zeros((len(names), len(self.free)))
        for column, name in enumerate(self.free):
            table[names.index(name), column] = 1
            if name in self.shared:
                table[names.index(f"model_{name}"), column] = 1
        return table

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the logarithms of the ends of the free ranges, SI, each of shape (free,)."""
        free = [UNKNOWNS[name] for name in self.free]
        low = np.log([unknown.lower * unknown.unit for unknown in free])
        return low, np.log([unknown.upper * unknown.unit for unknown in free])

    def all(self, free: np.ndarray) -> Array:
        """Return all logarithms from the free ones; those neither free nor shared are 0."""
        return jnp.asarray(self.spread() @ free)


_APART = ("reach", *(f"model_{name}" for name in _SHARED))
READINGS = {
    "memory": Reading(
        "only the joint friction differs",
        tuple(name for name in UNKNOWNS if name not in _APART),
        shared=_SHARED,
    ),
    "own": Reading("all parameters may differ", tuple(UNKNOWNS)),
}
"""Two explanations of the errors in the paper: the explanation given in the paper, and one in which
any parameter may differ.
"""


SHOWN_LINKS = {6: GREEN, 12: BLUE, 20: VERMILLION}
STEP_DEG, STEP_AT = 30.0, 0.5
DURATION, RATE = 25.0, 20.0

AT = (5, 10, 25)  # Times of the values in the table, s.
TOLERANCE = 1e-8  # Tolerance of the integrator; each curve is then accurate to 1e-7 m.
_FIG05_SOURCES = Sources(
    printed="the model (20 rigid links, springs, eq. (1) at their centres), length, diameter and "
    "mass (table 2), and the three links. Solid lines are with air, dotted lines without air.",
    assumed=f"stiffness 3 (pitch) and 30 N m/rad (yaw), damping 0.05 N m s/rad, C_D = 1.2, a step "
    f"of {STEP_DEG:g}{DEGREE} at {STEP_AT:g} s: the text gives none of these values.",
    reconstructed="nothing.",
)


def heights(tolerance: float = TOLERANCE) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times, s, and the heights of all links, m, "with" and "without" air.

    The base joint is commanded a step.
    """
    arm = takeichi_20m()
    arms = {"with": arm, "without": replace(arm, {"air.drag_coefficient": 0.0})}
    command = joint_steps(arm.count, {1: np.deg2rad(STEP_DEG)}, time=STEP_AT)
    times = np.linspace(0.0, DURATION, round(DURATION * RATE) + 1)
    motions = {
        air: simulate(each, command, times, rtol=tolerance, atol=tolerance)
        for air, each in arms.items()
    }
    return times, {air: np.asarray(motion.link_centres[..., 2]) for air, motion in motions.items()}


_FIG05_CAPTION = (
    f"The base joint is commanded a step of {STEP_DEG:g}{DEGREE} at {STEP_AT:g} s. The curves are "
    "the heights z of the centres of link 6 (green circles), link 12 (blue squares) and link 20 "
    "(orange-red triangles) in m versus time. Markers are at some of the samples. Solid lines are "
    "simulated with drag. Dotted lines are simulated with a drag coefficient C_D of 0 and "
    "otherwise equal parameters."
)


def fig05() -> Reproduced:
    """Fig. 5, with a table of the curves with and without air."""
    times, z = heights()
    headings = ("link", *(f"z at {at} s {air} air, m" for at in AT for air in z))
    rows = []
    columns = {"time_s": times}
    at = [round(seconds * RATE) for seconds in AT]
    for link in SHOWN_LINKS:
        curves = {air: z[air][:, link - 1] for air in z}
        rows.append((link, *(float(curve[row]) for row in at for curve in curves.values())))
        columns |= {f"link{link:02d}_z_{air}_air_m": curves[air] for air in curves}
    title = "Fig. 5: links 6, 12 and 20 with (solid) and without (dotted) air"
    figure = new_figure(8, 4.8, title, _FIG05_CAPTION)
    axes = figure.subplots()
    solid_and_dotted(axes, times, (z["with"], z["without"]), SHOWN_LINKS, "link")
    plain(axes, "", "time (s)", "z of the link's centre (m)")
    axes.set_xlim(times[0], times[-1])
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="upper left")
    title = "Heights of links 6, 12 and 20 after a step of the base joint"
    return Reproduced(title, _FIG05_SOURCES, figure, headings, tuple(rows), columns)


def solid_and_dotted(
    panel: Axes,
    times: np.ndarray,
    both: Sequence[np.ndarray],
    colours: Mapping[int, str],
    what: str,
) -> None:
    """Plot three columns of two tables, each of shape (sample, number), versus time."""
    for (number, colour), mark in zip(colours.items(), "os^", strict=True):
        solid, dotted = (values[:, number - 1] for values in both)
        style: Any = {"color": colour, "marker": mark, "ms": 4, "markevery": 0.07}
        panel.plot(times, solid, linewidth=1.6, label=f"{what} {number}", **style)
        panel.plot(times, dotted, linewidth=1.2, linestyle=(0, (1, 1.5)), **style)


STYLES = {
    "with_air": (BLUE, "-"),
    "without_air": (VERMILLION, (0, (1, 1.5))),
    "own": (GREEN, (0, (5, 2))),
}

STAND_IN = (
    "the experiment, whose recordings are not public: rigid bodies simulated by MuJoCo, with drag "
    "along the links (C_D 1.1), added mass coefficient 1, a trim mass of 0.084 kg per link 0.15 m "
    "below the axis, stiffness 2.6 and 30 N m/rad, damping 0.04 N m s/rad, Dahl friction of 0.06 N "
    "m at 60 N m/rad in each joint, a crosswind of 0.05 m/s with gusts of up to 0.2 m/s, and a "
    "camera at 10 Hz with 20 mm of noise (data/paper)."
)

_FIG19_SOURCES = Sources(
    printed="the model (eq. (1) at the centres of the links, 0.047 kg each), the base joint that "
    "bends, the four links, and the time window that table 3 compares (grey).",
    assumed="the base joint bends to 30 deg within 1 s, starting at 0.5 s, and bends back starting "
    "at 12 s. Stiffness, damping and C_D are fitted. The giajax model has the structure, trim and "
    "added mass of the stand-in, and its friction is also fitted. The run is the first of twenty. "
    "Without air, links swing beyond the range of the panels.",
    reconstructed=STAND_IN,
)


_FIG19_CAPTION = (
    "Each panel shows the height z of the centre of one link in m versus time. Grey dots are the "
    "recorded run of the stand-in, a simulation by MuJoCo. The solid blue line is the paper's "
    "model, fitted to this run. The dotted orange-red line is the same model with a drag "
    "coefficient C_D of 0. The dashed green line is the giajax model, fitted to another run. Table "
    "3 compares the models in the light grey interval. Curves are cut off at the edges of a panel."
)


def fig19(fits: Fits) -> Reproduced:
    """Fig. 19 for the first run of the stand-in."""
    run = fits.runs[0]
    curves = {name: fits.predicted(name, run) for name in STYLES}
    times = times_of(run)
    figure = new_figure(
        10, 6.8, "Fig. 19: the models and a stand-in for the experiment", _FIG19_CAPTION
    )
    panels = figure.subplots(2, 2, sharex=True)
    rows = []
    columns = {"time_s": times}
    window = compared(times)
    for panel, link, channel in zip(panels.flat, LINKS, HEIGHTS, strict=True):
        _draw(panel, run, channel, {name: curves[name][channel] for name in curves})
        plain(panel, f"link {link}: z (m)")
        recorded = run.values[channel]
        columns[f"{channel}_recorded_m"] = recorded
        row: list[object] = [link]
        for name in curves:
            model = curves[name][channel]
            columns[f"{channel}_{name}_m"] = model
            both = model[window], recorded[window]
            row += [f"{100 * of(*both):.0f}" for of in (concordance, relative_error)]
        rows.append(tuple(row))
    for panel in panels[1]:
        panel.set_xlabel("time (s)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, fontsize=8, frameon=False)
    headings = ["link"]
    for name in curves:
        headings += [f"{CONTENDERS[name].label}: concordance, %", "RMS error, %"]
    title = "Fig. 19: the same operation in the models and in a stand-in for the experiment"
    table = tuple(headings), tuple(rows), columns
    return Reproduced(title, _FIG19_SOURCES, figure, *table, {"fits": fits.record()})


def _draw(panel: Axes, run: Run, channel: str, curves: dict[str, np.ndarray]) -> None:
    times, recorded = times_of(run), run.values[channel]
    panel.axvspan(*WINDOW, color=LIGHT, linewidth=0, zorder=0, alpha=0.6)
    dots: Any = {"marker": ".", "markersize": 2.5, "linewidth": 0, "label": "stand-in"}
    panel.plot(times, recorded, color=GREY, **dots)
    for name, curve in curves.items():
        colour, dashes = STYLES[name]
        line: Any = {"linestyle": dashes, "linewidth": 1.4, "label": CONTENDERS[name].label}
        panel.plot(times, curve, color=colour, **line)
    # A link without air moves far beyond the range of the others.
    shown = np.concatenate([recorded, curves["with_air"], curves["own"]])
    low, high = float(np.min(shown)), float(np.max(shown))
    margin = 0.25 * (high - low)
    panel.set_ylim(low - margin, high + margin)
    panel.axhline(0, color=INK, linewidth=0.6)
    panel.set_xlim(0, WINDOW[1])


PRINTED = {"with_air": (77, 94, 51, 62, 71), "without_air": (78, 32, -99, -190, -45)}
"""The values of the paper's table 3, %: links 2, 6, 12 and 20, and their average."""

MARKS = {
    "with_air": (BLUE, "o"),
    "without_air": (VERMILLION, "s"),
    "refitted": (GREY, "^"),
    "own": (GREEN, "v"),
}
"""A colour for each model, and a marker that distinguishes the models in greyscale."""

_TABLE3_SOURCES = Sources(
    printed="the definition of the concordance (mean of 1 - |Xm - Xe| / |Xe| every 0.1 s from 10 "
    "to 25 s), the links, and the numbers of the first two rows.",
    assumed="that the displacement is z, and that the paper's model was fitted to the same run "
    "with which it is compared. Samples with Xe exactly 0 are omitted. The giajax model has the "
    "structure, trim and added mass of the stand-in. Its C_D, stiffness, damping and friction are "
    "fitted to another run, in at most twelve iterations.",
    reconstructed=STAND_IN,
)

_PLACES = (*(f"link {link}" for link in LINKS), "average")


def table3(fits: Fits) -> Reproduced:
    """Table 3 for all runs of the stand-in, together with the values printed in the paper."""
    rates = {name: np.empty((len(fits.runs), len(LINKS))) for name in CONTENDERS}
    errors = {name: np.empty_like(rates[name]) for name in CONTENDERS}
    for number, run in enumerate(fits.runs):
        rows = compared(times_of(run))
        for name in CONTENDERS:
            predicted = fits.predicted(name, run)
            for place, channel in enumerate(HEIGHTS):
                both = predicted[channel][rows], run.values[channel][rows]
                rates[name][number, place] = concordance(*both)
                errors[name][number, place] = relative_error(*both)
    cells = [
        (run.name, name, link, rates[name][number, place], errors[name][number, place])
        for name in CONTENDERS
        for number, run in enumerate(fits.runs)
        for place, link in enumerate(LINKS)
    ]
    return Reproduced(
        "Table 3: concordance of the models with a stand-in for the experiment (by MuJoCo)",
        _TABLE3_SOURCES,
        _table3_drawn(rates, errors),
        ("model", "measure, %", *_PLACES),
        _rows(rates, errors),
        columns_of(("run", "model", "link", "concordance", "rms_error"), cells),
        {"fits": fits.record()},
    )


def with_average(values: np.ndarray) -> np.ndarray:
    """Append the average over the links, shape (run, link + 1)."""
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def _rows(
    rates: dict[str, np.ndarray], errors: dict[str, np.ndarray]
) -> tuple[tuple[str, ...], ...]:
    """Return the paper's rows, then the median and range over the runs."""
    words = {"with_air": "with air", "without_air": "without air"}
    rows = [
        (f"the paper, {words[name]}", "concordance", *map(str, numbers))
        for name, numbers in PRINTED.items()
    ]
    for measure, values in (("concordance", rates), ("RMS error", errors)):
        for name, contender in CONTENDERS.items():
            percent = 100 * with_average(values[name]).T
            cells = (f"{np.median(of):.0f} ({of.min():.0f} .. {of.max():.0f})" for of in percent)
            rows.append((contender.label, measure, *cells))
    return tuple(rows)


_TABLE3_CAPTION = (
    "Left: mean of |model - recorded| / |recorded|, which is 100 % minus the concordance. Right: "
    "root mean square (RMS) of the error relative to that of the recorded displacement. Both are "
    "computed from the heights of a link from 10 to 25 s. Each small marker is one run, and a "
    "black bar is the median of the runs. Large open markers are the values that the paper prints. "
    "Colour and shape of the markers denote the model (see the legend). The average is over the "
    "four links. The ordinates are logarithmic."
)


def _table3_drawn(rates: dict[str, np.ndarray], errors: dict[str, np.ndarray]) -> Figure:
    """Draw both measures as errors, so that one logarithmic scale shows 1 % and 3000 %.

    A concordance can be far below 0. It equals 100 % minus a mean relative error, which is never
    negative.
    """
    title = f"Table 3: {len(rates['own'])} runs of a stand-in simulated by MuJoCo"
    figure = new_figure(11, 5.4, title, _TABLE3_CAPTION)
    left, right = figure.subplots(1, 2, sharey=True)
    _dots(left, {name: 1 - each for name, each in rates.items()})
    for name, numbers in PRINTED.items():
        colour, mark = MARKS[name]
        hollow: Any = {"marker": mark, "markersize": 9, "markerfacecolor": "none"}
        label = f"{CONTENDERS[name].label}: printed in the paper"
        at = np.arange(len(_PLACES)) + _offset(name)
        values = 100 - np.asarray(numbers)
        left.plot(at, values, color=colour, linewidth=0, markeredgewidth=1.6, label=label, **hollow)
    _dots(right, errors)
    left.set_yscale("log")
    left.yaxis.set_major_formatter("{x:g}")
    plain(
        left, "The paper's measure (concordance = 100 % - this error)", up="mean relative error (%)"
    )
    plain(right, "RMS error", up="RMS error over RMS displacement (%)")
    right.tick_params(labelleft=True)
    for panel in (left, right):
        panel.grid(False, axis="x")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    return figure


def _offset(name: str) -> float:
    return 0.18 * (list(CONTENDERS).index(name) - (len(CONTENDERS) - 1) / 2)


def _dots(panel: Axes, values: dict[str, np.ndarray]) -> None:
    """Draw a marker for each run and a bar at the median."""
    for name, each in values.items():
        percent = 100 * with_average(each)
        for place, column in enumerate(percent.T):
            at, (colour, mark) = place + _offset(name), MARKS[name]
            marks: Any = {"marker": mark, "markersize": 4, "markeredgewidth": 0, "linewidth": 0}
            label = CONTENDERS[name].label if place == 0 else None
            panel.plot(
                np.full(len(column), at), column, color=colour, alpha=0.6, label=label, **marks
            )
            bar = [at - 0.08, at + 0.08], [np.median(column)] * 2
            label = "median" if (name, place) == ("own", 0) else None
            panel.plot(*bar, color=INK, linewidth=1.2, zorder=5, label=label)
    panel.set_xticks(range(len(_PLACES)), _PLACES)
