"""Unrolling of an arm by hand or by gas, and its filling: simulation, table and figure."""

import dataclasses
import json
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import optimistix
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..mechanics.inflation import STRENGTHS, BagState, bag_state, inflow
from ..mechanics.unrolling import (
    Forces,
    Unrolling,
    bending_energy,
    open_volume,
    roll_forces,
    roll_radius,
    rolling_mass,
    weight_energy,
)
from ..report import (
    BLUE,
    GREEN,
    GREY,
    INK,
    PURPLE,
    VERMILLION,
    new_figure,
    plain,
    to_csv,
    to_png,
)
from ..runtime.arrays import Array, Bool, Float, Int, Scalar, larger
from ..runtime.programs import program
from ..runtime.records import plain_data
from ..runtime.text import InputError
from ..schema import FILM, HAND, ROLL
from ..schema.parameters import check_within_bounds, declared, get
from .filling import LIMIT, Filled, check_filling, crossings, fill, filling_files

_MOST_STEPS = 50_000
_ROWS = 401


class Works(NamedTuple):
    """Work on the roll by the gas and by a hand, and energy taken by peeling and losses, J."""

    gas: Scalar
    hand: Scalar
    peel: Scalar
    loss: Scalar


class RollState(NamedTuple):
    """State: length that is paid out, m, speed of the roll, m/s, gas, and works.

    The mass of gas is divided by the mass that fills the whole arm at ambient pressure.
    """

    paid_out: Scalar
    speed: Scalar
    share: Scalar
    works: Works


class _Course(NamedTuple):
    """States at integrator steps up to the end (s); times of events that never occurred are NaN."""

    times: Float[Array, " time"]
    state: RollState
    lifts: Float[Array, " link"]
    lifts_all: Scalar
    finished: Bool[Array, ""]
    succeeded: Bool[Array, ""]
    steps: Int[Array, ""]


def roll_rates(time: Any, state: RollState, unrolling: Unrolling) -> RollState:
    """Return d/dt of the state, with d/dt (M v) - M' v^2 / 2 = forces, and the powers of forces."""
    del time
    x, speed = state.paid_out, state.speed
    pressure = _tube(unrolling, state).pressure
    forces = roll_forces(unrolling, x, speed, pressure)
    hand = _hand_force(unrolling, forces)
    pushed = sum(forces, hand)
    held = not unrolling.by_gas and unrolling.hand.kind == "speed"
    works = Works(forces.gas * speed, hand * speed, -forces.peel * speed, -forces.loss * speed)
    return RollState(
        speed,
        jnp.zeros_like(speed) if held else pushed / rolling_mass(unrolling, x),
        _flow(unrolling, state, pressure) / jnp.sum(unrolling.filling.full_mass),
        works,
    )


def _tube(unrolling: Unrolling, state: RollState) -> BagState:
    """Return pressure and fullness of the part that is paid out, which is one bag."""
    filling = unrolling.filling
    # A trial step of the integrator may wind the roll up beyond its start.
    paid_out = larger(state.paid_out, unrolling.roll.start / 2)
    part = jnp.sum(open_volume(unrolling, paid_out)) / jnp.sum(filling.volume)
    return bag_state(filling.gas, filling.skin, unrolling.stretch, state.share / part)


def _flow(unrolling: Unrolling, state: RollState, pressure: Scalar) -> Scalar:
    """Return the gas flow of the supply, kg/s; zero while a hand unrolls."""
    if not unrolling.by_gas:
        return jnp.zeros_like(pressure)
    filling = unrolling.filling
    supplied = state.share * jnp.sum(filling.full_mass)
    return inflow(filling.gas, filling.supply, pressure, supplied)


def _hand_force(unrolling: Unrolling, forces: Forces) -> Scalar:
    """Return the force of the hand, N: the given force, or the one that keeps the speed."""
    if unrolling.by_gas:
        return jnp.zeros_like(forces.gas)
    if unrolling.hand.kind == "force":
        return jnp.broadcast_to(unrolling.hand.force, forces.gas.shape)
    return -sum(forces, jnp.zeros_like(forces.gas))


