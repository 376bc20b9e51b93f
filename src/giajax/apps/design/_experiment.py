"""Design of the next experiment: the command and markers that are most informative."""

import dataclasses
import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from ...fitting import FitResult
from ...models import AbstractModel
from ...recordings import Run
from ...runtime.arrays import Float
from ...runtime.text import InputError
from ...studies import expected_errors
from ..synthetic import Drive
from ._question import Criterion, Question, draws, question_of
from ._search import (
    Command,
    CommandSeries,
    Evaluation,
    Experiment,
    Informed,
    Limits,
    Numbers,
    Search,
    base_step,
    informed,
    slopes,
    starts_of,
)

Informations = Float[np.ndarray, "body draw parameter parameter"]

_ALL = 3000  # Up to this number of choices, all of them are compared.


def check_count(count: int, bodies: int) -> None:
    """Raise an error if this number of markers cannot be chosen from the bodies."""
    if not 1 <= count <= bodies:
        raise InputError(f"{count} markers are requested: give a number from 1 to {bodies}")


def chosen_markers(
    error: Callable[[np.ndarray], float], informations: Informations, count: int
) -> tuple[int, ...]:
    """Return the positions of the bodies to record, in increasing order.

    The choice minimises `error`, a function of the information of the recorded bodies. All choices
    are compared if they are few. Otherwise bodies are added one by one, each time the best one, and
    are then exchanged as long as an exchange reduces the error (Fedorov).
    """
    bodies = len(informations)
    check_count(count, bodies)

    def of(some: tuple[int, ...]) -> float:
        return error(informations[list(some)].sum(axis=0))

    if math.comb(bodies, count) <= _ALL:
        return min(itertools.combinations(range(bodies), count), key=of)
    some: tuple[int, ...] = ()
    while len(some) < count:
        some = min(((*some, new) for new in range(bodies) if new not in some), key=of)
    while True:
        others = [body for body in range(bodies) if body not in some]
        exchanged = [
            (*some[:place], new, *some[place + 1 :]) for place in range(count) for new in others
        ]
        best = min(exchanged, key=of)
        if of(best) >= of(some):
            return tuple(sorted(some))
        some = best


_OVER = ("mean", "worst")


