"""Mission of an arm: its controller, the opening to enter, its simulation and its outcome."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from ...mechanics.arm import Arm, link_centres, tip_position, touch, touched
from ...models import ArmModel, Pinhole, parameter_values
from ...recordings import Definition, Run
from ...runtime.arrays import Array, Bool, Float, Int, Scalar
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import MissionSection
from ...schema.parameters import present_path, replace
from ...simulation import Moment, Stepper, Trajectory
from ..synthetic import command_columns, driven_run, gusts, logged_motion
from ._controller import AbstractController, Opening, Picture, Scene, opening_of
from ._operator import Operator
from ._steer import Steering

_WIND_INTERVAL = 1.0  # interval of the rows of the gusts, s; the wind is interpolated linearly


def air(
    section: MissionSection, arm: Arm, times: Float[np.ndarray, " row"], seed: list[int]
) -> Float[np.ndarray, "row width"]:
    """Return the velocity of the air at each link, m/s, shape (row, 3 link).

    The wind is a horizontal mean flow in a random direction with gusts. The coherence of the gusts
    is that along the straight arm. The root mean square of the velocity is the wind speed of the
    mission.

    Arguments:
        section: mission with its wind.
        arm: arm whose links are exposed to the wind.
        times: times of the rows, s.
        seed: seed of the random numbers.
    """
    wind = section.wind
    if wind.speed_m_per_s == 0:
        return np.zeros((len(times), 3 * arm.count))
    random = np.random.default_rng(seed)
    turn = random.uniform(0, 2 * np.pi)
    mean = wind.mean * wind.speed_m_per_s
    if wind.mean == 1:
        steady = mean * np.array([np.cos(turn), np.sin(turn), 0.0])
        return np.tile(steady, (len(times), arm.count))
    drive = gusts(
        [mean * np.cos(turn), mean * np.sin(turn), 0.0],
        intensity=np.sqrt((1 / wind.mean**2 - 1) / 3),
        length_scale=wind.length_scale_m,
        duration=times[-1] + _WIND_INTERVAL,
        interval=_WIND_INTERVAL,
        seed=int(random.integers(2**31)),
        places=np.asarray(link_centres(arm, jnp.zeros(arm.count))),
    )
    return np.stack(list(drive.at(times).values()), axis=1)


class Rows(NamedTuple):
    """Rows of a simulated mission; attributes that are not listed here are as in `Outcome`.

    Attributes:
        time: time, s.
        state: state of the joints and of the contacts, as in `Moment`.
        pressing: contact force of obstacles on each link, N.
        inside: time for which the tip has been inside the opening, s.
    """

    time: Float[Array, " row"]
    state: Float[Array, "row part joint"]
    command: Float[Array, "row joint"]
    tip: Float[Array, "row 3"]
    believed: Float[Array, "row 3"]
    corners: Int[Array, " row"]
    pressing: Float[Array, "row link"]
    inside: Float[Array, " row"]


class Task(NamedTuple):
    """Criterion of success of a mission, and tolerance of its simulation.

    Attributes:
        beyond: depth behind the outer face from which on the tip counts as inside the opening, m.
        hold: time for which the tip must be inside the opening, s.
        tolerance: tolerance of the integration, as in `Stepper`.
    """

    beyond: Scalar
    hold: Scalar
    tolerance: Scalar


class _Now(NamedTuple):
    """Current state of a mission.

    Attributes:
        moment: current state of the arm.
        pictures: pictures that have not arrived yet, the oldest first.
        memory: memory of the controller.
        inside: time for which the tip has been inside the opening, s.
    """

    moment: Moment
    pictures: Picture
    memory: Any
    inside: Scalar


@program
def flight(
    arm: Arm,
    scene: Scene,
    controller: AbstractController,
    task: Task,
    wind: Float[Array, "row width"],
    error: Float[Array, "row 4 2"],
    late: int,
) -> Rows:
    """Simulate a mission until its end; later rows repeat the last one.

    Arguments:
        arm: simulated arm.
        scene: information that the controller has.
        controller: controller of the arm.
        task: criterion of success, and tolerance.
        wind: velocity of the air at the links at the ends of the intervals, m/s.
        error: error of each corner in the picture of each interval, px; NaN for a lost picture.
        late: delay of the pictures, in intervals.
    """
    _, camera, opening, interval = scene
    stepper = Stepper(arm, interval, tolerance=task.tolerance)

    def is_inside(angles: Array) -> Bool[Array, ""]:
        local = opening.local(tip_position(arm, angles))
        return (local[0] < -task.beyond) & (opening.beside(local) == 0)

    def picture(moment: Moment, error: Array) -> Picture:
        view = camera.view(arm, moment.angles)
        found = camera.project_from(view, opening.corners)
        # The outer face is hidden from behind the wall.
        seen = camera.sees(found) & (opening.local(view.centre)[0] > 0)
        # A lost picture shows neither the corners nor the room.
        there = jnp.all(jnp.isfinite(error))
        pixels = jnp.where(there, found.pixels + error, 0)
        inside = there & is_inside(moment.angles)
        return Picture(pixels, seen & there, inside, moment.command)

    def advanced(now: _Now, blowing: Array, error: Array) -> _Now:
        newest = picture(now.moment, error)
        pictures = jax.tree.map(
            lambda queue, last: jnp.concatenate([queue[1:], last[None]]), now.pictures, newest
        )
        shown = jax.tree.map(lambda queue: queue[0], pictures)
        memory, command = controller.decide(scene, now.memory, shown, now.moment.command)
        moment = stepper.advance(now.moment, command, blowing)
        inside = jnp.where(is_inside(moment.angles), now.inside + interval, 0)
        return _Now(moment, pictures, memory, inside)

    def row(now: _Now, given: tuple[Array, Array]) -> tuple[_Now, Rows]:
        # Stop after a failed integration, which would be repeated with ever shorter steps.
        lost = ~jnp.all(jnp.isfinite(now.moment.state))
        done = (now.inside >= task.hold) | lost
        now = jax.lax.cond(done, lambda: now, lambda: advanced(now, *given))
        moment, state = now.moment, now.moment.state
        pressed = jnp.zeros_like(moment.angles)
        if arm.contact is not None:
            skin = state[-arm.contact.rows :] if arm.contact.rows else None
            pressed = touch(arm, moment.angles, moment.rates, skin).normal
        return now, Rows(
            time=moment.time,
            state=state,
            command=moment.command,
            tip=tip_position(arm, moment.angles),
            believed=controller.believed(scene, now.memory),
            corners=jnp.sum(now.pictures.seen[-1]),
            pressing=pressed,
            inside=now.inside,
        )

    moment = stepper.start(wind=wind[0])
    first = picture(moment, jnp.zeros_like(error[0]))
    # Before the first picture arrives, no corners are visible.
    none = first._replace(seen=jnp.zeros_like(first.seen), room=jnp.zeros_like(first.room))
    waiting = jax.tree.map(lambda x: jnp.broadcast_to(x, (late + 1, *x.shape)), none)
    now = _Now(moment, waiting, controller.start(scene, late), jnp.zeros_like(interval))
    return jax.lax.scan(row, now, (wind[1:], error))[1]


_CHUNK = 64  # number of rows whose contacts are computed at once


@dataclasses.dataclass(frozen=True)
class Touched:
    """Contact of the arm with an obstacle.

    Attributes:
        obstacle: name of the obstacle.
        links: numbers of the links that touched it.
        duration: total time with contact, s.
        flattening: largest flattening of a link, m.
        force: largest force on a link, N.
        impulse: time integral of the magnitudes of the forces on all links, N s.
    """

    obstacle: str
    links: tuple[int, ...]
    duration: float
    flattening: float
    force: float
    impulse: float


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Outcome of a mission.

    Attributes:
        reached: time from which on the tip was inside the opening, s; None if it was not, or not
            long enough.
        reason: reason of the failure; empty if the mission succeeded.
        nearest: smallest distance of the tip from the middle of the opening, m.
        touched: contacts with each obstacle.
        times: times of the rows below, s, from 0 until the end of the mission.
        angles: angles of the joints, rad.
        rates: rates of the joints, rad/s.
        command: commanded angles, rad.
        wind: velocity of the air at the links, m/s.
        tip, believed: position of the tip, and position of the camera estimated by the
            controller, m.
        corners: number of corners of the opening in the picture.
    """

    reached: float | None
    reason: str
    nearest: float
    touched: tuple[Touched, ...]
    times: Float[np.ndarray, " row"]
    angles: Float[np.ndarray, "row joint"]
    rates: Float[np.ndarray, "row joint"]
    command: Float[np.ndarray, "row joint"]
    wind: Float[np.ndarray, "row width"]
    tip: Float[np.ndarray, "row 3"]
    believed: Float[np.ndarray, "row 3"]
    corners: Float[np.ndarray, " row"]

    @property
    def flattening(self) -> float:
        """Largest flattening of a link, m."""
        return max((each.flattening for each in self.touched), default=0.0)

    @property
    def station(self) -> Float[np.ndarray, "3"]:
        """Mean position of the tip in the second half of the mission, m."""
        return self.tip[len(self.tip) // 2 :].mean(axis=0)

    @property
    def swing(self) -> float:
        """RMS distance of the tip from its mean position in the second half of the mission, m."""
        away = self.tip[len(self.tip) // 2 :] - self.station
        return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


_tip = program(tip_position)


def outcome_of(mission: "Mission", rows: Rows, wind: Float[np.ndarray, "row width"]) -> Outcome:
    """Return the outcome of a mission from its rows and its wind."""
    table: Rows = jax.tree.map(np.asarray, rows)
    held = (table.inside >= mission.section.hold_s) & mission.enters
    end = int(np.argmax(held)) + 1 if held.any() else len(held)
    table = jax.tree.map(lambda each: each[:end], table)
    arm = mission.model.arm
    begun = np.asarray(_tip(arm, jnp.zeros(arm.count)))
    reached = float(mission.times[end] - table.inside[-1]) if held.any() else None
    sound = np.all(np.isfinite(table.state), axis=(1, 2))
    local = np.asarray(mission.opening.local(jnp.asarray(table.tip)))
    gap = np.linalg.norm(local, axis=1)[sound]
    nearest = float(gap.min()) if gap.size else np.nan
    reason = "" if reached is not None else _reason(table, bool(sound.all()), nearest)
    stops = mission.section.camera_stops_s
    fails = reached is None and sound.all()
    if fails and not mission.enters:
        reason = "the mission was only to hold the tip in front of the opening"
    elif fails and stops is not None and not np.any(table.inside[table.time <= stops] > 0):
        reason = "the camera stopped before the tip was inside the opening"
    return Outcome(
        reached=reached,
        reason=reason,
        nearest=nearest,
        touched=_touched(arm, table),
        times=mission.times[: end + 1],
        angles=_from_rest(table.state[:, 0]),
        rates=_from_rest(table.state[:, 1]),
        command=_from_rest(table.command),
        wind=wind[: end + 1],
        tip=_from_rest(table.tip, begun),
        believed=_from_rest(table.believed, begun),
        corners=_from_rest(table.corners),
    )


def _from_rest(rows: Any, first: np.ndarray | float = 0.0) -> np.ndarray:
    """Return rows preceded by a row of the straight arm at rest."""
    return np.concatenate([np.broadcast_to(first, rows[:1].shape).astype(rows.dtype), rows])


def _reason(rows: Rows, sound: bool, nearest: float) -> str:
    """Return the reason of a failure, in words that can be counted over many missions."""
    if not sound:
        return "the simulation of the motion failed"
    if not np.any(rows.corners >= 2):
        return "the opening never came into view"
    if np.any(rows.inside > 0):
        return "the tip entered the opening, but did not stay inside it"
    if nearest > 1.5:
        return "the tip did not reach the opening"
    return "the tip came close to the opening, but did not enter it"


def _touched(arm: Arm, rows: Rows) -> tuple[Touched, ...]:
    """Return the contacts with each obstacle, from the rows with contact forces."""
    if arm.contact is None:
        return ()
    when = np.flatnonzero(np.any(rows.pressing > 0, axis=1))
    names = [each.name for each in arm.contact.obstacles]
    deep = np.zeros((len(when), arm.count, len(names)))
    force = np.zeros_like(deep)
    for first in range(0, len(when), _CHUNK):
        some = when[first : first + _CHUNK]
        # Pad to one size, so that only one program is compiled.
        padded = np.resize(some, _CHUNK)
        flat, push = _contacts(arm, jnp.asarray(rows.state[padded]))
        deep[first : first + len(some)] = np.asarray(flat)[: len(some)]
        force[first : first + len(some)] = np.linalg.norm(push, axis=-1)[: len(some)]
    interval = float(rows.time[1] - rows.time[0]) if len(rows.time) > 1 else 0.0
    return tuple(
        Touched(
            obstacle=name,
            links=tuple((np.flatnonzero(deep[:, :, k].any(axis=0)) + 1).tolist()),
            duration=interval * int(deep[:, :, k].any(axis=1).sum()),
            flattening=float(deep[:, :, k].max(initial=0.0)),
            force=float(force[:, :, k].max(initial=0.0)),
            impulse=interval * float(force[:, :, k].sum()),
        )
        for k, name in enumerate(names)
    )


@program
def _contacts(arm: Arm, states: Float[Array, "row part joint"]) -> tuple[Array, Array]:
    assert arm.contact is not None
    rows = arm.contact.rows
    return jax.vmap(lambda x: touched(arm, x[0], x[1], x[-rows:] if rows else None))(states)


# Interval between two decisions of the controller, s, and tolerance of the integration.
_INTERVAL, _TOLERANCE = 0.1, 1e-3


CONTROLLERS: dict[str, Callable[[MissionSection, ArmModel], AbstractController]] = {
    "operator": lambda section, model: Operator.from_section(section, model.arm.count),
    "mpc": Steering.from_section,
}
"""Names of the controllers that can drive the arm."""


@dataclasses.dataclass(frozen=True)
class Mission:
    """Mission to bring the tip of an arm into an opening, or to hold it in front of the opening.

    Attributes:
        model: model of the arm, with its obstacles and its cameras.
        section: `[mission]` table of the file.
        opening: opening to enter.
        camera: camera at the tip.
        controller: controller of the arm.
        driver: name of the controller in files.
        enters: whether the tip enters the opening; if False, it stays in front of the opening.
    """

    model: ArmModel
    section: MissionSection
    opening: Opening
    camera: Pinhole
    controller: AbstractController
    driver: str
    enters: bool = True

    @classmethod
    def from_definition(
        cls,
        definition: Definition,
        source: str = "the file",
        *,
        controller: str = "operator",
        model: ArmModel | None = None,
    ) -> Self:
        """Return the mission of a file.

        Arguments:
            definition: content of the file.
            source: name of the file in messages.
            controller: one of `CONTROLLERS`.
            model: model of the nominal arm, instead of the one in the file.

        Raises:
            InputError: the file has no `[mission]`, no opening, or no camera at the tip; the arm is
                too short, or cannot be tracked by mpc; or the controller is unknown.
        """
        if controller not in CONTROLLERS:
            known = ", ".join(CONTROLLERS)
            raise InputError(f"the controller is '{controller}': give one of {known}")
        section = definition.mission
        if section is None:
            raise InputError(
                f"{source} has no [mission]: add one ('giajax mission --help' shows an example)"
            )
        model = ArmModel.stated_in(definition) if model is None else model
        opening = opening_of(model.arm, section.opening)
        pinholes = model.sensors.camera.pinholes
        lenses = {name: lens for name, lens in pinholes.items() if lens.mount == "tip"}
        name = section.camera
        if name is None and len(lenses) != 1:
            many = f"{len(lenses)} cameras" if lenses else "no camera"
            raise InputError(
                f'the tip carries {many}: give one [camera.NAME] with mount = "tip", or select '
                "one with mission.camera"
            )
        if name is not None and name not in lenses:
            raise InputError(
                f"mission.camera = '{name}' is not a camera at the tip: correct the name"
            )
        camera = next(iter(lenses.values())) if name is None else lenses[name]
        far = float(np.linalg.norm(np.asarray(opening.centre)))
        reach = float(np.sum(np.asarray(model.arm.links.length)))
        if far > reach:
            raise InputError(
                f"the opening is {far:.1f} m from the base, but the arm is only {reach:.1f} m "
                "long: give a longer arm, or a nearer opening"
            )
        return cls(
            model, section, opening, camera, CONTROLLERS[controller](section, model), controller
        )

    def keeping_station(self, seconds: float) -> Self:
        """Return a mission that holds the tip in front of the opening, at the stand-off.

        Arguments:
            seconds: duration of the mission, s.

        Raises:
            InputError: the controller cannot hold a position.
        """
        stays = self.controller.keeping_station()
        section = self.section.model_copy(update={"limit_s": seconds})
        return dataclasses.replace(self, section=section, controller=stays, enters=False)

    def case(self, seed: int) -> Self:
        """Return the mission with another arm, with random parameters from `[mission.spread]`."""
        stated = self.section.spread or {}
        spread = {present_path(self.model, path): of for path, of in stated.items()}
        values = parameter_values(self.model)
        unknown = next((path for path in spread if path not in values), None)
        if unknown is not None:
            raise InputError(
                f"mission.spread contains '{unknown}', which is not a parameter of this arm: "
                "remove it"
            )
        random = np.random.default_rng([seed, 1])
        drawn = {
            path: np.asarray(values[path]) * np.exp(deviation * random.normal())
            for path, deviation in spread.items()
        }
        return dataclasses.replace(self, model=replace(self.model, drawn))

    def driven_by(self, controller: AbstractController) -> Self:
        """Return the mission with another controller; its name in files is that of its class."""
        return dataclasses.replace(self, controller=controller, driver=type(controller).__name__)

    def with_model(self, model: ArmModel) -> Self:
        """Return the mission with another model of the arm and its sensors."""
        return dataclasses.replace(self, model=model)

    def in_wind(self, speed: float) -> Self:
        """Return the mission at another wind speed, m/s."""
        wind = self.section.wind.model_copy(update={"speed_m_per_s": speed})
        return dataclasses.replace(self, section=self.section.model_copy(update={"wind": wind}))

    def wind(self, seed: int) -> Float[np.ndarray, "row width"]:
        """Return the velocity of the air at the links versus time, m/s."""
        return air(self.section, self.model.arm, self.times, [seed, 2])

    @property
    def times(self) -> Float[np.ndarray, " row"]:
        """Times of the decisions, s."""
        return np.arange(round(self.section.limit_s / _INTERVAL) + 1) * _INTERVAL

    def fly(self, seed: int = 0, *, drawn: "Mission | None" = None) -> Outcome:
        """Simulate the mission once.

        Arguments:
            seed: seed of the wind and of the errors of the picture.
            drawn: mission with the nominal arm that the operator assumes; defaults to this mission.
                The nominal arm of mpc is the arm from which that controller was created.
        """
        section, arm = self.section, self.model.arm
        wind = self.wind(seed)
        random = np.random.default_rng([seed, 3])
        error = section.operator.pixel_px * random.normal(size=(len(wind) - 1, 4, 2))
        if section.camera_stops_s is not None:
            error[self.times[:-1] >= section.camera_stops_s] = np.nan
        # A mission that holds the tip in front of the opening does not end when the tip enters it.
        numbers = (section.beyond_m, section.hold_s if self.enters else np.inf, _TOLERANCE)
        known = (self if drawn is None else drawn).model.arm
        rows = flight(
            arm,
            Scene(known, self.camera, self.opening, jnp.asarray(_INTERVAL, jnp.result_type(float))),
            self.controller,
            Task(*jnp.asarray(numbers, jnp.result_type(float))),
            jnp.asarray(wind),
            jnp.asarray(error),
            round(section.operator.latency_s / _INTERVAL),
        )
        return outcome_of(self, rows, wind)


def motion(mission: Mission, outcome: Outcome) -> Trajectory:
    """Return the motion of the arm, up to a failure of the simulation if there was one."""
    sound = int(np.sum(np.cumprod(np.all(np.isfinite(outcome.angles), axis=1))))
    rows = (outcome.times, outcome.angles, outcome.rates, outcome.command, outcome.wind)
    return logged_motion(mission.model.arm, *(each[:sound] for each in rows))


def recorded(mission: Mission, outcome: Outcome, *, name: str, origin: str = "") -> Run:
    """Return a mission as a run, which `giajax view` plays and `giajax fit` reads.

    Arguments:
        mission: mission that was simulated.
        outcome: outcome of the mission.
        name: name of the run.
        origin: origin of the data, for the sidecar.
    """
    values = command_columns(outcome.command)
    if np.any(outcome.wind):
        links = range(1, mission.model.arm.count + 1)
        names = [f"link{link:02d}_wind_{axis}" for link in links for axis in "xyz"]
        values |= dict(zip(names, outcome.wind.T, strict=True))
    values |= dict(zip(("tip_x", "tip_y", "tip_z"), outcome.tip.T, strict=True))
    return driven_run(mission.model, outcome.times, values, name=name, origin=origin)
