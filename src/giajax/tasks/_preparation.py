"""A fit whose runs are read and whose arguments are resolved."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

from ..diagnosis import with_suspects, with_systematic_errors
from ..fitting import (
    MAX_ITERATIONS,
    FitResult,
    Iteration,
    PredictionErrors,
    Setup,
    prediction_errors,
    set_up,
    solve,
)
from ..models import model_for
from ..runs import Definition, Run
from ..study import SEED, SPREAD, solve_from_starts


@dataclasses.dataclass(frozen=True)
class Preparation:
    """What `FitTask.prepare` returns: all that a fit needs, before anything is evaluated.

    Attributes:
        definition: all settings.
        setup: the model, the runs to fit, and what is free.
        validation: runs that the result must predict.
    """

    definition: Definition
    setup: Setup
    validation: tuple[Run, ...]

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs to fit, or their windows."""
        return self.setup.runs

    def run(
        self,
        progress: Callable[[Iteration], None] | None = None,
        announce: Callable[[int, Mapping[str, float]], None] | None = None,
        *,
        check: bool = True,
        suspects: bool = True,
    ) -> FitResult:
        """Fit, and predict the runs of the validation.

        Arguments:
            progress, announce, check, suspects: as of `FitTask.run`.

        Returns:
            As `FitTask.run`.

        Raises:
            InputError: the model cannot be evaluated at the start.
        """
        settings = self.definition.fit
        most = settings.max_iterations or MAX_ITERATIONS
        starts = settings.starts or 1
        if starts == 1:
            result = solve(self.setup, max_iterations=most, progress=progress, check=check)
        else:
            result = solve_from_starts(
                self.setup,
                starts=starts,
                spread=SPREAD if settings.spread is None else settings.spread,
                seed=SEED if settings.seed is None else settings.seed,
                max_iterations=most,
                progress=progress,
                announce=announce,
                check=check,
            )
        errors: list[PredictionErrors] = []
        try:
            for run in self.validation:
                errors.append(prediction_errors(result.model, run))
        except KeyboardInterrupt:  # The fit is done, and took longer.
            message = f"{result.message}; interrupted before its validation was complete"
            result = dataclasses.replace(result, status="interrupted", message=message)
        result = dataclasses.replace(result, validation=tuple(errors))
        return self._diagnosed(result, suspects=suspects)

    def _diagnosed(self, result: FitResult, *, suspects: bool) -> FitResult:
        """With systematic errors, where uncertainties are stated, and with suspects."""
        if result.status == "interrupted":
            return result
        if self.definition.fit.uncertainty:
            result = with_systematic_errors(result, self.runs, self.definition.fit.uncertainty)
        if suspects and is_inadequate(result):
            result = with_suspects(result, self.runs)
        return result


def is_inadequate(result: FitResult) -> bool:
    """Whether the verdict on a fit is that its model does not describe the data."""
    verdict = getattr(result, "verdict", None)
    return verdict is not None and verdict.status == "inadequate"


def prepare(definition: Definition, runs: Sequence[Run], validation: Sequence[Run]) -> Preparation:
    """Build the model of the runs and resolve the settings of the definition.

    Arguments:
        definition: all settings.
        runs: what to fit to.
        validation: runs that the result must predict.

    Returns:
        All that a fit needs.

    Raises:
        InputError: as `giajax.fit`, apart from a start that cannot be evaluated.
    """
    settings = definition.fit
    setup = set_up(
        model_for(runs),
        runs,
        free=settings.free,
        start=settings.start,
        fix=settings.fix,
        loss=settings.loss or "linear",
        solver=settings.solver,
        tolerance=settings.tolerance,
    )
    return Preparation(definition, setup, tuple(validation))
