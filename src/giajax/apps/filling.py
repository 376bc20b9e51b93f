"""Helium filling of an arm of balloons: simulation, tables and figures."""

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import optimistix
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..mechanics.arm import Arm
from ..mechanics.inflation import (
    STRENGTHS,
    BagState,
    Filling,
    PerBag,
    bag_state,
    bending_stiffness,
    inflow,
)
from ..mechanics.joint import BraidedMuscle
from ..models import arm_to_definition, preset_of
from ..recordings import to_toml
from ..report import BLUE, GREY, INK, VERMILLION, new_figure, plain, to_csv, to_png
from ..runtime.arrays import Array, Bool, Float, Int, Scalar
from ..runtime.limits import FILLING_S
from ..runtime.parallel import Tell, all_in_threads
from ..runtime.programs import program
from ..runtime.records import plain_data
from ..runtime.text import InputError
from ..schema import AT_REST, GAS, LINKS, PORTS, SKIN, SUPPLY, collapse
from ..schema.parameters import check_within_bounds, declared, get, replace

_MOST_STEPS = 20_000


class State(NamedTuple):
    """Gas in each bag and gas supplied in total, each divided by the mass when full."""

    share: PerBag
    supplied: Scalar


class _Course(NamedTuple):
    """Gas at evenly spaced times (s) from 0 to the end; see `Filled`.

    Shares and supplied gas are divided by the mass of a full bag, or of all bags. Times of events
    that did not occur are NaN.
    """

    times: Float[Array, " time"]
    share: Float[Array, "time bag"]
    supplied: Float[Array, " time"]
    full: PerBag
    lifts: Float[Array, " link"]
    lifts_all: Scalar
    finished: Bool[Array, ""]
    succeeded: Bool[Array, ""]
    steps: Int[Array, ""]


def rates(time: Any, state: State, filling: Filling) -> State:
    """Return rates of change, 1/s: inflow through one port of a bag minus outflow of the other."""
    full = filling.full_mass
    total = jnp.sum(full)
    pressure = _bags_at(filling, state.share).pressure
    fed, between = filling.flows(pressure, state.supplied * total)
    into = jnp.concatenate([fed[None], between])
    out = jnp.concatenate([between, jnp.zeros_like(fed)[None]])
    return State((into - out) / full, fed / total)


def _bags_at(filling: Filling, share: PerBag) -> BagState:
    """Return pressure and volume of the bags."""
    return bag_state(filling.gas, filling.skin, filling.stretch, share)


def _net_lift_of_links(filling: Filling, share: PerBag) -> Float[Array, " link"]:
    """Return the mass that each link could still carry, kg: displaced air minus gas and load."""
    arm, here = filling.arm, filling.bag_of_link
    fullness = _bags_at(filling, share).fullness[here]
    lift = arm.air.density * fullness - filling.gas.density * share[here]
    return lift * arm.links.volume - filling.borne_mass


