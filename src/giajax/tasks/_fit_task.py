"""A fit as data, before anything is read or computed: runs, settings and files. Imports no JAX."""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, Unpack

from ..recordings import Definition, FitSettings, TaskKeywords, fit_settings, read_runs
from ..runtime.plugins import check_sources
from ..runtime.records import plain_data
from ..runtime.text import InputError
from ._journal import checksums_of, differences, known_to, read_journal, unchanged
from ._stored import check_config, reached_by, repeatable, without

if TYPE_CHECKING:
    from ..fitting import FitResult, Iteration, Setup
    from ._preparation import Preparation

    Watch = Callable[[Setup], Callable[[Iteration], None]]

Paths = str | Path | Sequence[str | Path]


def paths_of(files: Paths) -> tuple[Path, ...]:
    """Return one or several paths as a tuple."""
    return (Path(files),) if isinstance(files, str | Path) else tuple(map(Path, files))


def merged(below: FitSettings, above: FitSettings, origin: str) -> FitSettings:
    """Merge settings with others that take precedence. Settings of parameters are merged by path.

    Arguments:
        below: settings that may be replaced.
        above: settings that take precedence.
        origin: name of the origin of `above` in an error message.

    Raises:
        InputError: the merged settings contradict each other.
    """
    said = above.model_fields_set
    held, following = set(above.fix), set(above.ties)
    freed = {*(above.free or ()), *above.per_run, *above.groups}
    no_more = held | following

    def kept(name: str, without: Collection[str]) -> dict[str, Any]:
        contents = below.contents().get(name, {})
        return {path: item for path, item in contents.items() if path not in without}

    free = above.free if "free" in said else below.free
    if not above.free and free is not None:
        free = [path for path in free if path not in no_more]
    per_run = above.per_run
    if "per_run" not in said:
        per_run = [p for p in below.per_run if p not in no_more | set(above.groups)]
    new = above.contents()
    by_path = {
        "free": free,
        "start": kept("start", no_more),
        "fix": kept("fix", freed | set(above.start) | following),
        "priors": kept("priors", no_more),
        "bounds": kept("bounds", no_more),
        "ties": kept("ties", freed | held),
        "per_run": per_run,
        "groups": kept("groups", no_more | set(above.per_run)),
    }
    for name, item in by_path.items():
        if isinstance(item, dict):
            item |= new.get(name, {})
    mentioned = {"free", "start", "fix", *below.contents()}
    others = {name: item for name, item in new.items() if name not in by_path and item != {}}
    by_path = {name: item for name, item in by_path.items() if item or name in mentioned}
    together = {**below.contents(), **by_path, **others}
    if together.get("budget", "") is None:
        del together["budget"]
    merged = Definition.parse({"fit": together}, origin).fit
    # Files cannot specify an optimiser, so it is not part of the contents.
    optimiser = above.optimiser or below.optimiser
    return merged.model_copy(update={"optimiser": optimiser}) if optimiser else merged


def plain_of(task: "FitTask") -> dict[str, Any]:
    """Return a task as plain data, without reading any file."""
    return {
        "data": [str(path) for path in task.data],
        "validation": [str(path) for path in task.validation],
        "rename": dict(task.rename),
        "source": None if task.source is None else str(task.source),
        "out": str(task.out),
        "definition": plain_data(task.definition.contents()),
        "begin": None if task.begin is None else dict(task.begin),
    }


# Fits of whole runs that start from the result of a fit of their windows.
#
# The cost of a long oscillating recording has many local minima: with a wrong frequency, the model
# soon gets out of phase, and stays so. A window of a few periods with its own initial state is too
# short for that.

_FIRST = " 0 s"  # suffix that `runs.windows` gives the first window of a run


def with_warm_start(
    task: "FitTask",
    watch: "Watch | None" = None,
    told: "Callable[[FitResult], object] | None" = None,
) -> "FitTask":
    """Return the task with the warm start that `windows_first_s` in `[fit]` requests.

    The parameters start at the result of the fit of the windows, and the states of runs at those of
    their first windows. Data that are held out of the runs are held out of the windows, too. A task
    without this setting, or with a warm start, is returned unchanged.

    Arguments:
        task: task to prepare.
        watch: function that receives the setup of the fit of the windows, and returns a function
            that is called after each of its steps.
        told: function that is called with the result of that fit, unless Ctrl-C was pressed. The
            fit of the whole runs is then omitted.
    """
    settings = task.definition.fit
    if settings.windows_first_s is None or task.begin is not None:
        return task
    inside = settings.model_copy(
        update={"windows_first_s": None, "window_s": settings.windows_first_s, "starts": 1}
    )
    definition = task.definition.model_copy(update={"fit": inside})
    ready = dataclasses.replace(task, definition=definition, validation=()).prepare()
    result = ready.run(None if watch is None else watch(ready.setup), check=False)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    if told is not None:
        told(result)
    reached = reached_by(result)
    # The keys are the names of the runs from which the windows were cut.
    own = {
        name.removesuffix(_FIRST): values
        for name, values in reached["own"].items()
        if name.endswith(_FIRST)
    }
    return dataclasses.replace(task, begin={**reached, "own": own})


