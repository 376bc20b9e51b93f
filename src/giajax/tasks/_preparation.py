"""A fit whose runs have been read and whose settings are resolved."""

import contextlib
import dataclasses
import functools
import shlex
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from ..fitting import (
    Finding,
    FitJournal,
    FitResult,
    HoldOut,
    Iteration,
    PredictionErrors,
    Setup,
    WarmStart,
    load_result,
    odd_recordings,
    prediction_errors,
    set_up,
    set_up_with_hold_out,
    solve,
    versions,
)
from ..models import model_for
from ..recordings import Definition, Run, held_parts, read_run
from ..runtime.plugins import check_sources, sources_of
from ..runtime.text import InputError
from ..studies import (
    check_uncertainty,
    has_earlier_starts,
    interrupted,
    solve_from_starts,
    with_suspects,
    with_systematic_errors,
)
from ._journal import JOURNAL, Journal, check_again, locked, read_journal
from ._stored import check_config


def warn(sentence: str) -> None:
    """Report a complaint as a Python warning, which is the default."""
    warnings.warn(sentence, stacklevel=2)


@dataclasses.dataclass(frozen=True)
class Preparation:
    """Resolved fit before any evaluation, as `FitTask.prepare` returns it.

    Attributes:
        definition: definition of the fit.
        setup: model, runs to fit, and free parameters.
        validation: runs that the result must predict.
        record: the task as plain data, which the result stores.
        held_out: held-out data of the runs, or None if all data are fitted.
        earlier: result of the same fit, to which additional starts are added, or None.
    """

    definition: Definition
    setup: Setup
    validation: tuple[Run, ...]
    record: Mapping[str, Any]
    held_out: HoldOut | None = None
    earlier: FitResult | None = None

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs to fit, or their windows, without the held-out data."""
        return self.setup.runs

    @property
    def held_out_runs(self) -> tuple[Run, ...]:
        """Runs that contain only the held-out cells."""
        return tuple(held_parts(() if self.held_out is None else self.held_out.parts))

    @functools.cached_property
    def odd(self) -> tuple[Finding, ...]:
        """Oddities of the recordings, as in `giajax check`, with the rows of the files."""
        settings, runs = self.setup.settings, self.runs
        if settings.window_s is not None or self.held_out is not None:
            names, about = self.record["rename"], self.definition
            files = self.record["data"]
            runs = tuple(read_run(path, rename=names, definition=about) for path in files)
        return odd_recordings(runs)

    @contextlib.contextmanager
    def open_journal(
        self,
        folder: Path,
        *,
        resume: bool = False,
        force: bool = False,
        complain: Callable[[str], None] = warn,
    ) -> Iterator[Journal]:
        """Open the journal of this fit in a folder, and lock it against other fits.

        Arguments:
            folder: folder of the journal.
            resume: continue where the journal ends.
            force: start again and replace the journal of an interrupted fit.
            complain: function that is called with a sentence if a line cannot be written.

        Raises:
            InputError: another fit is writing there, the journal cannot be read or belongs to
                another fit, or (without `resume` and `force`) it is the journal of an interrupted
                fit.
        """
        if self.setup.settings.optimiser is not None:
            raise InputError(
                f"a fit with {self.setup.config['optimiser']} has no steps to record, so it cannot "
                "be resumed: omit the journal, or change the optimiser"
            )
        with locked(folder):
            journal = read_journal(folder) if resume or not force else None
            if resume:
                if journal is None:
                    raise InputError(
                        f"{folder} has no journal of a fit: start a fit without resuming"
                    )
                said = f"{self.setup.model.kind} {journal.head['config']}"
                check_sources(journal.head["versions"], said)
                check_again(self.record, journal.head["task"], folder)
                check_config(journal.head["config"], self.setup.config, journal.path)
            else:
                if journal is not None and not journal.is_written:
                    raise InputError(
                        f"{folder} holds the journal of an interrupted fit: continue with giajax "
                        f"fit --resume {shlex.quote(str(folder))}, give another folder, or give "
                        "--force to start again"
                    )
                head = {"task": dict(self.record), "config": dict(self.setup.config)}
                made_by = {**versions(), **sources_of((self.setup.model, self.setup.loss))}
                journal = Journal(folder / JOURNAL, {"versions": made_by, **head})
            journal.complain = complain
            try:
                yield journal
            finally:
                journal.close()

    def run(
        self,
        progress: Callable[[Iteration], None] | None = None,
        announce: Callable[[int, Mapping[str, float]], None] | None = None,
        *,
        check: bool = True,
        journal: Callable[[int], FitJournal] | None = None,
        executor: Executor | None = None,
        folder: Path | None = None,
    ) -> FitResult:
        """Fit, and predict the held-out data and the validation runs, as in `FitTask.run`.

        The arguments `journal`, `executor` and `folder` are those of `studies.solve_from_starts`.
        """
        if self.setup.settings.starts == 1:
            first = None if journal is None else journal(1)
            result = solve(self.setup, progress=progress, check=check, journal=first)
        else:
            # If an earlier version chose other starts, all of them are fitted.
            known = has_earlier_starts(self.earlier, self.setup)
            result = solve_from_starts(
                self.setup,
                progress=progress,
                announce=announce,
                check=check,
                journal=journal,
                before=self.earlier if known else None,
                executor=executor,
                folder=folder,
            )
        errors: list[PredictionErrors] = []
        try:
            if self.held_out is not None:
                result = self.held_out.judge(result)
            for run in self.validation:
                errors.append(prediction_errors(result.model, run))
        except KeyboardInterrupt:  # The finished fit is kept, because it took longer.
            result = interrupted(result, "before the validation was complete")
            if self.held_out is not None and not result.held_out:
                result = self.held_out.unjudged(result)
        return dataclasses.replace(
            result,
            validation=tuple(errors),
            findings=(*self.odd, *result.findings),
            task=dict(self.record),
        )

    def diagnosed(
        self,
        result: FitResult,
        *,
        suspects: bool = True,
        announce: Callable[[str], None] | None = None,
        complain: Callable[[str], None] = warn,
    ) -> FitResult:
        """Return the result of `run` with the diagnostics that follow a fit.

        They are systematic errors, if uncertainties are given, and suspects, which may make an
        adequate model doubtful. If the fit is adequate, only parameters are tested, otherwise also
        choices of the model. If nothing is requested, the result is unchanged. It is also
        unchanged, with a complaint, if Ctrl-C is pressed or if a test fails, for example because
        the model cannot be evaluated with all its parts switched on.

        Arguments:
            result: result of `run`.
            suspects: whether to test suspects.
            announce: function that is called with a sentence when the test begins.
            complain: function that is called with a sentence if the test does not finish.
        """
        doubted = self.definition.fit.uncertainty
        try:
            if result.status != "interrupted" and doubted:
                result = with_systematic_errors(result, self.runs, doubted)
            judged = result.verdict.status != "not evaluated"
            if suspects and judged and result.status != "interrupted":
                if announce is not None:
                    announce("testing fixed and omitted parameters ...")
                adequate = result.verdict.status == "adequate"
                result = with_suspects(result, self.runs, parameters_alone=adequate)
        except KeyboardInterrupt:
            complain("interrupted before fixed and omitted parameters were tested")
        except Exception as error:  # A failing test must not lose the fit.
            complain(f"fixed and omitted parameters could not be tested ({error})")
        return result


def prepare(
    definition: Definition,
    runs: Sequence[Run],
    validation: Sequence[Run],
    record: Mapping[str, Any],
    earlier: Path | None = None,
) -> Preparation:
    """Build the model of the runs and resolve the settings of the definition.

    Arguments:
        definition: definition of the fit.
        runs: runs to fit.
        validation: runs that the result must predict.
        record: task as plain data. Its `begin` contains the final values of another fit.
        earlier: result to whose starts further ones are added, or None.
    """
    begin = None if record["begin"] is None else WarmStart(**record["begin"])
    setup, held_out = (
        set_up_with_hold_out(definition.fit, runs, begin)
        if definition.fit.hold_out
        else (set_up(model_for(runs), runs, definition.fit, begin=begin), None)
    )
    free = [parameter.path for parameter in setup.parameters]
    if uncertainty := definition.fit.uncertainty:
        check_uncertainty(setup.model, free, uncertainty, setup.config.get("ties"))
    before = None if earlier is None else load_result(earlier)
    return Preparation(definition, setup, tuple(validation), record, held_out, before)