@program
def _course(filling: Filling, share: PerBag, end: Scalar, tolerance: Scalar, times: int) -> _Course:
    """Fill until every bag is full, or until the end (s), and return the state at `times` times.

    `share` is the initial content of the bags. The tolerance of the integrator is relative to the
    mass of a full bag.
    """
    exact = 100 * float(jnp.finfo(end.dtype).eps)

    def missing(t: Scalar, y: State, args: Filling, **_: object) -> Scalar:
        return jnp.min(y.share) - 1

    # Bags that are full initially trigger no event: only a very short interval is then simulated.
    was_full = jnp.min(share) >= 1
    end = jnp.where(was_full, 1e-6 * end, end)
    full_mass = filling.full_mass
    supplied = jnp.sum(share * full_mass) / jnp.sum(full_mass)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        # The problem is stiff: pressures of tight bags settle within a second, filling takes
        # minutes.
        diffrax.Kvaerno5(),
        t0=jnp.zeros_like(end),
        t1=end,
        dt0=end * 1e-5,
        y0=State(share, supplied),
        args=filling,
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        saveat=diffrax.SaveAt(dense=True, t1=True),
        event=diffrax.Event(missing, optimistix.Newton(rtol=exact, atol=exact)),
        max_steps=_MOST_STEPS,
        throw=False,
    )
    assert solution.ts is not None
    last = solution.ts[-1]
    finished = diffrax.is_event(solution.result) | was_full
    grid = jnp.linspace(0, last, times, dtype=last.dtype)
    known = jax.vmap(solution.evaluate)(grid)

    def reached(y: State) -> Array:
        lift = _net_lift_of_links(filling, y.share)
        return jnp.concatenate([y.share - 1, lift, jnp.sum(lift)[None]])

    when, bags = crossings(reached, solution, grid, known), filling.bags
    full, lifts, lifts_all = when[:bags], when[bags:-1], when[-1]
    return _Course(
        grid,
        known.share,
        known.supplied,
        # The bag that triggered the event is full at that time, up to rounding.
        jnp.where(finished & jnp.isnan(full), last, full),
        lifts,
        lifts_all,
        finished,
        diffrax.is_okay(solution.result),
        jnp.asarray(solution.stats["num_steps"], jnp.result_type(int)),
    )


def crossings(
    of: Callable[[Any], Array], solution: diffrax.Solution, grid: Array, known: Any
) -> Array:
    """Return the time at which each component is first at least 0, s, by bisection of the solution.

    It is the first grid time if the component is at least 0 there, and NaN if it never is.

    Arguments:
        of: function that returns the components of a state.
        solution: dense solution.
        grid: times, s.
        known: states at these times.
    """
    above = jax.vmap(of)(known) >= 0
    first = jnp.argmax(above, axis=0)
    low, high = grid[jnp.maximum(first - 1, 0)], grid[first]

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        here = jax.vmap(lambda t: of(solution.evaluate(t)))(middle)
        reached = jnp.diagonal(here) >= 0
        return jnp.where(reached, low, middle), jnp.where(reached, middle, high)

    _, high = jax.lax.fori_loop(0, 50, halve, (low, high))
    return jnp.where(above.any(axis=0), high, jnp.nan)


_Numbers = npt.NDArray[np.float64]

LIMIT = 6 * 3600.0
"""Default time limit of `fill`, s."""

_TIMES = 401
_TOLERANCE = 1e-8