def _net_lift(unrolling: Unrolling, state: RollState) -> Float[Array, " link"]:
    """Return the mass that each link could still carry, kg; it may be paid out only in part."""
    filling = unrolling.filling
    tight = open_volume(unrolling, state.paid_out)
    share = state.share * jnp.sum(filling.volume) / larger(jnp.sum(tight), 1e-30)
    fullness = _tube(unrolling, state).fullness
    lift = filling.arm.air.density * fullness - filling.gas.density * share
    return lift * tight - filling.borne_mass


@program
def _course(unrolling: Unrolling, end: Scalar, tolerance: Scalar, times: int) -> _Course:
    """Unroll until the whole arm is paid out, or until the end (s), with `times` output times."""
    exact = 100 * float(jnp.finfo(end.dtype).eps)
    zero = jnp.zeros_like(end)

    def left(t: Scalar, y: RollState, args: Unrolling, **_: object) -> Scalar:
        return y.paid_out - args.length

    by_hand = not unrolling.by_gas and unrolling.hand.kind == "speed"
    speed = unrolling.hand.speed if by_hand else unrolling.roll.start_speed
    start = jnp.asarray(unrolling.roll.start, end.dtype)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(roll_rates),
        # The gas in a short tube acts as a stiff spring, and sticking layers as a stiff damper.
        diffrax.Kvaerno5(),
        t0=zero,
        t1=end,
        dt0=end * 1e-8,
        y0=RollState(start, jnp.asarray(speed, end.dtype), zero, Works(zero, zero, zero, zero)),
        args=unrolling,
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance / 10),
        saveat=diffrax.SaveAt(dense=True, t0=True, steps=True),
        event=diffrax.Event(left, optimistix.Newton(rtol=exact, atol=exact)),
        adjoint=diffrax.ForwardMode(),
        max_steps=_MOST_STEPS,
        throw=False,
    )
    assert solution.ts is not None
    count = solution.stats["num_accepted_steps"]
    last = solution.ts[count]
    grid = jnp.linspace(0, last, times, dtype=last.dtype)
    # The solution is less accurate between the steps of the integrator: report states at steps.
    rows = jnp.minimum(jnp.searchsorted(solution.ts, grid), count)

    def lifted(y: RollState) -> Array:
        lift = _net_lift(unrolling, y)
        return jnp.concatenate([lift, jnp.sum(lift)[None]])

    when = jnp.full(unrolling.filling.arm.count + 1, jnp.nan, end.dtype)
    if unrolling.by_gas:
        when = crossings(lifted, solution, grid, jax.vmap(solution.evaluate)(grid))
    return _Course(
        solution.ts[rows],
        jax.tree.map(lambda each: each[rows], solution.ys),
        when[:-1],
        when[-1],
        diffrax.is_event(solution.result),
        diffrax.is_okay(solution.result),
        jnp.asarray(solution.stats["num_steps"], jnp.result_type(int)),
    )


def _tried(unrolling: Unrolling, limit: Any) -> _Course:
    """Return the states versus time, up to the last successful step."""
    real = jnp.result_type(float)
    tolerance = 1e-10 if unrolling.by_gas else 1e-12
    if real == jnp.float32:
        tolerance = 1e-4
    return _course(unrolling, jnp.asarray(limit, real), jnp.asarray(tolerance, real), _ROWS)


def unrolling_time(unrolling: Unrolling, *, limit: float = LIMIT) -> Scalar:
    """Return the time that unrolling takes, s; NaN if it takes longer than the limit (s).

    The result is differentiable in forward mode (`jax.jvp`, `jax.jacfwd`) with respect to every
    array of the unrolling. The values of these arrays are not checked.

    Example:
        >>> import giajax
        >>> unrolling = giajax.mechanics.unrolling.Unrolling()
        >>> round(float(giajax.apps.unrolling.unrolling_time(unrolling)), 2)
        197.0
    """
    found = _tried(unrolling, limit)
    return jnp.where(found.finished, found.times[-1], jnp.nan)


_Numbers = npt.NDArray[np.float64]


