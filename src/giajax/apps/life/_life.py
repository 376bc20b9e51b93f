"""The phases of an arm's life in one run, and what each of them balances."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...mechanics.arm import STANDARD_GRAVITY, pose
from ...mechanics.inflation import Filling
from ...mechanics.unrolling import Unrolling
from ...runtime.arrays import Array
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema.parameters import replace
from ..filling import LIMIT, muscle_pull
from ..mission import Mission, Outcome, Touched
from ..unrolling import Unrolled, unroll
from ._flight import Audit, audit, check_audited
from ._gas import GasCourse, GasState, Handling, as_one_bag, gas_at, gas_course

RAISING = 60.0
"""Duration of raising and of lowering the arm, s; assumed, and chosen to be slow."""

_TIMES = 101
_TOLERANCE = 1e-7  # of steps of the gas, relative to what fills a bag
_REPEATED = 1e-6  # of steps of the repeated motion
_LET_OUT = 0.01  # of the pressure, where gas no longer flows out by itself

_Numbers = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Balance:
    """A sum that must come to nothing.

    Attributes:
        stored: what was stored meanwhile.
        works: what came in, by where it came from; what went out is negative.
    """

    stored: float
    works: Mapping[str, float]

    @property
    def exchanged(self) -> float:
        """Sum of all that came in or went out, each by its size."""
        return sum(abs(each) for each in self.works.values())

    @property
    def gained(self) -> float:
        """Sum of what came in."""
        return sum(max(each, 0.0) for each in self.works.values())

    @property
    def lost(self) -> float:
        """Sum of what went out."""
        return -sum(min(each, 0.0) for each in self.works.values())

    @property
    def imbalance(self) -> float:
        """What was stored and did not come in."""
        return self.stored - sum(self.works.values())


@dataclasses.dataclass(frozen=True)
class Phase:
    """A part of a life.

    Attributes:
        begin, end: s, on the clock of the whole life.
        fed, let_out: gas from the supply and to the room, kg.
        gas: in the arm at the end, by its pressure and volume, kg.
        pressure: of each link at the end, Pa, shape (link,).
        fullness: volume of each link over that of its tube at the end, shape (link,).
        lift: mass that the arm could carry beside itself at the end, kg.
        margin: least of p pi r^2 of a link over what a muscle pulls with at its limit, at the end,
            N; negative where that link would collapse.
        weakest: the link of that, counted from 1.
        energy: works, J, of which those that are lost are negative, and what was stored.
        touched: what obstacles did; those of the mission alone are known.
    """

    name: str
    begin: float
    end: float
    fed: float
    let_out: float
    gas: float
    pressure: _Numbers
    fullness: _Numbers
    lift: float
    margin: float
    weakest: int
    energy: Balance
    touched: tuple[Touched, ...] = ()

    @property
    def obstacles(self) -> list[str]:
        """Names of the obstacles that links touched."""
        return [each.obstacle for each in self.touched if each.links]


@dataclasses.dataclass(frozen=True)
class Life:
    """An arm that was unrolled, filled, raised, flown and deflated.

    Attributes:
        mission: of the arm with the pressures that it was filled to.
        phases: in their order.
        courses: of the gas, by the phase that each begins with.
        audit: works and impulses along the repeat of the mission.
        pull: of one muscle at its limit, N, that links must hold.
        apart: largest difference of an angle of the repeat from the flight, rad.
    """

    mission: Mission
    unrolled: Unrolled
    outcome: Outcome
    phases: tuple[Phase, ...]
    courses: Mapping[str, GasCourse]
    audit: Audit
    pull: float
    apart: float

    @property
    def duration(self) -> float:
        """How long all took, s."""
        return self.phases[-1].end

    @property
    def helium(self) -> float:
        """Largest difference of gas fed and gas in the arm and let out, over what fills the arm.

        What is in the arm is known by its pressures and volumes.
        """
        fed = np.cumsum([each.fed for each in self.phases])
        out = np.cumsum([each.let_out for each in self.phases])
        held = np.array([each.gas for each in self.phases])
        full = float(np.sum(np.asarray(self.unrolled.unrolling.filling.full_mass)))
        return max(float(np.max(np.abs(fed - out - held))) / full, self.unrolled.imbalance)

    @property
    def energy(self) -> Balance:
        """Of all phases together, J."""
        names = dict.fromkeys(name for each in self.phases for name in each.energy.works)
        works = {
            name: sum(each.energy.works.get(name, 0.0) for each in self.phases) for name in names
        }
        return Balance(sum(each.energy.stored for each in self.phases), works)

    @property
    def momentum(self) -> tuple[_Numbers, Mapping[str, _Numbers]]:
        """Change of the arm's momentum over the mission and the impulses on it, N s, each (3,)."""
        found = self.audit
        impulses = {name: np.asarray(each[-1]) for name, each in found.impulses._asdict().items()}
        return np.asarray(found.momentum[-1] - found.momentum[0]), impulses

    @property
    def momentum_imbalance(self) -> float:
        """Largest part of the momentum that no impulse has changed, over all impulses."""
        changed, impulses = self.momentum
        off = np.max(np.abs(changed - sum(impulses.values())))
        return float(off / sum(float(np.linalg.norm(each)) for each in impulses.values()))

    @property
    def energy_imbalance(self) -> float:
        """Largest imbalance of a phase over what it exchanged; of the whole, too."""
        every = (*(each.energy for each in self.phases), self.energy)
        return max(abs(each.imbalance) / each.exchanged for each in every if each.exchanged)