@dataclasses.dataclass(frozen=True)
class Filled:
    """Result of the filling of an arm, versus time.

    Links that share a bag have the same fullness, pressure and times.

    Attributes:
        times: times from 0 until all links are full, s, shape (time,).
        fullness: volume of each link divided by that of its tube, shape (time, link).
        pressure: gauge pressure of each link, Pa, shape (time, link).
        gas: mass of gas in each link, kg, shape (time, link).
        supplied: mass of gas from the supply, kg, shape (time,).
        flow: volume flow of the supply at ambient pressure, m^3/s, shape (time,).
        net_lift: mass that each link could carry in addition, kg, shape (time, link).
        folding_moment: moment p pi r^3 at which each link folds, N m, shape (time, link).
        stiffness: bending stiffness of each link, N m^2, shape (time, link). It is assumed to be
            that of Comer and Levy's tube under the moment of its own weight at its end.
        full: time at which each link is full, s; NaN if it never is, shape (link,).
        lift_off: time at which the lift of each link exceeds its weight, s; NaN if it never does,
            shape (link,).
        arm_lift_off: time at which the lift of all links exceeds their total weight, s.
        finished: whether all links were full within the time limit.
    """

    filling: Filling
    times: _Numbers
    fullness: _Numbers
    pressure: _Numbers
    gas: _Numbers
    supplied: _Numbers
    flow: _Numbers
    net_lift: _Numbers
    folding_moment: _Numbers
    stiffness: _Numbers
    full: _Numbers
    lift_off: _Numbers
    arm_lift_off: float
    finished: bool

    @property
    def duration(self) -> float:
        """Duration of the filling, s; NaN if it was not finished."""
        return float(np.max(self.full))

    @property
    def imbalance(self) -> float:
        """Largest difference between supplied gas and gas in the links, over the mass when full."""
        off = np.max(np.abs(self.supplied - self.gas.sum(axis=1)))
        return float(off) / float(np.sum(np.asarray(self.filling.full_mass)))

    @property
    def inflation(self) -> dict[str, _Numbers]:
        """Final pressure and fullness of the links, for `giajax.replace` of the arm.

        Example:
            >>> import giajax
            >>> filled = giajax.fill()
            >>> arm = giajax.replace(filled.filling.arm, filled.inflation)
            >>> round(float(arm.links.pressure[0]))
            713
        """
        known = np.asarray(self.filling.arm.links.fullness)
        # The integrator leaves small negative values in bags that no gas has reached.
        state = np.maximum([self.pressure[-1], known * self.fullness[-1]], 0)
        return dict(zip((LINKS.pressure.path, LINKS.fullness.path), state, strict=True))

    @property
    def collapse(self) -> str | None:
        """Sentence on links whose final pressure is too low for a muscle at its pressure limit.

        None if there are no such links.
        """
        arm = self.filling.arm
        pressure = self.inflation[LINKS.pressure.path]
        return collapse(pressure, np.asarray(arm.links.diameter), muscle_pull(arm))


def muscle_pull(arm: Arm) -> float:
    """Return the force of one muscle of an arm at its pressure limit, N.

    An arm without muscles is given the default braided muscle.
    """
    muscle = BraidedMuscle() if arm.pneumatics is None else arm.pneumatics.muscle
    still = jnp.zeros_like(muscle.pressure_limit)
    length = jnp.full_like(still, AT_REST.length.default)
    return float(jnp.max(muscle.force(muscle.pressure_limit, still, length)))


def fill(
    filling: Filling | None = None,
    *,
    limit: float = LIMIT,
    share: npt.ArrayLike = 0.0,
) -> Filled:
    """Fill an arm of balloons with helium until every link is full (fig. 15).

    Arguments:
        filling: arm, gas, ports and supply. The default is those of the paper.
        limit: time limit, s.
        share: initial gas in the bags, divided by the gas of a full bag: one number, or one number
            for each bag. It counts as supplied.

    Raises:
        InputError: a number outside its bounds, or a simulation that does not finish.

    Example:
        >>> import giajax
        >>> filled = giajax.fill()
        >>> round(filled.duration / 60, 1), round(filled.arm_lift_off / 60, 1)
        (23.2, 14.9)
    """
    made = Filling() if filling is None else filling
    if not 0 < limit < np.inf:
        raise InputError(f"the limit is {limit:g} s: give a positive number of seconds")
    check_filling(made)
    found = _tried(made, limit, _TOLERANCE, _shares(made, share))
    if not bool(found.succeeded):
        raise InputError(
            f"the simulation of the filling failed at {float(found.times[-1]):.3g} s, after "
            f"{int(found.steps)} steps: make the holes narrower, or skin_slack larger"
        )
    here, links = made.bag_of_link, made.arm.links
    pressure, fullness, flow, lift = map(np.asarray, _states(made, found))
    return Filled(
        filling=made,
        times=np.asarray(found.times),
        fullness=fullness[:, here],
        pressure=pressure[:, here],
        gas=np.asarray(found.share)[:, here] * np.asarray(made.gas.density * links.volume),
        supplied=np.asarray(found.supplied) * float(jnp.sum(made.full_mass)),
        flow=flow,
        net_lift=lift,
        folding_moment=np.pi * (np.asarray(links.diameter) / 2) ** 3 * pressure[:, here],
        stiffness=bending_stiffness(made.arm, made.skin, pressure[:, here]),
        full=np.asarray(found.full)[here],
        lift_off=np.asarray(found.lifts),
        arm_lift_off=float(found.lifts_all),
        finished=bool(found.finished),
    )