class Energies(NamedTuple):
    """Energies of a roll versus time, J: kinetic, weight on a floor, and bending of the film.

    The bending energy is relative to that of the whole arm in the roll.
    """

    kinetic: Array
    weight: Array
    bending: Array


@dataclasses.dataclass(frozen=True)
class Unrolled:
    """Result of unrolling an arm, versus time, and of its subsequent filling.

    The times are those of steps of the integrator, at most 401.

    Attributes:
        times: times from 0 until the whole arm is paid out, s, shape (time,).
        paid_out: length of the arm that is paid out, m, shape (time,).
        speed: speed of the roll, m/s, shape (time,).
        radius: radius of the roll, m, shape (time,).
        pressure: gauge pressure in the part that is paid out, Pa, shape (time,).
        gas: mass of gas in the part that is paid out, kg, shape (time,).
        flow: volume flow of the supply at ambient pressure, m^3/s, shape (time,).
        forces: forces on the roll, N, each of shape (time,).
        hand_force: force of the hand, N, shape (time,).
        energies: energies of the roll, J, each of shape (time,).
        works: works on the roll since the beginning, J, each of shape (time,).
        imbalance: largest difference between the supplied gas and the gas in the arm according to
            its pressure and volume, divided by the mass that fills the arm; the filling is
            included.
        lift_off: time at which the lift of each link exceeds its weight, s; NaN if it never does,
            shape (link,).
        arm_lift_off: time at which the lift of all links exceeds their total weight, s.
        finished: whether the whole arm was paid out within the time limit.
        filled: subsequent filling, with times from its own start; None if there was no filling.
    """

    unrolling: Unrolling
    times: _Numbers
    paid_out: _Numbers
    speed: _Numbers
    radius: _Numbers
    pressure: _Numbers
    gas: _Numbers
    flow: _Numbers
    forces: Forces
    hand_force: _Numbers
    energies: Energies
    works: Works
    imbalance: float
    lift_off: _Numbers
    arm_lift_off: float
    finished: bool
    filled: Filled | None

    @property
    def handed_over(self) -> float:
        """Time at which the whole arm is paid out and filling begins, s; NaN if it never is."""
        return float(self.times[-1]) if self.finished else np.nan

    @property
    def duration(self) -> float:
        """Duration of unrolling and filling, s; NaN if they were not finished."""
        return self.handed_over + self.filled.duration if self.filled else np.nan

    @property
    def energy_imbalance(self) -> float:
        """Largest difference between the energy of the roll and the works on it, J."""
        energy = np.sum(np.asarray(self.energies), axis=0)
        works = self.works
        done = np.asarray(works.gas + works.hand - works.peel - works.loss)
        return float(np.max(np.abs(energy - energy[0] - done)))