def live(
    mission: Mission,
    unrolling: Unrolling | None = None,
    *,
    seed: int = 0,
    on_phase: Callable[[str], None] | None = None,
) -> Life:
    """Unroll an arm, fill it until its links hold, raise it, fly a mission, and deflate it.

    Arguments:
        mission: whose arm it is; its pressures are those that it was filled to then.
        unrolling: of that arm; by default as that of `unroll`, whatever the file of the mission
            states (`Unrolling.from_section` reads that).
        seed: as of `Mission.fly`.
        on_phase: is told what begins.

    Raises:
        InputError: as of `unroll`; an unrolling of another arm; one that is never full, or whose
            links never hold a muscle; what is not balanced (`check_audited`); or a motion that
            could not be followed.
    """
    say = on_phase or (lambda _: None)
    arm = mission.model.arm
    made = Unrolling(filling=Filling(arm=arm)) if unrolling is None else unrolling
    if not bool(eqx.tree_equal(made.filling.arm, arm)):
        raise InputError(
            "the unrolling and the mission use different arms: give the unrolling a filling of the "
            "mission's arm, mission.model.arm"
        )
    check_audited(arm)
    say("unrolling and filling")
    unrolled = unroll(made)
    filled = unrolled.filled
    if filled is None or not filled.finished:
        what = "unrolled" if filled is None else "full"
        raise InputError(
            f"the arm is not {what} after {LIMIT / 60:g} min: increase the supply or the hand's "
            "force"
        )
    pull = muscle_pull(arm)
    filling = made.filling
    # Links of one bag have the same share of what fills them.
    share = filled.gas[0] / np.asarray(filling.gas.density * arm.links.volume)
    _, first = np.unique(filling.bag_of_link, return_index=True)
    begin = gas_at(filling, jnp.asarray(share[first]))
    courses = {"fill": _gas("fill", made, begin, feeds=1)}
    courses["feed"] = _gas("feed", made, courses["fill"].end, feeds=1, force=pull)
    if not bool(courses["feed"].reached):
        raise InputError(
            f"the supply never inflates all links enough to bear the {pull:.1f} N pull of one "
            "muscle: give a stronger supply"
        )
    courses["raise"] = _gas("raise", made, courses["feed"].end, settles=1, duration=RAISING)
    settled = courses["raise"]
    row = np.asarray(settled.pressure)[-1:], np.asarray(settled.fullness)[-1:]
    held = dataclasses.replace(filled, pressure=row[0], fullness=row[1])
    flown = mission.with_model(replace(mission.model, held.inflation))
    say("mission")
    outcome = flown.fly(seed)
    if not np.all(np.isfinite(outcome.angles)):
        raise InputError(f"the mission ended early: {outcome.reason}: try another seed")
    say("balances")
    real = jnp.result_type(float)
    interval = jnp.asarray(outcome.times[1] - outcome.times[0], real)
    rows = jnp.asarray(outcome.command), jnp.asarray(outcome.wind)
    found = audit(flown.model.arm, interval, *rows, jnp.asarray(_REPEATED, real))
    if not np.all(np.isfinite(found.energy)):
        raise InputError("the repeated simulation of the mission failed: try another seed")
    say("deflating")
    pressure = float(jnp.max(settled.pressure[-1]))
    vented = _gas("vent", made, settled.end, opens=1, pressure=_LET_OUT * pressure)
    courses["vent"] = vented
    one = as_one_bag(made)
    volumes = filling.volume / jnp.sum(filling.volume)
    rest = gas_at(one.filling, jnp.sum(vented.end.share * volumes)[None])
    # It is pressed out as fast as it was fed.
    area = np.pi / 4 * float(jnp.max(arm.links.diameter)) ** 2
    speed = float(filled.flow[0]) / area
    duration = float(made.length) / speed
    courses["roll up"] = _gas("roll up", one, rest, opens=1, rolls=speed, duration=duration)
    phases = _phases(flown, unrolled, outcome, courses, found, pull)
    apart = float(np.max(np.abs(np.asarray(found.angles) - outcome.angles)))
    return Life(flown, unrolled, outcome, phases, courses, found, pull, apart)


def _gas(phase: str, unrolling: Unrolling, begin: GasState, **what: float) -> GasCourse:
    """The gas in a phase; what is not said is not done.

    Raises:
        InputError: its steps do not come to an end.
    """
    usual = dict.fromkeys(Handling._fields, 0.0) | {
        "force": -1.0,
        "pressure": -1.0,
        "duration": LIMIT,
    }
    real = jnp.result_type(float)
    handling = Handling(**{k: jnp.asarray(v, real) for k, v in (usual | what).items()})
    # As in `fill`, 32 bits resolve less.
    tolerance = jnp.asarray(max(_TOLERANCE, 1e-4 if real == jnp.float32 else 0.0), real)
    found: GasCourse = gas_course(unrolling, handling, begin, tolerance, _TIMES)
    if not bool(found.succeeded):
        raise InputError(
            f"the simulation of the gas failed in the phase '{phase}': make the holes narrower, or "
            "skin_slack larger"
        )
    return found


