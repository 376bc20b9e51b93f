"""Input shaping: commands that reduce the residual swing of an arm.

A command is convolved with a few impulses, so that each of them cancels the swing that the previous
ones have excited. The impulses follow from period and damping of a mode at the final pose of the
command. The air damps a long and light arm with the square of the velocity. The relevant damping is
therefore that of a swing as large as the command excites, from harmonic balance. Swing and damping
change while the arm moves. Period and damping of the mode that is excited most are therefore tuned
near these values, with simulations of the arm.

- ZV, ZVD: Singer and Seering, Preshaping command inputs to reduce system vibration, J. Dyn. Syst.
  Meas. Control 112 (1990) 76. The residual swing is zero if period and damping are correct. ZVD has
  a smaller residual swing if they are wrong.
- EI: Singhose, Seering and Singer, Residual vibration reduction using vector diagrams to generate
  shaped inputs, J. Mech. Design 116 (1994) 654. A small residual swing is accepted if they are
  correct, in exchange for a smaller one if they are wrong.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import root

from ..fitting import FitResult, arm_model_of
from ..mechanics.arm import Arm, acceleration, tip_position
from ..models import AbstractModel
from ..report import BLUE, GREEN, GREY, VERMILLION, new_figure, plain
from ..runtime.arrays import Array, Float
from ..runtime.parallel import Batch, run_on_all_cores, stacked_items
from ..runtime.programs import program
from ..runtime.text import InputError
from ._moves import (
    DIGITS,
    SETTLING,
    UNTIL,
    WRONG,
    Command as Command,
    Flight,
    arms_left_open,
    found_rest,
    reached,
    resting,
    settled_at,
    settling_times,
    softer,
)


class Impulses(NamedTuple):
    """Impulses with which a command is convolved.

    Attributes:
        times: times of the impulses, s, increasing from 0, shape (impulse,).
        sizes: sizes of the impulses, which add up to 1, shape (impulse,).
    """

    times: Float[np.ndarray, " impulse"]
    sizes: Float[np.ndarray, " impulse"]

    def after(self, other: "Impulses") -> "Impulses":
        """Return the convolution of both."""
        times = (self.times[:, None] + other.times).ravel()
        together, place = np.unique(times.round(DIGITS), return_inverse=True)
        sizes = (self.sizes[:, None] * other.sizes).ravel()
        return Impulses(together, np.bincount(place.ravel(), sizes))

    def left(self, period: float, damping: float) -> float:
        """Return the residual swing of a mode, relative to the swing after a single impulse."""
        rate = _eigenvalue(period, damping)
        return float(abs(np.sum(self.sizes * np.exp(rate * (self.times[-1] - self.times)))))


NONE = Impulses(np.zeros(1), np.ones(1))


def _eigenvalue(period: float, damping: float) -> complex:
    """Return the eigenvalue of a mode, 1/s; `period` is the undamped period, s."""
    frequency = 2 * np.pi / period
    return complex(-damping * frequency, frequency * np.sqrt(1 - damping**2))


def zero_vibration(period: float, damping: float) -> Impulses:
    """Return the ZV shaper: two impulses, half a period apart.

    Arguments:
        period: undamped period of the mode, s.
        damping: damping ratio, below 1.

    Example:
        >>> from giajax.apps.shaping import zero_vibration
        >>> impulses = zero_vibration(80.0, 0.1)
        >>> impulses.times.round(2).tolist(), impulses.sizes.round(3).tolist()
        ([0.0, 40.2], [0.578, 0.422])
    """
    rate = _eigenvalue(period, damping)
    half = np.pi / rate.imag
    left = np.exp(rate.real * half)
    return Impulses(np.array([0, half]), np.array([1, left]) / (1 + left))


def zero_vibration_and_derivative(period: float, damping: float) -> Impulses:
    """Return the ZVD shaper, with the same arguments as `zero_vibration`.

    The residual swing and its derivative with respect to the period are 0.
    """
    once = zero_vibration(period, damping)
    return once.after(once)


INSENSITIVITY = 0.05
"""Residual swing of the EI shaper at the correct period and damping, as a fraction of the unshaped
swing.
"""

_MOST_DAMPED = 0.8  # The later impulses are negligible above this damping ratio.
_MOST_DAMPED_EI = 0.55  # No EI shaper of three impulses exists above this damping ratio.


def extra_insensitive(period: float, damping: float) -> Impulses:
    """Return the EI shaper, with the same arguments as `zero_vibration`.

    Its residual swing is 5 % at the given period, and zero at a shorter and a longer one.

    Raises:
        InputError: a damping ratio above 0.55, for which no such impulses exist.
    """
    if not damping <= _MOST_DAMPED_EI:
        raise InputError(
            f"the damping ratio is {damping:g}, but EI shapers exist only for ratios up to "
            f"{_MOST_DAMPED_EI}: use another shaper"
        )
    shape = _extra_insensitive(round(damping, 6))
    return Impulses(shape.times * period, shape.sizes)


@functools.lru_cache(maxsize=256)
def _extra_insensitive(damping: float) -> Impulses:
    """Return the impulses for a period of 1, by continuation from the undamped solution."""
    kept = INSENSITIVITY
    width = np.arccos((1 - kept) / (1 + kept)) / np.pi
    found = np.array([(1 + kept) / 4, (1 + kept) / 4, 0.5, 1 - width, 1 + width])
    for each in np.linspace(0, damping, 1 + int(np.ceil(damping / 0.05))):

        def impulses(numbers: np.ndarray, each: float = each) -> Impulses:
            first, last, middle = numbers[:3]
            whole = 1 / np.sqrt(1 - each**2)
            sizes = np.array([first, 1 - first - last, last])
            return Impulses(np.array([0, middle, 1]) * whole, sizes)

        def off(numbers: np.ndarray, each: float = each) -> list[float]:
            """Return the residuals: swings of a slower and a faster mode, and the accepted one."""
            shape = impulses(numbers)
            swings = []
            for faster in numbers[3:]:
                rate = _eigenvalue(1 / faster, each)
                swings.append(np.sum(shape.sizes * np.exp(-rate * shape.times)))
            here = shape.left(1.0, each) - kept
            return [part for one in swings for part in (one.real, one.imag)] + [here]

        solved = root(off, found)
        if not solved.success:
            raise InputError(
                f"no EI impulses were found for a damping ratio of {damping:g}: use another shaper"
            )
        found = solved.x
    return impulses(found)


class Shaper(NamedTuple):
    """A method that determines impulses.

    Attributes:
        impulses: function of a period (s) and a damping ratio.
        robust: whether the residual swing is designed to be small if these are wrong.
        most_damped: largest valid damping ratio.
    """

    impulses: Callable[[float, float], Impulses]
    robust: bool
    most_damped: float

    def allowed(self, damping: float) -> float:
        """Return the nearest valid damping ratio."""
        return float(np.clip(damping, 0.0, self.most_damped))


SHAPERS = {
    "ZV": Shaper(zero_vibration, False, _MOST_DAMPED),
    "ZVD": Shaper(zero_vibration_and_derivative, True, _MOST_DAMPED),
    "EI": Shaper(extra_insensitive, True, _MOST_DAMPED_EI),
}


@dataclasses.dataclass(frozen=True)
class Mode:
    """A mode of an arm about the final pose of a command.

    Attributes:
        period: undamped period, s.
        damping: damping ratio of a swing half as large as the command excites.
        swing: swing of the tip after the unshaped command without air, m.
    """

    period: float
    damping: float
    swing: float


@program
def _dissipated(arm: Arm, moved: tuple[Array, Array], command: Array, mass: Array) -> Array:
    """Return the power that an arm dissipates at rows of angles and rates, W."""

    def at(angles: Array, rates: Array) -> Array:
        pulled = acceleration(arm, angles, rates, command)
        return -rates @ mass @ (pulled - acceleration(arm, angles, jnp.zeros_like(rates), command))

    return jax.vmap(at)(*moved)


_PHASES = (np.arange(64) + 0.5) * 2 * np.pi / 64


def modes_after(arm: Arm, command: Command) -> list[Mode]:
    """Return the modes of an arm at the end of a command, sorted by decreasing excitation.

    Raises:
        InputError: the arm has no stable rest pose there.
    """
    last = jnp.asarray(command.angles[-1], dtype=jnp.result_type(float))
    about = found_rest(arm, command.angles[-1])
    held = reached(arm, last)
    frequencies, shapes = about.modes()
    # Static deflection of each mode per unit of the command.
    static = -shapes.T @ about.mass @ np.linalg.solve(about.by_angles, about.by_command)
    reach = np.linalg.norm(about.moves @ shapes, axis=0)
    late = arm.joints.drive_lag
    lag = 0.0 if late is None else float(np.mean(np.asarray(late)))
    found = []
    for frequency, shape, gain, far in zip(frequencies, shapes.T, static, reach, strict=True):
        # A drive with a lag transmits less of the fast part of a command.
        size = _excited(command, gain, frequency) / np.hypot(1, frequency * lag)
        damping = _damping(arm, about, held, frequency, shape, max(size / 2, 1e-3 / far))
        found.append(Mode(float(2 * np.pi / frequency), damping, float(size * far)))
    return sorted(found, key=lambda mode: -mode.swing)


def _excited(command: Command, gain: np.ndarray, frequency: float) -> float:
    """Return the largest amplitude of an undamped mode after a command, over nearby frequencies.

    A command whose duration is a whole number of periods may leave no swing at exactly one
    frequency.
    """
    driven = command.angles @ gain
    sizes = []
    for near in frequency * np.linspace(1 - WRONG, 1 + WRONG, 11):
        late = np.exp(-1j * near * command.times)
        if command.held:
            sizes.append(abs(np.sum(np.diff(driven) * late[1:])))
        else:
            slopes = np.diff(driven) / np.diff(command.times)
            sizes.append(abs(np.sum(slopes * np.diff(late))) / near)
    return float(max(sizes))


def _damping(
    arm: Arm, about: Any, command: Array, frequency: float, shape: np.ndarray, size: float
) -> float:
    """Return the damping ratio of a mode with some amplitude, from the energy loss per period."""
    angles = about.angles + size * np.sin(_PHASES)[:, None] * shape
    rates = size * frequency * np.cos(_PHASES)[:, None] * shape
    moved = jnp.asarray(angles), jnp.asarray(rates)
    power = np.asarray(_dissipated(arm, moved, command, jnp.asarray(about.mass)))
    return float(np.mean(power) / (frequency * (size * frequency) ** 2))


_TUNING, _FINAL = 1e-4, 1e-5  # Tolerances for accuracies of about 1 mm and 0.1 mm.


@program
def _moved(flights: Flight) -> tuple[Array, Array]:
    """Return the distance of the tip from its rest position, m, and whether it was simulated."""
    return jax.lax.map(_moved_one, flights)


def _moved_one(flight: Flight) -> tuple[Array, Array]:
    flown = flight.flown(SETTLING // 3)
    return jnp.linalg.norm(flown.tips - flown.rest[None], axis=1), flown.successful


@dataclasses.dataclass(frozen=True)
class Shaped:
    """A shaped command and its residual swing.

    Attributes:
        name: name of the shaper, or "unshaped" for the original command.
        command: commanded angles versus time.
        impulses: impulses with which the original command was convolved.
        longer: increase of the duration, s.
        tuned: period (s) and damping ratio of the most excited mode for which the shaper was made;
            None without a shaper.
        settled: time from which the tip stays within 2 % of the travel from its rest position, s;
            None if that is not within three periods after the command.
        residual: largest distance of the tip from its rest position after the command, m.
        soft, stiff: residual with a stiffness a quarter lower and higher, m.
        drawn: residual of each draw of the uncertain parameters of the fit, m; empty without a fit.
        times: sample times, s, shape (sample,).
        distance: distance of the tip from its rest position, m, shape (sample,).
        distances: distance for each draw, m, shape (draw, sample).
    """

    name: str
    command: Command
    impulses: Impulses
    longer: float
    tuned: tuple[float, float] | None
    settled: float | None
    residual: float
    soft: float
    stiff: float
    drawn: Float[np.ndarray, " draw"]
    times: Float[np.ndarray, " sample"]
    distance: Float[np.ndarray, " sample"]
    distances: Float[np.ndarray, "draw sample"]


@dataclasses.dataclass(frozen=True)
class Shaping:
    """An unshaped command and its shaped versions; made by `shape_command`.

    Attributes:
        rows: the original command, then one entry per shaper.
        modes: modes for which the command was shaped, the most excited one first.
        travel: largest distance of the tip, at rest, from its final position, m.
        notes: sentences on limitations of the result.
    """

    rows: tuple[Shaped, ...]
    modes: tuple[Mode, ...]
    travel: float
    notes: tuple[str, ...] = ()


_NEAR = 0.02  # Fraction of the travel within which the arm counts as at rest.
_WORTH = 0.01  # Fraction of the travel below which the swing of a mode is ignored.
_MOST_MODES = 3
# Weight of the residual with a wrong stiffness: 5 % then count like 2 % without an error.
_LET = 0.4
# Initial grid: periods relative to that of the mode, and damping ratios. Creep takes longer than a
# period. Then the step sizes of the refinements about the best point, for period and damping.
_PERIODS, _DAMPINGS = (1.0, 1.4), (0.0, 0.1, 0.25, 0.4, 0.6, 0.8)
_CLOSER = ((0.12, 0.08), (0.05, 0.04))


def shape_command(
    model: AbstractModel | FitResult,
    command: Command,
    *,
    shapers: Sequence[str] = (*SHAPERS,),
    tuned: bool = True,
    draw_count: int = 20,
    progress: Callable[[str], None] | None = None,
) -> Shaping:
    """Shape a command to reduce the residual swing of an arm in still air.

    Arguments:
        model: the arm, or a fit of it. With a fit, draws of its uncertain parameters are evaluated.
        command: command of all joints of the arm.
        shapers: names of shapers, keys of `SHAPERS`.
        tuned: whether period and damping of the most excited mode are tuned with simulations.
        draw_count: number of draws of the uncertain parameters of the fit.
        progress: called with a line of text from time to time.

    Raises:
        InputError: a command that does not move the arm or has other joints, an unknown shaper, or
            an arm without a stable rest pose at the end of the command.

    Example:
        >>> import giajax, numpy as np
        >>> from giajax.apps.shaping import Command, shape_command
        >>> angles = np.deg2rad([[0.0, 0.0], [10.0, 0.0]])
        >>> model = giajax.ArmModel(giajax.takeichi_20m_full(2))
        >>> found = shape_command(model, Command(np.array([0.0, 4.0]), angles), shapers=["ZV"])
        >>> [row.name for row in found.rows]
        ['unshaped', 'ZV']
    """
    shapers = tuple(dict.fromkeys(shapers))
    for name in shapers:
        if name not in SHAPERS:
            raise InputError(f"the shaper {name!r} is unknown: use one of {', '.join(SHAPERS)}")
    result = model if isinstance(model, FitResult) else None
    stated = arm_model_of(model)
    arm = stated.arm
    if command.angles.shape[1] != arm.count:
        raise InputError(
            f"the command has angles of {command.angles.shape[1]} joints, but the arm has "
            f"{arm.count}: give angles for each joint of the arm"
        )
    if arm.pneumatics is not None:
        raise InputError(
            "the arm has muscles, whose stiffness depends on pressure and which may hold "
            "a joint at several angles: use an arm with springs"
        )
    tips = np.asarray(_rest_tips(arm, jnp.asarray(command.angles, dtype=jnp.result_type(float))))
    travel = float(np.max(np.linalg.norm(tips - tips[-1], axis=1)))
    if not travel > 1e-6:
        raise InputError("the command does not move the tip: give a command that moves it")
    modes = modes_after(arm, command)
    worth = _chosen(modes, travel)
    wrong = [softer(stated, 1 - WRONG).arm, softer(stated, 1 + WRONG).arm]
    drawn = arms_left_open(stated, result, draw_count)
    study = _Study(command, modes[0], worth[1:], [arm, *wrong], drawn, travel)
    rows = [study.row("unshaped", None)]
    notes = []
    for name in shapers:
        if progress is not None:
            progress(f"shaper {name} ...")
        rows.append(study.row(name, study.tuned(name) if tuned else study.usual(name)))
    if modes[0].damping > _MOST_DAMPED:
        notes.append(
            "a swing of this amplitude is overdamped by the air: the arm comes to rest without "
            "oscillating"
        )
    if lost := len(drawn) - min(len(row.drawn) for row in rows):
        notes.append(f"the motion could not be simulated with {lost} of {len(drawn)} draws")
    soonest, *others = [np.inf if row.settled is None else row.settled for row in rows]
    if soonest <= min(others, default=np.inf) and np.isfinite(soonest):
        notes.append("no shaped command brings the tip to rest sooner than the original command")
    return Shaping(tuple(rows), tuple(worth), travel, tuple(notes))


@program
def _rest_tips(arm: Arm, commanded: Array) -> Array:
    """Return the rest position of the tip for each row of commanded angles, m."""

    def at(row: Array) -> Array:
        return tip_position(arm, resting(arm, reached(arm, row))[0])

    return jax.lax.map(at, commanded)


def _chosen(modes: Sequence[Mode], travel: float) -> list[Mode]:
    """Return the first mode, and the modes whose swing its shaper would leave."""
    first = modes[0]
    before = zero_vibration(first.period, min(first.damping, _MOST_DAMPED))
    left = [mode for mode in modes[1:] if mode.swing > _WORTH * travel]
    more = [m for m in left if m.swing * before.left(m.period, 0.0) > _WORTH * travel]
    return [first, *more[: _MOST_MODES - 1]]


@dataclasses.dataclass(frozen=True)
class _Study:
    """A command and the arms whose residual swing it must reduce; the first arm is nominal."""

    command: Command
    mode: Mode
    further: Sequence[Mode]
    arms: Sequence[Arm]
    drawn: Sequence[Arm]
    travel: float

    def impulses(self, name: str, numbers: tuple[float, float]) -> Impulses:
        """Return the impulses for the first mode, with given period and damping, and the others."""
        shaper = SHAPERS[name]
        found = shaper.impulses(*numbers)
        for mode in self.further:
            found = found.after(shaper.impulses(mode.period, shaper.allowed(mode.damping)))
        return found

    def usual(self, name: str) -> tuple[float, float]:
        """Return period and damping of the mode without tuning."""
        return self.mode.period, SHAPERS[name].allowed(self.mode.damping)

    def tuned(self, name: str) -> tuple[float, float]:
        """Return period and damping with the smallest residual, wrong stiffnesses included."""
        shaper, (period, damping) = SHAPERS[name], self.usual(name)
        arms = self.arms if shaper.robust else self.arms[:1]
        tried = [
            (period * longer, shaper.allowed(each))
            for longer in _PERIODS
            for each in (*_DAMPINGS, damping)
        ]
        known: dict[tuple[float, float], float] = {}
        for by_period, by_damping in (*_CLOSER, (0.0, 0.0)):
            new = [each for each in dict.fromkeys(tried) if each not in known]
            commands = [self.command.shaped(self.impulses(name, each)) for each in new]
            left, _, _ = self._moved(commands, arms, _TUNING)
            worst = np.max(left * ([1.0] + [_LET] * (len(arms) - 1)), axis=1)
            known |= dict(zip(new, worst.tolist(), strict=True))
            period, damping = min(known, key=lambda each: known[each])
            tried = [
                (period * (1 + by * by_period), shaper.allowed(damping + other * by_damping))
                for by in (-1, 0, 1)
                for other in (-1, 0, 1)
            ]
        return period, damping

    def row(self, name: str, numbers: tuple[float, float] | None) -> Shaped:
        """Return the result of a shaper for all arms."""
        impulses = NONE if numbers is None else self.impulses(name, numbers)
        shaped = self.command.shaped(impulses)
        left, times, distances = self._moved([shaped], [*self.arms, *self.drawn], _FINAL)
        count = len(self.arms)
        if not np.all(np.isfinite(left[0, :count])):
            raise InputError(
                "the motion of the arm cannot be simulated with the given stiffness or with a "
                "stiffness changed by a quarter: give a command that the arm can follow"
            )
        sound = np.flatnonzero(np.isfinite(left[0]))[count:]
        return Shaped(
            name=name,
            command=shaped,
            impulses=impulses,
            longer=float(impulses.times[-1]),
            tuned=numbers,
            settled=settled_at(times[0], distances[0, 0], _NEAR * self.travel),
            residual=float(left[0, 0]),
            soft=float(left[0, 1]),
            stiff=float(left[0, 2]),
            drawn=left[0, sound],
            times=times[0],
            distance=distances[0, 0],
            distances=distances[0, sound],
        )

    def _moved(
        self, commands: Sequence[Command], arms: Sequence[Arm], tolerance: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Simulate each command with each arm.

        Returns the residuals (m), the sample times (s), and the distances versus time (m).
        """
        longest = 3 * max(mode.period for mode in (self.mode, *self.further))
        times = np.stack([settling_times(each.times[-1], longest) for each in commands])
        cases = [
            Flight(arm, each.signal(self.rows), jnp.asarray(row), jnp.asarray(tolerance))
            for each, row in zip(commands, times, strict=True)
            for arm in arms
        ]
        # One case per item: the same compiled program then serves any number of cases.
        batch = Batch(_moved, stacked_items(cases), (), np.ones(len(cases)), 1)
        distances, successful = run_on_all_cores([batch])[0]
        distances = np.where(successful[:, None], distances, np.inf)
        distances = distances.reshape(len(commands), len(arms), -1)
        return np.max(distances[..., UNTIL:], axis=-1), times, distances

    @functools.cached_property
    def rows(self) -> int:
        """Largest number of rows of a shaped command."""
        return len(self.command.times) * 3 ** (1 + len(self.further))