def unroll(unrolling: Unrolling | None = None, *, limit: float = LIMIT) -> Unrolled:
    """Unroll an arm of balloons from its core, and then fill it with helium (figs 14 and 15).

    If gas unrolls the arm, this gas is in the links when the filling begins, at the same pressure
    in all of them.

    Arguments:
        unrolling: the roll, its film, its drive, and the filling. The default is by hand.
        limit: time limit of unrolling and of filling, s.

    Raises:
        InputError: a number outside its bounds, an impossible roll, or a simulation that does not
            finish.

    Example:
        >>> import giajax
        >>> unrolled = giajax.apps.unrolling.unroll()
        >>> round(unrolled.handed_over / 60, 2), round(unrolled.duration / 60, 1)
        (3.28, 26.5)
    """
    made = Unrolling() if unrolling is None else unrolling
    if not 0 < limit < np.inf:
        raise InputError(f"the limit is {limit:g} s: give a positive number of seconds")
    _check_unrolling(made)
    found = _tried(made, limit)
    if not bool(found.succeeded):
        raise InputError(
            f"the simulation of the unrolling failed at {float(found.times[-1]):.3g} s, after "
            f"{int(found.steps)} steps: increase film.loss, or reduce film.peel"
        )
    finished = bool(found.finished)
    # A step that is longer than the interval between two rows appears in several rows.
    _, rows = np.unique(np.asarray(found.times), return_index=True)
    both = (found.state, _seen(made, found))
    state, seen = jax.tree.map(lambda each: np.asarray(each)[rows], both)
    lift_off, arm_lift_off = np.asarray(found.lifts), float(found.lifts_all)
    imbalance = float(np.max(np.abs(state.share - seen.share)))
    filled, end = None, float(found.times[-1])
    if finished:
        filled = fill(made.filling, limit=limit, share=float(found.state.share[-1]))
        later = end + np.append(filled.lift_off, filled.arm_lift_off)
        lift_off = np.where(np.isnan(lift_off), later[:-1], lift_off)
        arm_lift_off = float(later[-1]) if np.isnan(arm_lift_off) else arm_lift_off
        imbalance = max(imbalance, filled.imbalance)
    return Unrolled(
        unrolling=made,
        times=np.asarray(found.times)[rows],
        paid_out=state.paid_out,
        speed=state.speed,
        radius=seen.radius,
        pressure=seen.pressure,
        gas=state.share * float(jnp.sum(made.filling.full_mass)),
        flow=seen.flow,
        forces=seen.forces,
        hand_force=seen.hand_force,
        energies=seen.energies,
        works=state.works,
        imbalance=imbalance,
        lift_off=lift_off,
        arm_lift_off=arm_lift_off,
        finished=finished,
        filled=filled,
    )


class _Seen(NamedTuple):
    """Quantities derived from states, for `Unrolled`; the share follows from the pressure."""

    radius: Array
    pressure: Array
    share: Array
    flow: Array
    forces: Forces
    hand_force: Array
    energies: Energies


@program
def _seen(unrolling: Unrolling, found: _Course) -> _Seen:
    """Return the quantities derived from the states of a course."""
    filling = unrolling.filling

    def at(state: RollState) -> _Seen:
        x, tube = state.paid_out, _tube(unrolling, state)
        forces = roll_forces(unrolling, x, state.speed, tube.pressure)
        tight = jnp.sum(open_volume(unrolling, x)) / jnp.sum(filling.volume)
        flow = _flow(unrolling, state, tube.pressure) / filling.gas.density
        pressed = 1 + tube.pressure / filling.gas.ambient_pressure
        kinetic = rolling_mass(unrolling, x) * state.speed**2 / 2
        energies = Energies(kinetic, weight_energy(unrolling, x), bending_energy(unrolling, x))
        return _Seen(
            roll_radius(unrolling, x),
            tube.pressure,
            pressed * tube.fullness * tight,
            jnp.broadcast_to(flow, x.shape),
            forces,
            _hand_force(unrolling, forces),
            energies,
        )

    seen: _Seen = jax.vmap(at)(found.state)
    return seen


def _check_unrolling(unrolling: Unrolling) -> None:
    """Raise an error for parameters outside their bounds, and for impossible rolls."""
    filling, roll, film = unrolling.filling, unrolling.roll, unrolling.film
    strength = STRENGTHS[filling.supply.kind]
    if unrolling.by_gas and not float(get(filling, strength)) > 0:
        raise InputError(
            f"the arm is set to unroll by gas, but no gas flows with {strength} = "
            f"{float(get(filling, strength)):g}: give a positive number, or the order "
            '"roll first"'
        )
    check_filling(filling)
    own = {each.path: each for group in (ROLL, FILM, HAND) for each in group}
    for path, parameter in declared(unrolling).items():
        if path in own:
            key = own[path].key
            closed = key is not None and key.closed
            check_within_bounds(parameter, float(parameter.value(unrolling)), free=not closed)
    if not float(roll.radius) > float(roll.core_radius):
        raise InputError(
            f"the radius of the roll is {float(roll.radius) * 1e3:g} mm, but its core has a radius "
            f"of {float(roll.core_radius) * 1e3:g} mm: give a roll larger than its core"
        )
    layer, films = float(unrolling.pitch), 2 * float(film.thickness)
    if layer < films:
        raise InputError(
            f"a layer of the roll is only {layer * 1e3:.3g} mm thick, but two films are "
            f"{films * 1e3:.3g} mm: give a larger roll.radius, or a smaller film.thickness"
        )
    length = float(unrolling.length)
    if not float(roll.start) < length:
        raise InputError(
            f"{float(roll.start):g} m are paid out at the start, but the arm is only {length:g} m "
            "long: reduce the length paid out at the start"
        )


