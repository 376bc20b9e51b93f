"""A fit as data: what to fit to what, before anything is read or computed. Imports no JAX."""

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
    """One file, or several."""
    return (Path(files),) if isinstance(files, str | Path) else tuple(map(Path, files))


def merged(below: FitSettings, above: FitSettings, origin: str) -> FitSettings:
    """Settings put on top of others: what is said of parameters path by path.

    An InputError where the two together contradict themselves.
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
    # No file states an optimiser, and so it is not among the contents.
    optimiser = above.optimiser or below.optimiser
    return merged.model_copy(update={"optimiser": optimiser}) if optimiser else merged


def plain_of(task: "FitTask") -> dict[str, Any]:
    """A task as plain data; nothing is read."""
    return {
        "data": [str(path) for path in task.data],
        "validation": [str(path) for path in task.validation],
        "rename": dict(task.rename),
        "source": None if task.source is None else str(task.source),
        "out": str(task.out),
        "definition": plain_data(task.definition.contents()),
        "begin": None if task.begin is None else dict(task.begin),
    }


# Whole runs that begin where a fit of their windows ends.
#
# The cost of a long recording of something that swings has many local minima: with a frequency
# that is off, the model is out of step soon, and stays so. In a window of a few periods, which
# begins in a state of its own, it has no time for that.

_FIRST = " 0 s"  # what `runs.windows` calls the first window of a run


def with_warm_start(
    task: "FitTask",
    watch: "Watch | None" = None,
    told: "Callable[[FitResult], object] | None" = None,
) -> "FitTask":
    """The task with the start that `windows_first_s` of its `[fit]` requests.

    Parameters begin where the fit of the windows ends, and states of runs with those of their
    first windows. What is held out of the runs is held out of the windows, too. A task that asks
    for nothing, or begins somewhere, is returned.

    Arguments:
        task: what to fit to what.
        watch: from the fit in windows to what is called after each of its steps.
        told: called with its result, unless Ctrl-C came: no fit of whole runs follows then.
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
    # By the names of the runs that the windows were cut of.
    own = {
        name.removesuffix(_FIRST): values
        for name, values in reached["own"].items()
        if name.endswith(_FIRST)
    }
    return dataclasses.replace(task, begin={**reached, "own": own})


_OUT = Path("giajax-out")  # where results go by default


@dataclasses.dataclass(frozen=True)
class FitTask:
    """A fit definition with its files, and the settings that were put on top of it.

    Attributes:
        definition: all settings, merged; what it leaves out has its default.
        data: files of the runs to fit.
        validation: files of the runs that the result must predict and is not fitted to.
        rename: the files' column name -> the name it has in the column table.
        source: the fit definition; None where there is none.
        begin: where another fit ended, as plain data (`fitting.WarmStart`); None for a start as
            the settings say.
        resolved: `config` of the result whose numbers are to come again; None for a new fit.
        earlier: its folder, if at most the number of starts is changed: its own are kept.

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
        """The task of a fit definition in TOML; the files that it names are relative to it.

        Raises:
            InputError: the file is missing, is not TOML, or has a key or a value that it may not.
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
        """The task of a run or several, with every setting at its default."""
        return cls(Definition(), data=paths_of(data))

    @classmethod
    def again(cls, path: str | Path, *, home: Path | None = None) -> Self:
        """The task of a result, by its file or folder: the same data, settings, starts and numbers.

        On the same machine and with the same versions they are the same bit for bit. It goes
        beside the other one, into NAME-again. With more `starts` on top only those are fitted. As
        long as no setting is changed, `prepare` refuses what has become of them in another version
        of giajax. The folder that it was fitted into is `home`, where its file lies in another one.

        Raises:
            InputError: no such result, one that was stopped when its time was up, or a file that
                it was fitted to has changed.
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
        """The task of a fit that was stopped or cut off; `run(journal=folder)` of it goes on.

        Raises:
            InputError: no journal there, one that cannot be read, or a file that was fitted to
                has changed.
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
        """The task with some settings changed; what is left out stays.

        What is said of parameters is merged path by path, and the last word on one counts: one
        that is fixed here is no longer free, and loses its start, prior, bounds, tie and groups;
        one that is free or has a start here is no longer fixed.

        Arguments:
            data, validation: file or files, in place of those before.
            settings: to put on top; or give its fields as keywords, of which `giajax.FitSettings`
                says what each is. A budget of "" is none.
            begin: a result, or its file or folder: the fit starts where that one ended, with
                the initial states of runs of the same name. Parameters that were free or fixed
                there and are held here are held at their values there. What `start` or `fix`
                says with it or later goes before.
            out: where the result goes (`giajax-out/` and the name of the definition or run).
            rename: the files' column name -> the name it has in the column table.
            origin: what an error calls the origin of these settings.

        Raises:
            InputError: a value that its key may not have.
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
        """Where the result goes."""
        if self.definition.fit.out is not None:
            return Path(self.definition.fit.out)
        named = self.source or (self.data[0] if self.data else Path("fit"))
        return _OUT / named.stem

    def prepare(self) -> "Preparation":
        """Read the runs and resolve settings; nothing but windows (`windows_first_s`) is evaluated.

        The `setup` of what it returns has the model and the free parameters.

        Raises:
            InputError: no data, files that are not runs, or as `giajax.fit`.
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
        """Fit, and predict what was held out and the runs of the validation.

        A fit wants 64-bit: call `jax.config.update("jax_enable_x64", True)` first, which
        `giajax fit` does by itself.

        Arguments:
            progress: called after each step with an `Iteration`.
            announce: with several starts, called before each with its number and values.
            check: compute the gradient check and the effect of the solver tolerance at the end.
            journal: a folder for a journal, `journal.jsonl`, which has every step. Where it has
                one of this fit already, the fit continues from there, and one that has ended gives
                its result again.

        Returns:
            The result, the best so far after Ctrl-C; `giajax.write_result` writes it.

        Raises:
            InputError: as `prepare`, a start that cannot be evaluated, or another fit's journal.
        """
        ready = self.prepare()
        if journal is None:
            return ready.run(progress, announce, check=check)
        folder = Path(journal)
        with ready.open_journal(folder, resume=read_journal(folder) is not None) as steps:
            return ready.run(progress, announce, check=check, journal=steps.of)
