"""The paper's experiment with one link (section IV.A, fig. 12), on a simulated joint.

The joint is recorded while it follows commands; from the recording two compensations are made,
eq. (12) and the inverse of a modified Prandtl-Ishlinskii operator; and each is judged by how far
the joint is from its target, on the paper's own history and on another one.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...fitting import FitResult, fit
from ...mechanics.hysteresis import BoucWen, Preisach
from ...models import model_for
from ...recordings import Run
from ..control import compensator_for_loop, compensator_for_model

Degrees = npt.NDArray[np.float64]

# Within this angle a command is held for longer.
_SLOW = 30.0
_SLOW_SECONDS, _SECONDS = 20.0, 5.0

_OTHER = (0, 45, -35, 30, -20, 50, 10, 40, -10, 20, -50, -5, -30, 15, 0)
PAPER = (0, 60, -60, 0)  # turns of the paper's history, deg; of the preparatory movement, too


@dataclass(frozen=True)
class History:
    """Target angles one degree apart, and when the joint has come to rest and is measured, s.

    Attributes:
        measured: which samples are measured, after the preparatory movement.
    """

    name: str
    times: npt.NDArray[np.float64]
    target: Degrees
    measured: npt.NDArray[np.bool_]


def history(name: str, turns: Sequence[float]) -> History:
    """The paper's preparatory movement, then from turn to turn (deg) by 1 deg.

    A step takes 5 s, and 20 s where the command is within 30 deg of 0.
    """
    before = _steps(PAPER)
    target = np.concatenate([before, _steps(turns)[1:]])
    held = np.where(np.abs(target) <= _SLOW, _SLOW_SECONDS, _SECONDS)
    return History(name, np.cumsum(held), target, np.arange(len(target)) >= len(before) - 1)


def _steps(turns: Sequence[float]) -> Degrees:
    pieces = [np.linspace(a, b, round(abs(b - a)) + 1)[1:] for a, b in itertools.pairwise(turns)]
    return np.concatenate([[turns[0]], *pieces]).astype(float)


def paper_history() -> History:
    """0, 60, -60, 0 deg, after the same as a preparation."""
    return history("paper", PAPER)


def other_history() -> History:
    """Other amplitudes and minor loops, which nothing is identified on."""
    return history("other", _OTHER)


# A simulated 1-link arm that stands for the paper's prototype of section IV.A.
#
# It is made of other parts than what is fitted to it: Preisach hysteresis of the film, Bouc-Wen
# hysteresis of the muscles, and a joint that snaps through about 0 deg.

RANGE = 60.0


@dataclass(frozen=True)
class SimulatedJoint:
    """Angle of a joint by its command, both in degrees, at rest after each step.

    The command, through the hysteresis of film and muscles, gives a drive x. The angle is
    x + gap exp(-x / decay) on the positive side, and the mirror image of that on the negative one.
    Within the gap about 0 the stiffness is negative and the joint does not stay: it snaps through
    when the drive goes beyond the snap. So it is soft about 0, and follows further out.

    Attributes:
        gap: angles on the positive and the negative side where the joint does not stay, deg.
        decay, snap: drives, deg.
        film: share of the film in the drive; `film_width`, `film_spread` and `film_scatter` are
            half-width (deg), spread and centre spread (deg) of its Preisach density.
        muscle: share of the muscles' hysteresis in the drive.
        muscle_travel: command (deg) within which a muscle goes from one branch to the other.
        pressure_noise: standard deviation of the drive from step to step, deg.
        inclination: of the camera, added to every measured angle, deg.
        marker_noise, marker_distance: deviation of a marker's position, and between the two, m.
    """

    gap: tuple[float, float] = (12.6, 12.3)
    decay: float = 30.0
    snap: float = 0.3
    film: float = 0.95
    film_width: float = 14.0
    film_spread: float = 0.6
    film_scatter: float = 40.0
    muscle: float = 0.04
    muscle_travel: float = 8.0
    pressure_noise: float = 0.05
    inclination: float = 1.5
    marker_noise: float = 0.001
    marker_distance: float = 0.4
    seed: int = 0

    def drive(self, commands: npt.ArrayLike) -> Degrees:
        """Command after the hysteresis of film and muscles, deg, shape (sample,)."""
        u = jnp.asarray(np.asarray(commands, dtype=float) / RANGE)
        film = Preisach(
            slope=jnp.asarray(0.0),
            saturation=jnp.asarray(1.0),
            coercivity=jnp.asarray(self.film_width / RANGE),
            coercivity_spread=jnp.asarray(self.film_spread),
            bias=jnp.asarray(0.0),
            interaction=jnp.asarray(self.film_scatter / RANGE),
            extent=1.1,
            rows=60,
        )
        rate = RANGE / self.muscle_travel
        muscle = BoucWen(
            elastic=jnp.asarray(0.0),
            alpha=jnp.asarray(rate),
            beta=jnp.asarray(rate),
            gamma=jnp.asarray(0.8),
            delta=jnp.asarray(0.2),
            nu=jnp.asarray(1.0),
        )
        elastic = 1 - self.film - self.muscle
        parts = self.film * film.history(u)[0] + self.muscle * muscle.history(u)[0]
        return RANGE * np.asarray(elastic * u + parts)

    def rest_angles(self, drive: Degrees) -> Degrees:
        """The angle that the joint settles at, on the side of the gap that it is on, deg."""
        settled, upper = [], bool(drive[0] >= 0)
        for x in drive:
            if abs(x) > self.snap:
                upper = bool(x > 0)
            side, gap = (1, self.gap[0]) if upper else (-1, self.gap[1])
            settled.append(float(side * (side * x + gap * np.exp(-side * x / self.decay))))
        return np.asarray(settled)

    def angles(self, commands: npt.ArrayLike, *, trial: int = 0) -> Degrees:
        """The true angle after each step of a history of commands, deg, shape (sample,)."""
        drive = self.drive(commands)
        random = np.random.default_rng([self.seed, trial, 1])
        return self.rest_angles(drive + self.pressure_noise * random.standard_normal(len(drive)))

    def measured(self, commands: npt.ArrayLike, *, trial: int = 0) -> Degrees:
        """The angle as two markers show it to an inclined camera, deg; each trial has its noise."""
        true = np.deg2rad(self.angles(commands, trial=trial) + self.inclination)
        random = np.random.default_rng([self.seed, trial, 2])
        ahead = self.marker_distance * np.stack([np.cos(true), np.sin(true)])
        one, other = (random.standard_normal(ahead.shape) for _ in range(2))
        seen = ahead + self.marker_noise * (one - other)
        return np.rad2deg(np.arctan2(seen[1], seen[0]))


# Nested and displaced loops: where eq. (12) needs one loop, an operator with memory needs more.
_NESTED = (0, 50, -50, 40, -40, 30, -30, 20, -20, 10, -10, 0, 50, 20, 45, 10, -45, -15, -40, -5, 0)

TRAVEL = np.deg2rad(40.0)  # the paper does not say over how much travel xi goes from 0 to 1
_THRESHOLDS = 12
_DEAD_ZONES = tuple(float(value) for value in np.deg2rad([0.5, 1, 2, 4, 8, 16, 32, 48]))


@dataclass(frozen=True)
class Trial:
    """One history followed with one compensation.

    Attributes:
        compensation: "none", "branches" (eq. 12) or "inverse".
        commands: what was sent, deg.
        angles: what was measured, the offset removed, deg, NaN during the preparation.
    """

    history: History
    compensation: str
    commands: Degrees
    angles: Degrees

    @property
    def errors(self) -> Degrees:
        """Measured less target angles where measured, deg."""
        return (self.angles - self.history.target)[self.history.measured]

    @property
    def largest(self) -> float:
        """Largest absolute error, deg."""
        return float(np.max(np.abs(self.errors)))

    @property
    def mean(self) -> float:
        """Mean absolute error, deg."""
        return float(np.mean(np.abs(self.errors)))


@dataclass(frozen=True)
class OneLink:
    """What the experiment gives.

    Attributes:
        trials: by history, then by compensation.
        recording: what was identified on.
        result: the fit of the modified Prandtl-Ishlinskii operator.
        offset: of the camera, by the paper's history, deg.
    """

    trials: tuple[Trial, ...]
    recording: Run
    result: FitResult
    offset: float

    def trial(self, history: str, compensation: str) -> Trial:
        """One of the trials by its names."""
        return next(
            trial
            for trial in self.trials
            if (trial.history.name, trial.compensation) == (history, compensation)
        )


def one_link(
    joint: SimulatedJoint | None = None,
    *,
    travel: float = TRAVEL,
    progress: Callable[[str], None] | None = None,
) -> OneLink:
    """Run the experiment.

    Offsets are removed as the paper does: on its own history the one that makes the mean error
    least, for each trial. On the other history the camera has not moved: the offset is that of the
    recording. The travel is that of eq. (12), rad. Ctrl-C ends it.
    """
    joint = SimulatedJoint() if joint is None else joint
    say = progress or (lambda text: None)
    say("recording the joint")
    recording, offset = _record(joint)
    paper = paper_history()
    say("eq. (12): the branches of the loop")
    on_paper = np.rad2deg(recording.values["angle"][: len(paper.target)])
    branches = compensator_for_loop(_run(paper, on_paper), travel)
    say("fitting the modified Prandtl-Ishlinskii operator")
    result = identify(recording)
    if result.status == "interrupted":
        # Trials with an operator that was cut short would look like whole ones.
        raise KeyboardInterrupt
    inverse = compensator_for_model(result.model)
    trials, number = [], 0
    for plan in (paper, other_history()):
        for name, compensator in (("none", None), ("branches", branches), ("inverse", inverse)):
            say(f"the {plan.name} history, compensation: {name}")
            number += 1
            commands = plan.target
            if compensator is not None:
                aimed = np.clip(np.deg2rad(plan.target), *compensator.reachable)
                # The joint takes no command beyond its range.
                commands = np.clip(np.rad2deg(compensator.commands(aimed)), -RANGE, RANGE)
            seen = joint.measured(commands, trial=number)
            error = (seen - plan.target)[plan.measured]
            # The median makes the mean error least.
            removed = float(np.median(error)) if plan is paper else offset
            shown = np.where(plan.measured, seen - removed, np.nan)
            trials.append(Trial(plan, name, commands, shown))
    return OneLink(tuple(trials), recording, result, offset)


def record_joint(joint: SimulatedJoint | None = None) -> Run:
    """What the compensations are identified from: the paper's history, then loops within it."""
    recording, _ = _record(SimulatedJoint() if joint is None else joint)
    return recording


