"""Simulation of all phases of the life cycle of an arm, with their balances."""

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
"""Assumed duration of raising and of lowering the arm, s, chosen to be slow."""

_TIMES = 101
_TOLERANCE = 1e-7  # tolerance of the gas, relative to the gas that fills a bag
_REPEATED = 1e-6  # tolerance of the repeated motion
_LET_OUT = 0.01  # fraction of the pressure at which the venting ends

_Numbers = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Balance:
    """Energy balance: the stored energy must equal the sum of the works.

    Attributes:
        stored: change of the stored energy, J.
        works: energy gained from each source, J; losses are negative.
    """

    stored: float
    works: Mapping[str, float]

    @property
    def exchanged(self) -> float:
        """Sum of the magnitudes of all works, J."""
        return sum(abs(each) for each in self.works.values())

    @property
    def gained(self) -> float:
        """Sum of the positive works, J."""
        return sum(max(each, 0.0) for each in self.works.values())

    @property
    def lost(self) -> float:
        """Magnitude of the sum of the negative works, J."""
        return -sum(min(each, 0.0) for each in self.works.values())

    @property
    def imbalance(self) -> float:
        """Change of the stored energy minus the sum of the works, J."""
        return self.stored - sum(self.works.values())


@dataclasses.dataclass(frozen=True)
class Phase:
    """Phase of a life cycle.

    Attributes:
        name: name of the phase.
        begin, end: times on the clock of the whole life cycle, s.
        fed, let_out: mass of gas from the supply and to the room, kg.
        gas: mass of gas in the arm at the end, computed from pressures and volumes, kg.
        pressure: gauge pressure of each link at the end, Pa, shape (link,).
        fullness: volume of each link divided by that of its tube at the end, shape (link,).
        lift: additional mass that the buoyancy of the arm could carry at the end, kg.
        margin: smallest difference between p pi r^2 of a link and the largest pull of a muscle at
            the end, N; if negative, the link would collapse.
        weakest: number of the link with the smallest margin, counted from 1.
        energy: energy balance of the phase, J.
        touched: contacts with each obstacle; only known for the mission.
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
        """Names of the obstacles that the arm touched."""
        return [each.obstacle for each in self.touched if each.links]


@dataclasses.dataclass(frozen=True)
class Life:
    """Results of a life cycle of an arm.

    Attributes:
        mission: mission of the arm at the pressures to which it was filled.
        unrolled: simulation of the unrolling.
        outcome: outcome of the mission.
        phases: phases in order of time.
        courses: gas versus time, by the name of the phase.
        audit: works and impulses of the repeated simulation of the mission.
        pull: largest pull of one muscle, N, which the links must bear.
        apart: largest difference between the angles of the flight and of its repetition, rad.
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
        """Duration of all phases, s."""
        return self.phases[-1].end

    @property
    def helium(self) -> float:
        """Largest imbalance of the gas, relative to the gas that fills the arm.

        The imbalance is the difference between the gas that was fed and the sum of the gas in the
        arm and the gas that was let out. The gas in the arm is computed from pressures and volumes.
        """
        fed = np.cumsum([each.fed for each in self.phases])
        out = np.cumsum([each.let_out for each in self.phases])
        held = np.array([each.gas for each in self.phases])
        full = float(np.sum(np.asarray(self.unrolled.unrolling.filling.full_mass)))
        return max(float(np.max(np.abs(fed - out - held))) / full, self.unrolled.imbalance)

    @property
    def energy(self) -> Balance:
        """Energy balance of all phases together, J."""
        names = dict.fromkeys(name for each in self.phases for name in each.energy.works)
        works = {
            name: sum(each.energy.works.get(name, 0.0) for each in self.phases) for name in names
        }
        return Balance(sum(each.energy.stored for each in self.phases), works)

    @property
    def momentum(self) -> tuple[_Numbers, Mapping[str, _Numbers]]:
        """Change of momentum in the mission, and impulses on the arm, N s, each of shape (3,)."""
        found = self.audit
        impulses = {name: np.asarray(each[-1]) for name, each in found.impulses._asdict().items()}
        return np.asarray(found.momentum[-1] - found.momentum[0]), impulses

    @property
    def momentum_imbalance(self) -> float:
        """Largest unexplained component of the change of momentum, relative to all impulses."""
        changed, impulses = self.momentum
        off = np.max(np.abs(changed - sum(impulses.values())))
        return float(off / sum(float(np.linalg.norm(each)) for each in impulses.values()))

    @property
    def energy_imbalance(self) -> float:
        """Largest relative energy imbalance of a phase or of the whole life cycle.

        It is relative to the sum of the magnitudes of the works.
        """
        every = (*(each.energy for each in self.phases), self.energy)
        return max(abs(each.imbalance) / each.exchanged for each in every if each.exchanged)