SHAPING_HEADINGS = (
    "shaper",
    "command ends, s",
    "tip at rest, s",
    "residual, % of travel",
    "residual, stiffness -25 %",
    "residual, stiffness +25 %",
    "residual, 95 % of draws",
)


def shaping_rows(found: Shaping) -> list[tuple[Any, ...]]:
    """Return a row per command, with columns `SHAPING_HEADINGS`; None without draws."""

    def share(size: float) -> float:
        return 100 * size / found.travel

    return [
        (
            row.name,
            float(row.command.times[-1]),
            row.settled,
            share(row.residual),
            share(row.soft),
            share(row.stiff),
            share(float(np.percentile(row.drawn, 95))) if len(row.drawn) else None,
        )
        for row in found.rows
    ]


def shaping_facts(found: Shaping) -> dict[str, Any]:
    """Return the result as plain data."""
    modes = [
        {"period_s": mode.period, "damping": mode.damping, "swing_m": mode.swing}
        for mode in found.modes
    ]
    rows = [
        {
            "shaper": row.name,
            "longer_s": row.longer,
            "settled_s": row.settled,
            "period_s": None if row.tuned is None else row.tuned[0],
            "damping": None if row.tuned is None else row.tuned[1],
            "impulses": {
                "time_s": row.impulses.times.tolist(),
                "size": row.impulses.sizes.tolist(),
            },
            "residual_m": row.residual,
            "residual_soft_m": row.soft,
            "residual_stiff_m": row.stiff,
            "residual_drawn_m": row.drawn.tolist(),
        }
        for row in found.rows
    ]
    return {"travel_m": found.travel, "modes": modes, "commands": rows, "notes": list(found.notes)}


