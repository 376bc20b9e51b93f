"""An arm of balloons that is filled with helium: its course in time, tables and pictures."""

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
from ..runtime.parallel import Tell, run_in_threads
from ..runtime.process import cores
from ..runtime.programs import program
from ..runtime.records import plain_data
from ..runtime.text import InputError
from ..schema import AT_REST, GAS, LINKS, PORTS, SKIN, SUPPLY, collapse
from ..schema.parameters import check_within_bounds, declared, get, replace

_MOST_STEPS = 20_000


class State(NamedTuple):
    """What changes: gas of each bag, and all that the supply has fed, over what fills them."""

    share: PerBag
    supplied: Scalar


class _Course(NamedTuple):
    """Gas over time, at evenly spaced times (s) from 0 to the end, as `Filled` has it.

    Shares and what was supplied are over what fills a bag, or all. Times of what never came: NaN.
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
    """Rates of change, 1/s: what comes through one port of a bag less what leaves by the other."""
    full = filling.full_mass
    total = jnp.sum(full)
    pressure = _bags_at(filling, state.share).pressure
    fed, between = filling.flows(pressure, state.supplied * total)
    into = jnp.concatenate([fed[None], between])
    out = jnp.concatenate([between, jnp.zeros_like(fed)[None]])
    return State((into - out) / full, fed / total)


def _bags_at(filling: Filling, share: PerBag) -> BagState:
    """Pressure and volume of the bags."""
    return bag_state(filling.gas, filling.skin, filling.stretch, share)


def _net_lift_of_links(filling: Filling, share: PerBag) -> Float[Array, " link"]:
    """Mass that each link could still carry, kg: air displaced, less gas and all that it bears."""
    arm, here = filling.arm, filling.bag_of_link
    fullness = _bags_at(filling, share).fullness[here]
    lift = arm.air.density * fullness - filling.gas.density * share[here]
    return lift * arm.links.volume - filling.borne_mass


@program
def _course(filling: Filling, share: PerBag, end: Scalar, tolerance: Scalar, times: int) -> _Course:
    """Fill until every bag has what fills it, or until the end (s); told of at so many times.

    The share is what bags have at the beginning. The tolerance of the steps is relative to what
    fills a bag.
    """
    exact = 100 * float(jnp.finfo(end.dtype).eps)

    def missing(t: Scalar, y: State, args: Filling, **_: object) -> Scalar:
        return jnp.min(y.share) - 1

    # What is full at the beginning has no time at which it becomes so.
    was_full = jnp.min(share) >= 1
    end = jnp.where(was_full, 1e-6 * end, end)
    full_mass = filling.full_mass
    supplied = jnp.sum(share * full_mass) / jnp.sum(full_mass)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        # The pressures of bags that are tight settle within a second, the whole takes minutes.
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
        # What the event stopped at is full then, up to rounding.
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
    """When each number of a state is first 0 or more, s: by bisection of the solution.

    It is the first time of the grid where it is so there, and NaN where it never is.

    Arguments:
        of: the numbers of a state.
        grid: times, s.
        known: the states at these.
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
    """An arm that was filled, over time.

    Links of one bag have the same fullness, pressure and times.

    Attributes:
        times: s, from 0 until all is full, shape (time,).
        fullness: volume of each link over that of its tube, shape (time, link).
        pressure: of each link above that of the room, Pa, shape (time, link).
        gas: mass in each link, kg, shape (time, link).
        supplied: mass that the supply has fed, kg, shape (time,).
        flow: of the supply, as volume at the pressure of the room, m^3/s, shape (time,).
        net_lift: what each link could carry beside itself, kg, shape (time, link).
        folding_moment: p pi r^3 of each link, at which it folds, N m, shape (time, link).
        stiffness: bending stiffness of each link, N m^2, shape (time, link); assumed: that of
            Comer and Levy's tube under the moment of its own weight at its end.
        full: when each link has the gas that fills it, s; NaN where it never has, shape (link,).
        lift_off: when each link's lift bears the link, s; NaN where it never does, shape (link,).
        arm_lift_off: when the lift of all links bears the mass of all, s.
        finished: whether all links were filled within the limit.
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
        """How long filling took, s; NaN where it was not finished."""
        return float(np.max(self.full))

    @property
    def imbalance(self) -> float:
        """Largest difference of what was fed and what is in the links, over what fills them."""
        off = np.max(np.abs(self.supplied - self.gas.sum(axis=1)))
        return float(off) / float(np.sum(np.asarray(self.filling.full_mass)))

    @property
    def inflation(self) -> dict[str, _Numbers]:
        """Pressure and fullness of the links in the end, for `giajax.replace` of the arm.

        Example:
            >>> import giajax
            >>> filled = giajax.fill()
            >>> arm = giajax.replace(filled.filling.arm, filled.inflation)
            >>> round(float(arm.links.pressure[0]))
            713
        """
        known = np.asarray(self.filling.arm.links.fullness)
        # The integrator leaves traces below 0 in bags that nothing has reached.
        state = np.maximum([self.pressure[-1], known * self.fullness[-1]], 0)
        return dict(zip((LINKS.pressure.path, LINKS.fullness.path), state, strict=True))

    @property
    def collapse(self) -> str | None:
        """Which links end with too little pressure for a muscle at its limit; None: none do."""
        arm = self.filling.arm
        pressure = self.inflation[LINKS.pressure.path]
        return collapse(pressure, np.asarray(arm.links.diameter), muscle_pull(arm))


def muscle_pull(arm: Arm) -> float:
    """Force of one muscle of an arm at its limit of pressure, N; of a braided one without any."""
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
    """Fill an arm of balloons with helium, until every link is full (fig. 15).

    Arguments:
        filling: arm, gas, ports and supply; those of the paper by default.
        limit: when to give up, s.
        share: gas that is in the bags at the beginning, over what fills them: one number, or one
            for each bag. It counts as supplied.

    Raises:
        InputError: a number that is out of its bounds, or steps that do not come to an end.

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
    """The share of each bag at the beginning, from one number or one for each."""
    given = np.asarray(share, dtype=float)
    if given.shape not in ((), (filling.bags,)):
        raise InputError(
            f"the filled share has the shape {given.shape}, but the arm has {filling.bags} bags: "
            "give one number, or one number for each bag"
        )
    # The integrator leaves traces below 0 in bags that nothing has reached.
    wrong = given[~((given >= -_TOLERANCE) & (given < np.inf))]
    if wrong.size:
        raise InputError(f"a filled share is {wrong[0]:g}: give zero or a positive number")
    return np.broadcast_to(np.maximum(given, 0), filling.bags)