_OUT = Path("giajax-out")  # default folder of results


@dataclasses.dataclass(frozen=True)
class FitTask:
    """Fit definition with its files, and the settings that replace some of its own.

    Attributes:
        definition: all merged settings. Missing settings have their defaults.
        data: files of the runs to fit.
        validation: files of the runs that the result must predict, and to which it is not fitted.
        rename: map from the column names of the files to the names in the column table.
        source: path of the fit definition, or None.
        begin: final values of another fit as plain data (`fitting.WarmStart`), or None for a start
            according to the settings.
        resolved: `config` of a result whose numbers are to be reproduced, or None for a new fit.
        earlier: folder of that result, if at most the number of starts has changed. Its starts are
            kept.

    Example:
        >>> import giajax
        >>> task = giajax.FitTask.load("fits/base_step.toml").on_top(loss="huber")
        >>> task.definition.fit.loss
        'huber'
    """

    definition: Definition
    data: tuple[Path, ...] = ()
    validation: tuple[Path, ...] = ()
    rename: Mapping[str, str] = dataclasses.field(default_factory=dict)
    source: Path | None = None
    begin: Mapping[str, Any] | None = None
    resolved: Mapping[str, Any] | None = None
    earlier: Path | None = None

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the task of a fit definition in TOML. File names are relative to the definition.

        Raises:
            InputError: the file is missing, is not TOML, or contains an invalid key or value.
        """
        path = Path(path)
        definition = Definition.load(path)
        return cls(
            definition=definition,
            data=tuple(path.parent / name for name in definition.fit.data),
            validation=tuple(path.parent / name for name in definition.fit.validation),
            source=path,
        )

    @classmethod
    def of(cls, data: Paths) -> Self:
        """Return the task of one or several runs, with all settings at their defaults."""
        return cls(Definition(), data=paths_of(data))

    @classmethod
    def again(cls, path: str | Path, *, home: Path | None = None) -> Self:
        """Return the task that repeats a result with the same data, settings and initial guesses.

        On the same machine and with the same versions, the numbers are bitwise identical. The
        result is written to NAME-again, next to the other one. If `starts` is increased, only the
        additional ones are fitted. If no setting is changed, `prepare` refuses settings that this
        version of giajax resolves differently.

        Arguments:
            path: file or folder of the result.
            home: folder in which the fit was made, if the file is in another one.

        Raises:
            InputError: the result does not exist, its fit was stopped by the time budget, or a
                fitted file has changed.
        """
        folder, stored = repeatable(path)
        check_sources(stored["versions"], f"{stored['model']} {stored['config']}")
        config, fields = stored["config"], unchanged(stored["task"], home or folder)
        fields["definition"] = known_to(config, fields["definition"])
        out = folder.with_name(f"{folder.resolve().name}-again")
        return cls(**fields, resolved=config, earlier=folder).on_top(
            max_iterations=config.get("max_iterations"), budget="", out=out
        )

    @classmethod
    def resumed(cls, folder: str | Path) -> Self:
        """Return the task of a fit that was stopped or killed. `run(journal=folder)` continues it.

        Raises:
            InputError: the folder has no journal, the journal cannot be read, or a fitted file has
                changed.
        """
        folder = Path(folder)
        journal = read_journal(folder)
        if journal is None:
            raise InputError(f"{folder} has no journal of a fit: give the folder of a fit")
        fields = unchanged(journal.head["task"], folder)
        fields["definition"] = known_to(journal.head["config"], fields["definition"])
        return cls(**fields).on_top(out=folder)

    def on_top(
        self,
        settings: FitSettings | None = None,
        *,
        data: Paths | None = None,
        validation: Paths | None = None,
        begin: "str | Path | FitResult | None" = None,
        out: str | Path | None = None,
        rename: Mapping[str, str] | None = None,
        origin: str = "the arguments",
        **keywords: Unpack[TaskKeywords],
    ) -> Self:
        """Return the task with some settings changed. All others stay.

        Settings of parameters are merged by path, and the last setting of a parameter applies. A
        parameter that is fixed here is no longer free, and loses its initial value, prior, bounds,
        tie and groups. A parameter that is free or has an initial value here is no longer fixed.

        Arguments:
            data, validation: file or files that replace the current ones.
            settings: settings to change, as an alternative to their fields as keywords, which
                `giajax.FitSettings` describes. A budget of "" removes the budget.
            begin: result, or its file or folder. The fit starts at the final values of that fit,
                with the initial states of runs of the same name. Parameters that were free or fixed
                there and are held here keep their values from there. Values in `start` or `fix` in
                this or a later call take precedence.
            out: folder of the result (default: `giajax-out/` and the name of the definition or
                run).
            rename: map from the column names of the files to the names in the column table.
            origin: name of the origin of these settings in an error message.

        Raises:
            InputError: a value is invalid for its key.
        """
        below = self.definition.fit
        if keywords.get("budget") == "":
            del keywords["budget"]
            below = below.model_copy(update={"budget": None})
        said = fit_settings(keywords, origin, settings)
        together = merged(below, said, origin)
        if out is not None:
            together = together.model_copy(update={"out": str(out)})
        reached = self.begin if begin is None else reached_by(begin)
        task = dataclasses.replace(
            self,
            definition=self.definition.model_copy(update={"fit": together}),
            data=self.data if data is None else paths_of(data),
            validation=self.validation if validation is None else paths_of(validation),
            rename=self.rename if rename is None else dict(rename),
            begin=reached and without(reached, (*said.start, *said.fix)),
        )
        changed = differences(plain_of(self), plain_of(task))
        same = None if changed else self.resolved
        grown = None if set(changed) - {"starts"} else self.earlier
        return dataclasses.replace(task, resolved=same, earlier=grown)

    @property
    def out(self) -> Path:
        """Folder of the result."""
        if self.definition.fit.out is not None:
            return Path(self.definition.fit.out)
        named = self.source or (self.data[0] if self.data else Path("fit"))
        return _OUT / named.stem

    def prepare(self) -> "Preparation":
        """Read the runs and resolve the settings. Only windows (`windows_first_s`) are fitted.

        The `setup` of the returned object contains the model and the free parameters.

        Raises:
            InputError: no data, files that are not runs, or an error as in `giajax.fit`.
        """
        if not self.data:
            raise InputError("the task has no data: give at least one run")
        if (task := with_warm_start(self)) is not self:
            return task.prepare()
        runs = read_runs(self.data, self.definition, rename=self.rename)
        validation = read_runs(self.validation, self.definition, rename=self.rename, beside=runs)
        inputs = checksums_of((*self.data, *self.validation), self.source)
        from ._preparation import prepare

        more = self.earlier if self.resolved is None else None
        record = {**plain_of(self), "inputs": inputs}
        ready = prepare(self.definition, runs, validation, record, more)
        if self.resolved is not None:
            check_config(self.resolved, ready.setup.config, Path("the result"))
        return ready

    def run(
        self,
        progress: "Callable[[Iteration], None] | None" = None,
        announce: Callable[[int, Mapping[str, float]], None] | None = None,
        *,
        check: bool = True,
        journal: str | Path | None = None,
    ) -> "FitResult":
        """Fit, and predict the held-out data and the validation runs.

        A fit requires 64-bit precision: call `jax.config.update("jax_enable_x64", True)` first,
        which `giajax fit` does by itself.

        Arguments:
            progress: function that is called after each step with an `Iteration`.
            announce: function that is called, with several starts, before each start with its
                number and values.
            check: compute the gradient check and the effect of the solver tolerance at the end.
            journal: folder for a journal, `journal.jsonl`, which contains every step. If it
                contains a journal of this fit, the fit continues from there, and a fit that has
                ended returns its result again.

        Returns:
            The result, or the best result so far after Ctrl-C. `giajax.write_result` writes it.

        Raises:
            InputError: as in `prepare`, initial values that cannot be evaluated, or a journal of
                another fit.
        """
        ready = self.prepare()
        if journal is None:
            return ready.run(progress, announce, check=check)
        folder = Path(journal)
        with ready.open_journal(folder, resume=read_journal(folder) is not None) as steps:
            return ready.run(progress, announce, check=check, journal=steps.of)