UNROLLING_FILES = ("unrolling.json", "unrolling.csv", "unrolling.png")

_MINUTE = 60.0


def unrolling_files(unrolled: Unrolled) -> dict[str, bytes]:
    """Return the files of an unrolling, `UNROLLING_FILES`, and those of its filling."""
    files = {
        "unrolling.json": f"{unrolling_json(unrolled)}\n".encode(),
        "unrolling.csv": to_csv(_columns(unrolled)),
        "unrolling.png": to_png(unrolling_figure(unrolled)),
    }
    return files if unrolled.filled is None else files | filling_files(unrolled.filled)


def _columns(unrolled: Unrolled) -> dict[str, Any]:
    forces = {**unrolled.forces._asdict(), "hand": unrolled.hand_force}
    return {
        "time_s": unrolled.times,
        "paid_out_m": unrolled.paid_out,
        "speed_m_per_s": unrolled.speed,
        "radius_m": unrolled.radius,
        "pressure_Pa": unrolled.pressure,
        "gas_kg": unrolled.gas,
        "supply_flow_m3_per_s": unrolled.flow,
        **{f"{name}_force_N": row for name, row in forces.items()},
        **{f"{name}_energy_J": row for name, row in unrolled.energies._asdict().items()},
        **{f"{name}_work_J": row for name, row in unrolled.works._asdict().items()},
    }


def unrolling_json(unrolled: Unrolled) -> str:
    """Return final values of an unrolling as JSON text; events that did not occur are null."""
    made, filled = unrolled.unrolling, unrolled.filled
    full = np.full(unrolled.lift_off.shape, np.nan)
    if filled is not None:
        full = unrolled.handed_over + filled.full
    facts: dict[str, Any] = {
        "finished": unrolled.finished,
        "unrolled_s": unrolled.handed_over,
        "duration_s": unrolled.duration,
        "arm_lift_off_s": unrolled.arm_lift_off,
        "paid_out_m": unrolled.paid_out[-1],
        "gas_kg": unrolled.gas[-1],
        "imbalance": unrolled.imbalance,
        "largest_speed_m_per_s": unrolled.speed.max(),
        "largest_pressure_Pa": unrolled.pressure.max(),
        "largest_hand_force_N": unrolled.hand_force.max(),
        "layer_m": float(made.pitch),
        "works_J": {name: row[-1] for name, row in unrolled.works._asdict().items()},
        "energy_imbalance_J": unrolled.energy_imbalance,
        "links": {
            f"link{i:02d}": {"full_s": when, "lift_off_s": lifts}
            for i, (when, lifts) in enumerate(zip(full, unrolled.lift_off, strict=True), start=1)
        },
        "unrolling": made.definition(),
        "filling": made.filling.definition(),
    }
    return json.dumps(plain_data(facts), indent=2)


_SHOWN: dict[str, tuple[str, str, Any]] = {
    "gas": ("gas", BLUE, "-"),
    "hand": ("hand", GREEN, (0, (5, 1, 1, 1, 1, 1))),
    "weight": ("weight of the roll", INK, "-."),
    "peel": ("peel", VERMILLION, "--"),
    "loss": ("loss", PURPLE, ":"),
}
"""Labels, colours and lines of the forces in the figure. Bending and inertia forces are small."""