@program
def _height_work(arm: Any, lifted: Array) -> Array:
    """Work of the lift (kg) of links on the straight arm, J, when it is raised from the level."""
    height = pose(arm, jnp.zeros(arm.count)).centre[2]
    return STANDARD_GRAVITY * jnp.sum(lifted * height)


def _phases(
    mission: Mission,
    unrolled: Unrolled,
    outcome: Outcome,
    courses: Mapping[str, GasCourse],
    found: Audit,
    pull: float,
) -> tuple[Phase, ...]:
    made = unrolled.unrolling
    filling, arm = made.filling, made.filling.arm
    area = np.pi / 4 * np.asarray(arm.links.diameter) ** 2
    phases: list[Phase] = []

    def add(
        name: str,
        duration: float,
        energy: Balance,
        *,
        course: GasCourse | None = None,
        before: GasState | None = None,
        **other: Any,
    ) -> None:
        """A phase after the last one; without a course, the gas stays as it is."""
        begin = phases[-1].end if phases else 0.0
        facts: dict[str, Any] = {"fed": 0.0, "let_out": 0.0, **other}
        if course is not None:
            assert before is not None
            facts |= {
                "fed": float(course.end.fed - before.fed),
                "let_out": float(course.end.let_out - before.let_out),
                "gas": float(course.mass[1]),
                "pressure": np.asarray(course.pressure[-1]),
                "fullness": np.asarray(course.fullness[-1]),
                "lift": float(course.lift[-1]),
            }
        elif "gas" not in facts:
            last = phases[-1]
            facts |= {k: getattr(last, k) for k in ("gas", "pressure", "fullness", "lift")}
        margins = facts["pressure"] * area - pull
        weakest = int(np.argmin(margins))
        facts |= {"margin": float(margins[weakest]), "weakest": weakest + 1}
        phases.append(Phase(name, begin, begin + duration, energy=energy, **facts))

    def gas_energy(course: GasCourse, before: GasState, **more: float) -> Balance:
        works = course.end.works._asdict()
        done = {k: float(v) - float(getattr(before.works, k)) for k, v in works.items()}
        stored = float(course.stored[1] - course.stored[0])
        return Balance(stored + sum(more.values()), done | more)

    energies = np.sum(np.asarray(unrolled.energies), axis=0)
    works = {name: float(each[-1]) for name, each in unrolled.works._asdict().items()}
    for name in ("peel", "loss"):
        works[name] = -works[name]
    start = gas_at(filling, courses["fill"].share[0])
    add(
        "unroll",
        unrolled.handed_over,
        Balance(float(energies[-1] - energies[0]), works),
        fed=float(unrolled.gas[-1]),
        gas=float(courses["fill"].mass[0]),
        pressure=np.asarray(courses["fill"].pressure[0]),
        fullness=np.asarray(courses["fill"].fullness[0]),
        lift=float(courses["fill"].lift[0]),
    )
    before = start
    for name in ("fill", "feed"):
        course = courses[name]
        add(name, float(course.times[-1]), gas_energy(course, before), course=course, before=before)
        before = course.end
    course = courses["raise"]
    here = filling.bag_of_link
    displaced = arm.air.density * course.fullness[-1]
    lifted = displaced - filling.gas.density * course.share[-1][here]
    risen = float(_height_work(arm, lifted * arm.links.volume - filling.borne_mass))
    # Slowly: whoever holds the arm takes what its lift does.
    raised = gas_energy(course, before)
    holding = {"raising": -risen}
    raised = Balance(raised.stored - risen, dict(raised.works) | holding)
    add("raise", RAISING, raised, course=course, before=before)
    audited = {name: float(each[-1]) for name, each in found.works._asdict().items()}
    flight = Balance(float(found.energy[-1] - found.energy[0]), audited)
    add("mission", float(outcome.times[-1]), flight, touched=outcome.touched)
    # What the joints still hold is let go, and the arm comes down as it went up.
    given_up = float(found.energy[-1] - found.energy[0])
    lowered = Balance(risen - given_up, {"raising": risen, "let go": -given_up})
    add("lower", RAISING, lowered)
    vented, before = courses["vent"], course.end
    add("vent", float(vented.times[-1]), gas_energy(vented, before), course=vented, before=before)
    rolled = courses["roll up"]
    rest = gas_at(as_one_bag(made).filling, rolled.share[0])
    # With open ports, links come to one pressure first.
    mixed = float(rolled.stored[0] - vented.stored[1])
    balance = gas_energy(rolled, rest)
    ports = {"ports": balance.works["ports"] + mixed}
    balance = Balance(balance.stored + mixed, dict(balance.works) | ports)
    add("roll up", float(rolled.times[-1]), balance, course=rolled, before=rest)
    return tuple(phases)
