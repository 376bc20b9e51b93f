"""The paper's experiment with one link (section IV.A, fig. 12), on a simulated joint.

The joint is recorded while it follows commands; from the recording two compensations are made,
eq. (12) and the inverse of a modified Prandtl-Ishlinskii operator; and each is judged by how far
the joint is from its target, on the paper's own history and on another one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..control import Compensator, compensator_for_loop, compensator_for_model
from ..fitting import FitResult, fit
from ..models import model_for
from ..runs import Run
from ._history import PAPER, Degrees, History, history, other_history, paper_history
from ._simulated_joint import RANGE, SimulatedJoint

# Nested and displaced loops: where eq. (12) needs one loop, an operator with memory needs more.
_NESTED = (0, 50, -50, 40, -40, 30, -30, 20, -20, 10, -10, 0, 50, 20, 45, 10, -45, -15, -40, -5, 0)

# The paper does not say over how much travel xi goes from 0 to 1.
TRAVEL = np.deg2rad(40.0)

_THRESHOLDS = 12
_DEAD_ZONES = tuple(float(value) for value in np.deg2rad([0.5, 1, 2, 4, 8, 16, 32, 48]))


@dataclass(frozen=True)
class Trial:
    """One history followed with one compensation.

    Attributes:
        history: the target.
        compensation: "none", "branches" (eq. 12) or "inverse".
        commands: what was sent, deg, shape (sample,).
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
        recording: what was identified on, as a run.
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
    recording.

    Arguments:
        joint: the simulated joint.
        travel: of eq. (12), rad.
        progress: called with what is being done.

    Returns:
        The trials, the recording and the fit.

    Raises:
        KeyboardInterrupt: after Ctrl-C, where a fit alone keeps the best so far.
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
            commands = _commands(compensator, plan.target)
            seen = joint.measured(commands, trial=number)
            error = (seen - plan.target)[plan.measured]
            removed = _least_offset(error) if plan is paper else offset
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
    error = (angles[: len(paper.target)] - paper.target)[paper.measured]
    offset = _least_offset(error)
    return _run(plan, angles - offset), offset


def identify(recording: Run) -> FitResult:
    """Fit the modified Prandtl-Ishlinskii operator to a recording of a joint."""
    # An operator only approximates the joint, and its inverse is to be near it: what is left has a
    # memory, but is no noise.
    return fit(
        model_for([recording]), recording, noise_model="white", check=False, max_iterations=150
    )


def _least_offset(errors: Degrees) -> float:
    """What the measured angles are too large by: the median makes the mean error least."""
    return float(np.median(errors))


def _commands(compensator: Compensator | None, target: Degrees) -> Degrees:
    if compensator is None:
        return target
    low, high = compensator.reachable
    commands = np.rad2deg(compensator.commands(np.clip(np.deg2rad(target), low, high)))
    # The joint takes no command beyond its range.
    return np.clip(commands, -RANGE, RANGE)


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