def _tried(
    filling: Filling, limit: float, tolerance: float, share: npt.ArrayLike | None = None
) -> _Course:
    """The gas over time, as far as its steps came."""
    if jnp.result_type(float) == jnp.float32:
        tolerance = max(tolerance, 1e-4)
    empty = np.zeros(filling.bags) if share is None else share
    real = jnp.result_type(float)
    begin, end, close = (jnp.asarray(number, real) for number in (empty, limit, tolerance))
    return _course(filling, begin, end, close, _TIMES)


def check_filling(filling: Filling) -> None:
    """Refuse numbers that are out of bounds.

    Raises:
        InputError: naming the parameter.
    """
    own = {declaration.path for group in (GAS, SKIN, PORTS, SUPPLY) for declaration in group}
    for path, parameter in declared(filling).items():
        if path in own or path.startswith("links.") or path == "air.density":
            for value in np.ravel(np.asarray(parameter.value(filling))).tolist():
                # A bound of 0 is a port without a hole.
                closed = path in own and value <= parameter.declaration.lower
                check_within_bounds(parameter, value, free=closed)


@program
def _states(filling: Filling, found: _Course) -> tuple[Array, Array, Array, Array]:
    """Pressure and fullness of bags, flow of the supply and net lift of links, by time."""
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
# A supply that is a hundred times as strong will not do either.
_FAR = math.log(1e2)
_CLOSE = 1e-6


@dataclasses.dataclass(frozen=True)
class FillingCurve:
    """Pairs of port and supply with which filling takes a given time (s).

    Attributes:
        diameters: of all ports, m, shape (pair,).
        strengths: what the supply must have, SI: the parameter `path`; NaN where no supply will do.
        path: of the supply's parameter: flow, pressure of the regulator, nozzle of the bottle.
        flows: of the supply when it begins, as volume at the pressure of the room, m^3/s.
        pressures: the largest of the first bag above that of the room, Pa.
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
    """The supply for each diameter (m) of the ports with which filling takes a given time (s).

    Arguments:
        filling: arm, gas, ports and supply; all ports are given the same diameter.

    Raises:
        InputError: a number that is out of its bounds, or an arm without ports.
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
        """Where the next one begins, and the pair with its flow and pressure."""
        narrowed = replace(made, {PORTS.diameter.path: float(diameter)})
        check_filling(narrowed)
        found = _strength(narrowed, path, duration, begin)
        if found is None:
            return begin, (diameter, np.nan, np.nan, np.nan)
        end, course = found
        strength = math.exp(end.at)
        pressure, _, flow, _ = map(np.asarray, _states(replace(narrowed, {path: strength}), course))
        return end, (diameter, strength, flow[0], pressure[:, 0].max())

    # From the widest, which needs what ports of no resistance need; then every other one beside
    # the rest, each from where the one before it ended.
    widest, *others = sorted(diameters, reverse=True)
    # What a meter feeds takes a time that is inverse to it.
    first, pair = one(widest, _Slope(math.log(float(get(made, path))), -1.0))

    def chain(tell: Tell, own: Sequence[float]) -> list[tuple[float, ...]]:
        begin, found = first, []
        for diameter in own:
            tell(lambda: None)  # after Ctrl-C no further one begins
            begin, pair = one(diameter, begin)
            found.append(pair)
        tell(lambda: None)
        return found

    jobs = [functools.partial(chain, own=others[k::2]) for k in (0, 1)]
    chains = run_in_threads(jobs, min(2, cores()), until=lambda _: False)
    if None in chains:  # It did not begin.
        raise KeyboardInterrupt
    columns = sorted([pair, *(each for found in chains for each in found or ())])
    pairs = np.asarray(columns).T
    return FillingCurve(duration, pairs[0], pairs[1], path, pairs[2], pairs[3])