@dataclasses.dataclass
class RobustError:
    """Logarithm of the expected error: its mean over the draws, or its largest value.

    Attributes:
        draws: possible values of the parameters, SI.
        known: information matrix of the priors, in the scales of the experiment.
        over: "mean" or "worst".
        markers: positions of the bodies that are currently recorded.
    """

    experiment: Experiment
    series: CommandSeries
    draws: Float[np.ndarray, "draw parameter"]
    known: Float[np.ndarray, "parameter parameter"]
    criterion: Criterion
    count: int
    over: str = "mean"
    markers: tuple[int, ...] = ()
    _seen: tuple[bytes, Informed] | None = None

    def __post_init__(self) -> None:
        check_count(self.count, 1 + max(self.experiment.bodies))
        if self.over not in _OVER:
            raise InputError(
                f"'{self.over}' is not a valid value of robust: use one of {', '.join(_OVER)}"
            )

    def __call__(self, numbers: Numbers) -> float:
        """Return the logarithm of the expected error; NaN if a draw cannot be simulated."""
        found = self._informed(numbers)
        if not np.all(found.successful):
            return np.nan
        return self._over_draws(found.values[:, list(self.markers)].sum(axis=1))

    def slope(self, numbers: Numbers) -> Float[np.ndarray, " number"]:
        """Return its gradient; NaN if a draw cannot be simulated."""
        found = self._informed(numbers)
        if not np.all(found.successful):
            return np.full(len(numbers), np.nan)
        informations = found.values[:, list(self.markers)].sum(axis=1)
        each = [self._error(information) for information in informations]
        some = slice(None)
        if self.over == "worst":
            worst = int(np.argmax([value for value, _ in each]))
            some = slice(worst, worst + 1)
        # For a criterion of few parameters this matrix has low rank: a few directions suffice.
        factors, directions = np.linalg.eigh([by_information for _, by_information in each[some]])
        most = np.argsort(-np.abs(factors), axis=1)[:, : self.criterion.rank]
        along = slopes(
            self.experiment,
            self.series.at(numbers),
            self.draws[some],
            np.take_along_axis(directions.swapaxes(1, 2), most[..., None], axis=1),
            np.take_along_axis(factors, most, axis=1),
            self.markers,
        )
        return along.mean(axis=0)

    def leave_out_failing(self, numbers: Numbers) -> None:
        """Drop the draws for which a command cannot be simulated; the first one is kept."""
        successful = np.asarray(self._informed(numbers).successful).astype(bool).ravel()
        if not np.all(successful[1:]):
            self.draws = self.draws[[True, *successful[1:]]]
            self._seen = None

    def choose(self, numbers: Numbers) -> None:
        """Select the bodies that are most informative for a command."""
        found = self._informed(numbers)
        if np.all(found.successful):
            self.markers = self.chosen(found.values)
        elif not self.markers:
            self.markers = tuple(range(self.count))

    def chosen(
        self, informations: Float[np.ndarray, "draw body parameter parameter"]
    ) -> tuple[int, ...]:
        """Return the most informative bodies."""
        return chosen_markers(self._over_draws, informations.swapaxes(0, 1), self.count)

    def each(self, numbers: Numbers) -> np.ndarray:
        """Return the logarithm of the error of each draw, shape (draw,)."""
        informations = self._informed(numbers).values[:, list(self.markers)].sum(axis=1)
        return np.asarray([self._error(one)[0] for one in informations])

    def _over_draws(self, informations: np.ndarray) -> float:
        values = [self._error(one)[0] for one in informations]
        return float(np.max(values) if self.over == "worst" else np.mean(values))

    def _error(self, information: np.ndarray) -> tuple[float, np.ndarray]:
        return self.criterion.of_information(information + self.known)

    def _informed(self, numbers: Numbers) -> Informed:
        key = np.asarray(numbers, dtype=float).tobytes()
        if self._seen is None or self._seen[0] != key:
            self._seen = key, informed(self.experiment, self.series.at(numbers), self.draws)
        return self._seen[1]


@dataclasses.dataclass(frozen=True)
class Expected:
    """A planned experiment and its expected errors.

    Attributes:
        run: commands and sample times of the experiment, without recorded values.
        drive: the corners of the command.
        markers, channels: bodies that are filmed (`link06`), and their channels.
        errors: standard error of each parameter by path, in the unit of the parameter; infinite if
            the experiment does not determine the parameter.
        criterion: expected error according to the criterion. For a single parameter it is in the
            unit of that parameter. None if the experiment does not determine it even to within a
            hundred times the value.
        times: times of the samples, s.
        predicted: predicted values of all candidate channels by name, SI.
    """

    run: Run
    drive: Drive
    markers: tuple[str, ...]
    errors: dict[str, float]
    criterion: float | None
    times: Float[np.ndarray, " sample"]
    predicted: dict[str, Float[np.ndarray, " sample"]]
    channels: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Design:
    """The optimal experiment, compared with the paper's base step under the same limits.

    Attributes:
        criterion: "c", "A" or "D".
        wanted: paths of the parameters of interest.
        parameters: value and unit of each parameter that a fit would estimate, by path.
        noise: standard deviation of one recorded value, SI, for each candidate channel.
        base_step: the paper's base step, with the markers that are best for it.
        before: standard errors by path of the fit that the design started from; may be empty.
        spread: smallest and largest criterion of the design over the draws of the uncertain
            parameters, each divided by the criterion at the current values.
        draws: number of draws, without those for which the base step cannot be simulated.
        status: "converged", "iteration limit" if the search for the best command ended at that
            limit, or "interrupted" if the design is the best one before an interruption.
    """

    limits: Limits
    criterion: str
    wanted: tuple[str, ...]
    parameters: dict[str, tuple[float, str]]
    noise: dict[str, float]
    designed: Expected
    base_step: Expected
    before: dict[str, float]
    spread: tuple[float, float]
    draws: int
    status: Literal["converged", "iteration limit", "interrupted"]
    evaluations: tuple[Evaluation, ...]
    seconds: float

    @property
    def ratio(self) -> float | None:
        """Criterion of the design divided by that of the base step; None if either is missing."""
        if self.designed.criterion is None or self.base_step.criterion is None:
            return None
        return self.designed.criterion / self.base_step.criterion

    def summary(self) -> str:
        """Return the result of the design in one clause."""
        if self.ratio is not None:
            return f"{self.ratio:.3f} times the error of the base step"
        both = {"the design": self.designed, "the base step": self.base_step}
        without = [name for name, one in both.items() if one.criterion is None]
        return f"{' and '.join(without)} cannot determine {', '.join(self.wanted)}"

    def __repr__(self) -> str:
        return f"<Design: {self.criterion}-optimal for {', '.join(self.wanted)}, {self.summary()}>"