def live(
    mission: Mission,
    unrolling: Unrolling | None = None,
    *,
    seed: int = 0,
    on_phase: Callable[[str], None] | None = None,
) -> Life:
    """Unroll, fill and raise an arm, fly a mission, and deflate the arm.

    The arm is filled until each link can bear the pull of a muscle.

    Arguments:
        mission: mission of the arm, which is flown with the pressures from the filling.
        unrolling: unrolling of the arm; by default with the default values of `unroll`, even if the
            file of the mission gives others (`Unrolling.from_section` reads those).
        seed: seed, as in `Mission.fly`.
        on_phase: function that is called with the name of each phase at its start.

    Raises:
        InputError: as in `unroll`; the unrolling is of another arm; the arm is never full, or its
            links never bear the pull of a muscle; an effect is not part of the balances
            (`check_audited`); or the simulation of the motion failed.
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
    # All links of one bag have the same share of the gas that fills them.
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
    # Roll up at the speed at which the gas is pressed out as fast as it was fed.
    area = np.pi / 4 * float(jnp.max(arm.links.diameter)) ** 2
    speed = float(filled.flow[0]) / area
    duration = float(made.length) / speed
    courses["roll up"] = _gas("roll up", one, rest, opens=1, rolls=speed, duration=duration)
    phases = _phases(flown, unrolled, outcome, courses, found, pull)
    apart = float(np.max(np.abs(np.asarray(found.angles) - outcome.angles)))
    return Life(flown, unrolled, outcome, phases, courses, found, pull, apart)


def _gas(phase: str, unrolling: Unrolling, begin: GasState, **what: float) -> GasCourse:
    """Simulate the gas in a phase; `what` gives the attributes of `Handling` that are used.

    Raises:
        InputError: the integration failed.
    """
    usual = dict.fromkeys(Handling._fields, 0.0) | {
        "force": -1.0,
        "pressure": -1.0,
        "duration": LIMIT,
    }
    real = jnp.result_type(float)
    handling = Handling(**{k: jnp.asarray(v, real) for k, v in (usual | what).items()})
    # Single precision does not resolve smaller tolerances, as in `fill`.
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
    """Return the work of the net lift of links, kg, when the straight arm is raised, J."""
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
        """Add a phase after the last one; without a course, the gas does not change."""
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
    # The arm is raised slowly, so the person who holds it absorbs the work of the lift.
    raised = gas_energy(course, before)
    holding = {"raising": -risen}
    raised = Balance(raised.stored - risen, dict(raised.works) | holding)
    add("raise", RAISING, raised, course=course, before=before)
    audited = {name: float(each[-1]) for name, each in found.works._asdict().items()}
    flight = Balance(float(found.energy[-1] - found.energy[0]), audited)
    add("mission", float(outcome.times[-1]), flight, touched=outcome.touched)
    # The energy stored in the joints is released, and the arm is lowered as it was raised.
    given_up = float(found.energy[-1] - found.energy[0])
    lowered = Balance(risen - given_up, {"raising": risen, "let go": -given_up})
    add("lower", RAISING, lowered)
    vented, before = courses["vent"], course.end
    add("vent", float(vented.times[-1]), gas_energy(vented, before), course=vented, before=before)
    rolled = courses["roll up"]
    rest = gas_at(as_one_bag(made).filling, rolled.share[0])
    # The links first reach one pressure through the open ports; the ports lose this energy.
    mixed = float(rolled.stored[0] - vented.stored[1])
    balance = gas_energy(rolled, rest)
    ports = {"ports": balance.works["ports"] + mixed}
    balance = Balance(balance.stored + mixed, dict(balance.works) | ports)
    add("roll up", float(rolled.times[-1]), balance, course=rolled, before=rest)
    return tuple(phases)