def unrolling_figure(unrolled: Unrolled) -> Figure:
    """Plot length paid out, speed and forces versus time, and the gas until the arm is full."""
    made = unrolled.unrolling
    by = "gas" if made.by_gas else "hand"
    end = "not completely paid out"
    if unrolled.finished:
        end = f"completely paid out after {unrolled.handed_over / _MINUTE:.1f} min"
    flow = " (solid) and gas flow divided by the cross-section of the tube (dashed)"
    filling = "" if unrolled.filled is None else " while it is unrolled and then filled"
    marked = np.isfinite([unrolled.handed_over, unrolled.arm_lift_off]).any()
    marks = ". Dashed lines mark the labelled events" if marked else ""
    caption = (
        "Upper left: length of the arm that is paid out. Upper right: speed of the roll"
        f"{flow if made.by_gas else ''}. Lower left: forces along the path of the roll. Forces "
        "that oppose its motion are negative. Bending and inertia forces are not drawn. Lower "
        "right: mass of gas in the arm relative to the mass that fills it at ambient pressure"
        f"{filling}{marks}."
    )
    figure = new_figure(9.0, 6.0, f"Unrolling {float(made.length):g} m by {by}: {end}", caption)
    minutes = unrolled.times / _MINUTE
    axes = figure.add_subplot(2, 2, 1)
    axes.plot(minutes, unrolled.paid_out, color=BLUE, linewidth=1.4)
    plain(axes, "Length paid out", "time (min)", "length (m)")
    axes = figure.add_subplot(2, 2, 2)
    axes.plot(minutes, unrolled.speed * 1e3, color=BLUE, linewidth=1.2, label="roll")
    if made.by_gas:
        feeds = unrolled.flow / _area(unrolled) * 1e3
        axes.plot(minutes, feeds, "--", color=INK, linewidth=0.9, label="gas flow per area")
        axes.legend(fontsize=8, frameon=False)
    plain(axes, "Speed of the roll", "time (min)", "speed (mm/s)")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes = figure.add_subplot(2, 2, 3)
    forces = {**unrolled.forces._asdict(), "hand": unrolled.hand_force}
    for name, (label, colour, dashes) in _SHOWN.items():
        if np.any(forces[name] != 0):
            axes.plot(minutes, forces[name], color=colour, ls=dashes, lw=1.2, label=label)
    axes.axhline(0, color=GREY, linewidth=0.8)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.35 * (high - low))
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="upper left")
    plain(axes, "Forces on the roll", "time (min)", "force (N)")
    axes = figure.add_subplot(2, 2, 4)
    _whole_course(axes, unrolled)
    return figure


def _area(unrolled: Unrolled) -> _Numbers:
    """Return the cross-section of the tube at the roll, m^2."""
    made = unrolled.unrolling
    link = np.searchsorted(np.asarray(made.ends)[:-1], unrolled.paid_out, side="right")
    area: _Numbers = np.pi / 4 * np.asarray(made.filling.arm.links.diameter)[link] ** 2
    return area


def _whole_course(axes: Axes, unrolled: Unrolled) -> None:
    """Plot the gas in the arm until it is full, with the hand-over and lift-off."""
    full = float(np.sum(np.asarray(unrolled.unrolling.filling.full_mass)))
    times, gas = unrolled.times, unrolled.gas
    if (filled := unrolled.filled) is not None:
        times = np.append(times, unrolled.handed_over + filled.times)
        gas = np.append(gas, filled.supplied)
    axes.plot(times / _MINUTE, gas / full, color=BLUE, linewidth=1.4)
    plain(axes, "Gas in the arm", "time (min)", "mass relative to a full arm")
    axes.set_ylim(0, 1.3)
    marks = {"filling begins": unrolled.handed_over, "arm lifts off": unrolled.arm_lift_off}
    for height, (said, when) in zip((1.22, 1.12), marks.items(), strict=True):
        if not np.isnan(when):
            axes.axvline(when / _MINUTE, color=INK, linewidth=0.8, linestyle="--")
            right = when > times[-1] / 2
            small: Any = {"fontsize": 8, "ha": "right" if right else "left", "va": "center"}
            text = f"{said}: {when / _MINUTE:.1f} min"
            small["bbox"] = {"facecolor": "white", "edgecolor": "none", "pad": 1}
            small |= {"xytext": (-4 if right else 4, 0), "textcoords": "offset points"}
            axes.annotate(text, (when / _MINUTE, height), **small)