_STYLES = ((GREY, "-"), (BLUE, "--"), (VERMILLION, "-."), (GREEN, ":"))

_CAPTION = (
    "Top: command of the joint with the largest motion. ZV (zero vibration), ZVD (zero vibration "
    "and derivative) and EI (extra insensitive) are shapers, which convolve the original command "
    "with impulses. Bottom: simulated distance of the tip in still air from the position in which "
    "it finally rests, in the same line styles. Dots: ends of the commands. Horizontal line: "
    f"{100 * _NEAR:g} % of the travel of the tip."
)
_BANDS = " Bands: central 95 % of distances for parameters drawn from the uncertainty of the fit."


def shaping_figure(found: Shaping, title: str = "") -> Figure:
    """Plot the commands, and the distance of the tip from its rest position versus time."""
    caption = _CAPTION + (_BANDS if any(len(row.distances) for row in found.rows) else "")
    figure = new_figure(9, 6.4, title or "The command, unshaped and shaped", caption)
    above, below = figure.subplots(2, 1, sharex=True)
    moved = np.ptp(found.rows[0].command.angles, axis=0)
    joint = int(np.argmax(moved))
    for row, (colour, dashes) in zip(found.rows, itertools.cycle(_STYLES), strict=False):
        angles = np.degrees(row.command.at(row.times)[:, joint])
        above.plot(row.times, angles, color=colour, ls=dashes, label=row.name)
        if len(row.distances):
            low, high = np.percentile(row.distances, (2.5, 97.5), axis=0)
            below.fill_between(row.times, low, high, color=colour, alpha=0.2, lw=0)
        below.plot(row.times, row.distance, color=colour, ls=dashes, label=row.name)
        below.plot(row.times[UNTIL], row.distance[UNTIL], "o", color=colour, ms=5)
    below.axhline(_NEAR * found.travel, color=GREY, lw=0.8)
    plain(above, "", "", f"command of joint {joint + 1} (deg)")
    plain(below, "", "time (s)", "distance of the tip\nfrom its final position (m)")
    below.set_ylim(0, None)
    above.legend(fontsize=9, frameon=False)
    return figure