def _shares(filling: Filling, share: npt.ArrayLike) -> _Numbers:
    """Return the initial share of each bag, from one number or one for each bag."""
    given = np.asarray(share, dtype=float)
    if given.shape not in ((), (filling.bags,)):
        raise InputError(
            f"the filled share has the shape {given.shape}, but the arm has {filling.bags} bags: "
            "give one number, or one number for each bag"
        )
    # The integrator leaves small negative values in bags that no gas has reached.
    wrong = given[~((given >= -_TOLERANCE) & (given < np.inf))]
    if wrong.size:
        raise InputError(f"a filled share is {wrong[0]:g}: give zero or a positive number")
    return np.broadcast_to(np.maximum(given, 0), filling.bags)


def _tried(
    filling: Filling, limit: float, tolerance: float, share: npt.ArrayLike | None = None
) -> _Course:
    """Return the simulated filling, up to the last successful step."""
    if jnp.result_type(float) == jnp.float32:
        tolerance = max(tolerance, 1e-4)
    empty = np.zeros(filling.bags) if share is None else share
    real = jnp.result_type(float)
    begin, end, close = (jnp.asarray(number, real) for number in (empty, limit, tolerance))
    return _course(filling, begin, end, close, _TIMES)


def check_filling(filling: Filling) -> None:
    """Raise an error for parameters outside their bounds.

    Raises:
        InputError: a parameter is outside its bounds; the message names it.
    """
    own = {declaration.path for group in (GAS, SKIN, PORTS, SUPPLY) for declaration in group}
    for path, parameter in declared(filling).items():
        if path in own or path.startswith("links.") or path == "air.density":
            for value in np.ravel(np.asarray(parameter.value(filling))).tolist():
                # A value at the bound 0 is valid: it describes a port without a hole.
                closed = path in own and value <= parameter.declaration.lower
                check_within_bounds(parameter, value, free=closed)


@program
def _states(filling: Filling, found: _Course) -> tuple[Array, Array, Array, Array]:
    """Return pressure and fullness of bags, flow of the supply and net lift of links, by time."""
    total = jnp.sum(filling.full_mass)

    def at(share: Array, supplied: Scalar) -> tuple[Array, Array, Array, Array]:
        bags = _bags_at(filling, share)
        fed = inflow(filling.gas, filling.supply, bags.pressure[0], supplied * total)
        lift = _net_lift_of_links(filling, share)
        return bags.pressure, bags.fullness, fed / filling.gas.density, lift

    return jax.vmap(at)(found.share, found.supplied)


PAPER_DURATION = 23 * 60.0
"""Duration of the filling in the paper, s (section IV.B)."""

DIAMETERS = (0.004, 0.005, 0.006, 0.007, 0.008, 0.01, 0.012, 0.015, 0.02)
"""Diameters of the ports for which the curve is computed, m."""

_TRIES = 40
# Largest change of the logarithm: a supply a hundred times as strong would not suffice either.
_FAR = math.log(1e2)
_CLOSE = 1e-6


@dataclasses.dataclass(frozen=True)
class FillingCurve:
    """Pairs of port diameter and supply for which filling takes a given time (s).

    Attributes:
        diameters: diameter of all ports, m, shape (pair,).
        strengths: required value of the supply parameter `path`, SI; NaN if no value suffices.
        path: path of that parameter: the flow, the pressure of the regulator, or the nozzle of the
            bottle.
        flows: initial volume flow of the supply at ambient pressure, m^3/s.
        pressures: largest gauge pressure of the first bag, Pa.
    """

    duration: float
    diameters: _Numbers
    strengths: _Numbers
    path: str
    flows: _Numbers
    pressures: _Numbers