def expected(
    asked: Question,
    command: Command,
    name: str,
    objective: RobustError,
    markers: tuple[int, ...] | None = None,
) -> Expected:
    """Return the expected errors of a command; the run of the experiment gets the given name.

    The filmed bodies are `markers`. By default they are the most informative ones.
    """
    experiment = asked.experiment
    found = informed(experiment, command, asked.values[None])
    if not np.all(found.successful):
        model = experiment.model
        why = model.failure(model.prepare(asked.run_of(command.drive(), name)))
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


# By default a command has about `_NUMBERS` free values: `_FEWEST` to `_KNOTS` knots per joint.
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
    """Find the command series and the markers that minimise the expected standard errors.

    The result is compared with the paper's base step under the same limits.

    Arguments:
        source: the arm at the current values of its parameters, or a fit of it. A fit also
            supplies the free parameters, priors, ties, noise and uncertainty that are not given.
        wanted: paths of the parameters of interest. Criterion "c" takes one path, or the weight of
            each parameter in a linear combination, in the reciprocal of its unit.
        limits: limits of the command. The default moves the base joint by at most 30 deg at
            30 deg/s in an experiment of 25 s.
        criterion: "c" (standard error of one parameter or combination), "A" (root of the trace of
            the covariance of all parameters of interest, each divided by its current value), or
            "D" (determinant of that covariance).
        free: paths of further parameters that a fit of the experiment will estimate.
        channels: candidate channels to record, such as `link06_z`. The default is the positions of
            all links.
        markers: number of bodies (`link06`) that may be filmed. The default is all candidates.
        noise: standard deviation by quantity (`position`, `angle`) or channel, SI.
        priors: prior knowledge of parameters (`giajax.Prior`), by path.
        ties: parameters that are expressions of other parameters, by path, as in `fit`.
        uncertainty: standard deviation divided by the current value, for all free parameters or by
            path. The default is the uncertainty of the fit, and 0.2 for parameters without one.
        over: "mean" of the logarithm of the error over the draws of the uncertain parameters, or
            "worst".
        draw_count: number of draws, including the current values.
        knots: number of knots of the command of each joint after its start.
        starts: number of initial commands that are compared.
        follow: number of initial commands from which the optimiser is started.
        iterations: maximum number of iterations of the optimiser from each of them.
        definition: contents of the sidecar of the experiment, e.g. `{"initial": {"free": True}}`.
        progress: called after each evaluation. It may raise KeyboardInterrupt, which ends the
            search with the best command so far.

    Raises:
        InputError: an unknown path, joint, channel or criterion, or an invalid number.
        KeyboardInterrupt: interrupted before the first evaluation.

    Example:
        >>> import giajax
        >>> arm = giajax.ArmModel(giajax.takeichi_20m())
        >>> limits = giajax.apps.design.Limits(joints=(1, 3), duration=20.0)
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
        free=free, channels=channels, noise=noise, priors=priors, ties=ties,
        uncertainty=uncertainty, definition=definition,
    )  # fmt: skip
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
            "no candidate command can be simulated with every draw of the uncertain values: give "
            "a smaller uncertainty (--relative-uncertainty), or other values of the parameters"
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
        status=search.status,
        evaluations=tuple(search.evaluations),
        seconds=time.perf_counter() - began,
    )