def _record(joint: SimulatedJoint) -> tuple[Run, float]:
    plan, paper = history("identification", (*PAPER, *_NESTED[1:])), paper_history()
    angles = joint.measured(plan.target)
    offset = float(np.median((angles[: len(paper.target)] - paper.target)[paper.measured]))
    return _run(plan, angles - offset), offset


def identify(recording: Run) -> FitResult:
    """Fit the modified Prandtl-Ishlinskii operator to a recording of a joint."""
    # An operator only approximates the joint, and its inverse is to be near it: what is left has a
    # memory, but is no noise.
    return fit(
        model_for([recording]), recording, noise_model="white", check=False, max_iterations=150
    )


def _run(plan: History, angles: Degrees) -> Run:
    seen = np.where(plan.measured, np.deg2rad(angles), np.nan)
    return Run.from_arrays(
        plan.times,
        {"command": np.deg2rad(plan.target), "angle": seen},
        name=plan.name,
        definition={
            "origin": "simulated 1-link arm (giajax hysteresis)",
            "hysteresis": {
                "operator": "modified_prandtl_ishlinskii",
                "thresholds": _THRESHOLDS,
                "upper_dead_zones": list(_DEAD_ZONES),
                "lower_dead_zones": list(_DEAD_ZONES),
            },
        },
    )