def filling_curve(
    filling: Filling | None = None,
    *,
    duration: float = PAPER_DURATION,
    diameters: Sequence[float] = DIAMETERS,
) -> FillingCurve:
    """Return the supply for each port diameter (m) for which filling takes a given time (s).

    Arguments:
        filling: arm, gas, ports and supply; all ports are given the same diameter.
        duration: duration of the filling, s.
        diameters: diameters of the ports, m.

    Raises:
        InputError: a number outside its bounds, or an arm without ports.
    """
    made = Filling() if filling is None else filling
    if made.bags < 2:
        raise InputError("all links share one bag, which has no ports: do not request the curve")
    if not 0 < duration <= FILLING_S:
        raise InputError(
            f"the duration is {duration:g} s: give a positive number of at most {FILLING_S:g} s"
        )
    if not len(diameters):
        raise InputError("no diameter is given: give at least one")
    path = STRENGTHS[made.supply.kind]

    def one(diameter: float, begin: _Slope) -> tuple[_Slope, tuple[float, ...]]:
        """Return the next initial guess, and the pair with its flow and pressure."""
        narrowed = replace(made, {PORTS.diameter.path: float(diameter)})
        check_filling(narrowed)
        found = _strength(narrowed, path, duration, begin)
        if found is None:
            return begin, (diameter, np.nan, np.nan, np.nan)
        end, course = found
        strength = math.exp(end.at)
        pressure, _, flow, _ = map(np.asarray, _states(replace(narrowed, {path: strength}), course))
        return end, (diameter, strength, flow[0], pressure[:, 0].max())

    # Start with the widest ports, which need about the supply of ports without resistance. Then
    # compute the others in two parallel chains, each started from its previous result.
    widest, *others = sorted(diameters, reverse=True)
    # With a metered supply the duration is inversely proportional to the flow.
    first, pair = one(widest, _Slope(math.log(float(get(made, path))), -1.0))

    def chain(tell: Tell, own: Sequence[float]) -> list[tuple[float, ...]]:
        begin, found = first, []
        for diameter in own:
            tell(lambda: None)  # After Ctrl-C no further computation begins.
            begin, pair = one(diameter, begin)
            found.append(pair)
        return found

    jobs = [functools.partial(chain, own=others[k::2]) for k in (0, 1)]
    columns = sorted([pair, *(each for found in all_in_threads(jobs) for each in found)])
    pairs = np.asarray(columns).T
    return FillingCurve(duration, pairs[0], pairs[1], path, pairs[2], pairs[3])


class _Slope(NamedTuple):
    """Logarithm of a strength, and derivative of the logarithmic duration with respect to it."""

    at: float
    slope: float


def _strength(
    filling: Filling, path: str, duration: float, begin: _Slope
) -> tuple[_Slope, _Course] | None:
    """Return the strength of the supply for which filling takes this long, and the filling.

    The result is None if no strength suffices. The root is found by the secant method in
    logarithms, within a bracket of too small and too large strengths.
    """
    low, high = -math.inf, math.inf
    (here, slope), before = begin, None
    for _ in range(_TRIES):
        course = _tried(replace(filling, {path: math.exp(here)}), 4 * duration, 1e-7)
        if not bool(course.succeeded):
            return None
        finished = bool(course.finished)
        late = math.log(float(course.times[-1]) / duration)
        if finished and abs(late) < _CLOSE:
            return _Slope(here, slope), course
        low, high = (max(low, here), high) if late > 0 else (low, min(high, here))
        if before is not None and finished and before[0] != here:
            slope = min((late - before[1]) / (here - before[0]), -0.05)
        before = (here, late) if finished else None
        new = here - min(max(late / (slope if finished else -1.0), -1.5), 1.5)
        here = new if low < new < high else (low + high) / 2
        if abs(here - begin.at) > _FAR or high - low < 1e-12:
            return None
    return None


