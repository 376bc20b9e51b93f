"""The errors to expect of one experiment at the present values of the parameters."""

import numpy as np

from .._errors import InputError
from ..study import expected_errors
from ._command import Command
from ._design import Expected
from ._information import informed
from ._objective import RobustError
from ._question import Question


def expected(
    asked: Question,
    command: Command,
    name: str,
    objective: RobustError,
    markers: tuple[int, ...] | None = None,
) -> Expected:
    """What is to be expected of a command.

    Arguments:
        asked: the question.
        command: that is given.
        name: of the run.
        objective: says what is small, and chooses markers.
        markers: positions of the bodies that are filmed; by default those that tell most.

    Raises:
        InputError: the arm cannot follow the command.
    """
    experiment = asked.experiment
    found = informed(experiment, command, asked.values[None])
    if not np.all(found.successful):
        why = asked.model.failure(asked.model.prepare(asked.run_of(command.drive(), name)))
        raise InputError(f"the command of {name} cannot be simulated: {why}")
    some = objective.chosen(found.values) if markers is None else markers
    whole = found.values[0, list(some)].sum(axis=0) + asked.known
    errors = expected_errors(whole)[: len(experiment.paths)] * experiment.scales
    channels = zip(experiment.channels, experiment.bodies, strict=True)
    return Expected(
        run=asked.run_of(command.drive(), name),
        drive=command.drive(),
        markers=tuple(asked.bodies[body] for body in some),
        errors=dict(zip(experiment.paths, map(float, errors), strict=True)),
        criterion=(
            float(np.exp(objective.criterion.of_information(whole)[0]))
            if objective.criterion.is_determined(whole)
            else None
        ),
        times=np.asarray(experiment.inputs.times),
        predicted=dict(zip(experiment.channels, found.predicted[0].T, strict=True)),
        channels=tuple(channel for channel, body in channels if body in some),
    )