class _Slope(NamedTuple):
    """Logarithm of a strength, and how that of the duration changes with it."""

    at: float
    slope: float


def _strength(
    filling: Filling, path: str, duration: float, begin: _Slope
) -> tuple[_Slope, _Course] | None:
    """The strength of the supply with which filling takes this long, and the filling itself.

    None where no strength suffices.

    By the secant in logarithms, kept between what is too little and what is too much.
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
    """Numbers and pictures of a filling, by the names of `FILLING_FILES` and `CURVE_FILES`."""
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
    """The filled arm as a definition: pressure and fullness of each link, and all else of it."""
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
    """A filling as JSON text, without what it was like on the way; what never came is null."""
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
    """Fullness, pressure, lift and stiffness over time."""
    end = f"full after {filled.duration / _MINUTE:.1f} min" if filled.finished else "never full"
    figure = new_figure(9.0, 6.0, f"Filling {filled.filling.arm.count} links: {end}")
    minutes = filled.times / _MINUTE
    panels = {
        "Fullness of each link": (filled.fullness, "share of the full volume"),
        "Pressure in each link": (filled.pressure, "gauge pressure (Pa)"),
        "Net lift of each link": (filled.net_lift * 1e3, "g"),
        "Bending stiffness of each link (assumed)": (filled.stiffness, "N m$^2$"),
    }
    for place, (title, (table, unit)) in enumerate(panels.items(), start=1):
        axes = figure.add_subplot(2, 2, place)
        _curves(axes, minutes, table)
        plain(axes, title, "time (min)", unit)
        if place == 2:
            axes.legend(fontsize=8, frameon=False, loc="upper left")
        if place == 3:
            axes.axhline(0, color=GREY, linewidth=0.8)
            if not np.isnan(filled.arm_lift_off):
                when = filled.arm_lift_off / _MINUTE
                axes.axvline(when, color=INK, linewidth=0.8, linestyle="--")
                low, high = axes.get_ylim()
                axes.set_ylim(low, high + 0.2 * (high - low))
                said, above = f"arm lifts off: {when:.1f} min", high + 0.08 * (high - low)
                small: Any = {"ha": "right", "fontsize": 8}
                axes.annotate(said, (when, above), (-4, 0), textcoords="offset points", **small)
    return figure


def _curves(axes: Axes, minutes: Any, table: Any) -> None:
    """A line for each link, from the base's colour to the tip's."""
    last = table.shape[1] - 1
    named = {0: "link 1 (base)", last: f"link {last + 1} (tip)"} if last else {0: "link 1"}
    for index, row in enumerate(table.T):
        colour = colormaps["viridis"](0.9 * index / max(last, 1))
        axes.plot(minutes, row, color=colour, linewidth=1.1, label=named.get(index))


def curve_figure(curve: FillingCurve) -> Figure:
    """Port against supply, and the pressure that it costs."""
    title = f"Port diameters and supplies for filling within {curve.duration / _MINUTE:g} min"
    figure = new_figure(8.0, 3.4, title)
    diameters = curve.diameters * 1e3
    axes = figure.add_subplot(1, 2, 1)
    axes.plot(curve.flows / _LITRE_PER_MINUTE, diameters, "o-", color=BLUE, ms=4)
    port = "diameter of the ports (mm)"
    plain(axes, "Port diameter against supply", "initial flow of the supply (l/min)", port)
    axes.set_ylim(bottom=0)
    axes = figure.add_subplot(1, 2, 2)
    axes.semilogy(diameters, curve.pressures, "o-", color=VERMILLION, ms=4)
    plain(axes, "Pressure required", port, "largest pressure in the first bag (Pa)")
    axes.tick_params(which="both", labelsize=8)
    return figure