FILLING_FILES = ("filling.json", "filling.csv", "filling.png", "inflation.toml")
CURVE_FILES = ("curve.csv", "curve.png")

_MINUTE, _LITRE_PER_MINUTE = 60.0, 1e-3 / 60


def filling_files(filled: Filled, curve: FillingCurve | None = None) -> dict[str, bytes]:
    """Return the files of a filling, by the names of `FILLING_FILES` and `CURVE_FILES`."""
    files = {
        "filling.json": f"{filling_json(filled, curve)}\n".encode(),
        "filling.csv": to_csv(_columns(filled)),
        "filling.png": to_png(filling_figure(filled)),
        "inflation.toml": inflation_toml(filled).encode(),
    }
    if curve is not None:
        pairs = {
            "port_diameter_mm": curve.diameters * 1e3,
            "supply_flow_l_per_min": curve.flows / _LITRE_PER_MINUTE,
            curve.path.replace(".", "_"): curve.strengths,
            "largest_pressure_Pa": curve.pressures,
        }
        files |= {"curve.csv": to_csv(pairs), "curve.png": to_png(curve_figure(curve))}
    return files


def inflation_toml(filled: Filled) -> str:
    """Return the complete definition of the filled arm, with pressure and fullness of each link."""
    arm = replace(filled.filling.arm, filled.inflation)
    begins, stated = preset_of(arm), arm_to_definition(arm)
    parameters = {**begins.get("parameters", {}), **stated.get("parameters", {})}
    section = {**begins, **stated, "parameters": parameters}
    return to_toml({"schema_version": 1, "model": "arm", "arm": section})


def _columns(filled: Filled) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "time_s": filled.times,
        "supply_flow_m3_per_s": filled.flow,
        "supplied_kg": filled.supplied,
    }
    each = {
        "fullness": filled.fullness,
        "pressure_Pa": filled.pressure,
        "net_lift_kg": filled.net_lift,
        "stiffness_N_m2": filled.stiffness,
    }
    for name, table in each.items():
        columns |= {f"link{i:02d}_{name}": row for i, row in enumerate(table.T, start=1)}
    return columns


def filling_json(filled: Filled, curve: FillingCurve | None = None) -> str:
    """Return final values of a filling as JSON text; events that did not occur are null."""
    made = filled.filling
    facts: dict[str, Any] = {
        "finished": filled.finished,
        "duration_s": filled.duration,
        "arm_lift_off_s": filled.arm_lift_off,
        "volume_m3": np.sum(np.asarray(made.volume)),
        "supplied_kg": filled.supplied[-1],
        "imbalance": filled.imbalance,
        "collapse": filled.collapse,
        "links": {
            f"link{i:02d}": {
                "full_s": filled.full[i - 1],
                "lift_off_s": filled.lift_off[i - 1],
                "largest_pressure_Pa": filled.pressure[:, i - 1].max(),
                "pressure_Pa": filled.pressure[-1, i - 1],
                "fullness": filled.fullness[-1, i - 1],
                "net_lift_kg": filled.net_lift[-1, i - 1],
                "folding_moment_N_m": filled.folding_moment[-1, i - 1],
                "stiffness_N_m2": filled.stiffness[-1, i - 1],
            }
            for i in range(1, made.arm.count + 1)
        },
        "filling": made.definition(),
    }
    if curve is not None:
        names = ("port_diameter_m", "supply", "supply_flow_m3_per_s", "largest_pressure_Pa")
        rows = zip(curve.diameters, curve.strengths, curve.flows, curve.pressures, strict=True)
        facts["curve"] = {
            "duration_s": curve.duration,
            "supply": curve.path,
            "pairs": [dict(zip(names, row, strict=True)) for row in rows],
        }
    return json.dumps(plain_data(facts), indent=2)


