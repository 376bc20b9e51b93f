"""A mission as a motion, and as a run: what was commanded, what blew, where the tip was."""

import jax.numpy as jnp
import numpy as np

from ..models import ArmModel
from ..runs import Definition, Run
from ..simulation import RESULTS, Trajectory, logged
from ._mission import Mission
from ._outcome import Outcome


def motion(mission: Mission, outcome: Outcome) -> Trajectory:
    """The motion of the arm, as far as it was followed."""
    sound = int(np.sum(np.cumprod(np.all(np.isfinite(outcome.angles), axis=1))))
    times = outcome.times[:sound]
    return Trajectory(
        times=jnp.asarray(times),
        angles=jnp.asarray(outcome.angles[:sound]),
        rates=jnp.asarray(outcome.rates[:sound]),
        memory=None,
        pressures=None,
        skin=None,
        arm=mission.model.arm,
        command=logged(times, outcome.command[:sound]),
        wind=logged(times, outcome.wind[:sound]),
        result=RESULTS.successful,  # type: ignore[arg-type]
        steps=jnp.zeros(2, dtype=int),
    )


def recorded(mission: Mission, outcome: Outcome, *, name: str, origin: str = "") -> Run:
    """A run that `giajax view` plays and `giajax fit` reads.

    Arguments:
        mission: whose arm it was.
        outcome: what came of it.
        name: of the run.
        origin: where it is from, for its sidecar.
    """
    model: ArmModel = mission.model
    facts = {
        key: value for key, value in model.definition().items() if key in Definition.model_fields
    }
    facts |= {"model": model.kind, "command": {"interpolation": "linear"}}
    facts |= {"wind": {"interpolation": "linear"}} if np.any(outcome.wind) else {}
    facts |= {"origin": origin} if origin else {}
    values = {
        f"joint{joint:02d}_command": column
        for joint, column in enumerate(outcome.command.T, start=1)
        if np.any(column)
    }
    if np.any(outcome.wind):
        names = [
            f"link{k:02d}_wind_{axis}" for k in range(1, model.arm.count + 1) for axis in "xyz"
        ]
        values |= dict(zip(names, outcome.wind.T, strict=True))
    values |= dict(zip(("tip_x", "tip_y", "tip_z"), outcome.tip.T, strict=True))
    definition = Definition.parse(facts, name)
    return Run.from_arrays(outcome.times, values, name=name, definition=definition)
