"""The next experiment: which command and which markers tell most of chosen parameters."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import InputError
from ..fitting import FitResult
from ..models import AbstractModel
from ._command import CommandSeries, base_step
from ._criterion import Criterion
from ._design import Design
from ._expected import expected
from ._limits import Limits
from ._objective import RobustError
from ._question import question_of
from ._search import Evaluation, Search, starts_of
from ._uncertainty import draws

# Numbers of a command that a design has, unless the caller says how many.
_KNOTS = 15
_NUMBERS = 30
_FEWEST = 4


def design_experiment(
    source: AbstractModel | FitResult,
    wanted: Sequence[str] | Mapping[str, float],
    limits: Limits | None = None,
    *,
    criterion: str = "c",
    free: Sequence[str] | None = None,
    channels: Sequence[str] | None = None,
    markers: int | None = None,
    noise: Mapping[str, float] | None = None,
    priors: Mapping[str, Any] | None = None,
    ties: Mapping[str, str] | None = None,
    uncertainty: float | Mapping[str, float] | None = None,
    over: str = "mean",
    draw_count: int = 4,
    knots: int | None = None,
    starts: int = 6,
    follow: int = 2,
    iterations: int = 25,
    definition: Mapping[str, Any] | None = None,
    progress: Callable[[Evaluation], None] | None = None,
) -> Design:
    """Find the command series, and the markers, that most lower standard errors to be expected.

    Arguments:
        source: the arm at the present values of its parameters, or a fit of it. Of a fit, what was
            free, priors, ties, noise and uncertainty are taken, unless they are given.
        wanted: paths of the parameters of interest. For "c" one, or the weight of each in a linear
            combination, in 1 over their units.
        limits: what the command may do: the base joint to 30 deg at 30 deg/s in 25 s by default.
        criterion: "c" (standard error of one), "A" (root of the trace of the covariance of all of
            interest, each in its present value), or "D" (determinant).
        free: paths that a fit of the experiment will have free, too.
        channels: candidates to record, such as `link06_z`; the positions of all links by default.
        markers: how many bodies (`link06`) may be filmed; all candidates by default.
        noise: standard deviation by quantity (`position`, `angle`) or channel, SI.
        priors: what is known of parameters before (`giajax.Prior`), by path.
        ties: parameters that follow from others (expressions), by path, as of `fit`.
        uncertainty: standard deviation over the present value: of all that is free, or by path;
            that of a fit, and 0.2 of what it does not tell.
        over: "mean" of the logarithm of the error over draws of what is uncertain, or "worst".
        draw_count: how many draws, the present values among them.
        knots: of the command of each joint after its start.
        starts: commands that are compared first.
        follow: how many of them are followed.
        iterations: of the optimiser, from each.
        definition: what a sidecar of the experiment says, such as `{"initial": {"free": True}}`.
        progress: called after each evaluation; may raise KeyboardInterrupt, which keeps the best.

    Returns:
        The experiment beside the paper's base step under the same limits.

    Raises:
        InputError: an unknown path, joint, channel, criterion, or numbers that make no sense.
        KeyboardInterrupt: before anything was evaluated.

    Example:
        >>> import giajax
        >>> arm = giajax.ArmModel(giajax.takeichi_20m())
        >>> limits = giajax.Limits(joints=(1, 3), duration=20.0)
        >>> found = giajax.design_experiment(
        ...     arm, ["air.drag_coefficient"], limits
        ... )  # doctest: +SKIP
    """
    began = time.perf_counter()
    limits = limits or Limits()
    asked = question_of(
        source,
        wanted,
        limits,
        free=free,
        channels=channels,
        noise=noise,
        priors=priors,
        ties=ties,
        uncertainty=uncertainty,
        definition=definition,
    )
    per_joint = min(_KNOTS, max(_FEWEST, _NUMBERS // len(limits.joints)), limits.rows)
    series = CommandSeries.of(limits, per_joint if knots is None else knots)
    objective = RobustError(
        asked.experiment,
        series,
        draws(asked.parameters, asked.values, asked.deviations, asked.correlation, draw_count),
        asked.known,
        Criterion(criterion, asked.weights(criterion)),
        len(asked.bodies) if markers is None else markers,
        over,
    )
    objective.leave_out_failing(series.base_step())
    search = Search(objective, series, progress)
    search.follow(starts_of(series, starts), follow, iterations)
    if search.best is None:
        raise InputError(
            "no command that was tried can be simulated with every draw of what is uncertain: give "
            "a smaller uncertainty (--uncertainty), or other values of the parameters"
        )
    objective.markers = search.markers
    spread = np.exp(objective.each(search.best) - objective.each(search.best)[0])
    designed = expected(asked, series.at(search.best), "design", objective, search.markers)
    stepped = expected(asked, base_step(limits, len(series.times)), "base_step", objective)
    return Design(
        limits=limits,
        criterion=criterion,
        wanted=tuple(asked.wanted),
        parameters={
            part.path: (float(value), part.declaration.unit)
            for part, value in zip(asked.parameters, asked.values, strict=True)
        },
        noise=asked.noise,
        designed=designed,
        base_step=stepped,
        before=asked.before,
        spread=(float(spread.min()), float(spread.max())),
        draws=len(objective.draws),
        status="interrupted"
        if search.interrupted
        else ("iteration limit" if search.limited else "converged"),
        evaluations=tuple(search.evaluations),
        seconds=time.perf_counter() - began,
    )