def filling_figure(filled: Filled) -> Figure:
    """Plot fullness, pressure, lift and stiffness versus time."""
    end = f"full after {filled.duration / _MINUTE:.1f} min" if filled.finished else "never full"
    lifts = not np.isnan(filled.arm_lift_off)
    mark = " At the dashed line, the lift of all links begins to exceed their total weight."
    caption = (
        "Each line is a link, coloured from dark purple (base) to light green (tip). The fill "
        "level is the volume of the gas in a link divided by the volume of its tube. Net lift is "
        "the mass that a link could carry in addition to its own. Bending stiffness is that of an "
        "inflated membrane tube (Comer and Levy) that bears the bending moment of its own weight."
        f"{mark if lifts else ''}"
    )
    title = f"Filling {filled.filling.arm.count} links: {end}"
    figure = new_figure(9.0, 6.0, title, caption)
    minutes = filled.times / _MINUTE
    panels = {
        "Fill level of each link": (filled.fullness, "fraction of the full volume"),
        "Pressure in each link": (filled.pressure, "gauge pressure (Pa)"),
        "Net lift of each link": (filled.net_lift * 1e3, "net lift (g)"),
        "Bending stiffness of each link (assumed)": (filled.stiffness, "stiffness (N m$^2$)"),
    }
    for place, (title, (table, unit)) in enumerate(panels.items(), start=1):
        axes = figure.add_subplot(2, 2, place)
        _curves(axes, minutes, table)
        plain(axes, title, "time (min)", unit)
        if place == 2:
            axes.legend(fontsize=8, frameon=False, loc="upper left")
        if place == 3:
            axes.axhline(0, color=GREY, linewidth=0.8)
            if lifts:
                when = filled.arm_lift_off / _MINUTE
                axes.axvline(when, color=INK, linewidth=0.8, linestyle="--")
                low, high = axes.get_ylim()
                axes.set_ylim(low, high + 0.2 * (high - low))
                said, above = f"arm lifts off: {when:.1f} min", high + 0.08 * (high - low)
                small: Any = {"ha": "right", "fontsize": 8}
                axes.annotate(said, (when, above), (-4, 0), textcoords="offset points", **small)
    return figure


def _curves(axes: Axes, minutes: Any, table: Any) -> None:
    """Plot a line for each link, coloured from base to tip."""
    last = table.shape[1] - 1
    named = {0: "link 1 (base)", last: f"link {last + 1} (tip)"} if last else {0: "link 1"}
    for index, row in enumerate(table.T):
        colour = colormaps["viridis"](0.9 * index / max(last, 1))
        axes.plot(minutes, row, color=colour, linewidth=1.1, label=named.get(index))


def curve_figure(curve: FillingCurve) -> Figure:
    """Plot port diameter versus supply, and the required pressure."""
    title = f"Port diameters and supplies for filling within {curve.duration / _MINUTE:g} min"
    missing = " Diameters with which no supply suffices are omitted."
    caption = (
        "Each dot is a diameter of all ports and a supply with which filling takes the time in the "
        "title. "
        "Left: diameter versus the initial flow of the supply, which is a volume flow at ambient "
        "pressure. Right: largest gauge pressure in the first bag, at the base, versus diameter. "
        f"The ordinate on the right is logarithmic.{missing if np.isnan(curve.flows).any() else ''}"
    )
    figure = new_figure(8.0, 3.4, title, caption)
    diameters = curve.diameters * 1e3
    axes = figure.add_subplot(1, 2, 1)
    axes.plot(curve.flows / _LITRE_PER_MINUTE, diameters, "o-", color=BLUE, ms=4)
    port = "diameter of the ports (mm)"
    plain(axes, "Port diameter versus supply", "initial flow of the supply (l/min)", port)
    axes.set_ylim(bottom=0)
    axes = figure.add_subplot(1, 2, 2)
    axes.semilogy(diameters, curve.pressures, "o-", color=VERMILLION, ms=4)
    plain(axes, "Pressure required", port, "largest pressure in the first bag (Pa)")
    axes.tick_params(which="both", labelsize=8)
    return figure
