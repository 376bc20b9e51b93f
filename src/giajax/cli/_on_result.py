"""Framework of the commands on a result: their shared options, and the output of their records.

Such a command has its own options, calls its study and passes on the record. The type of the record
determines how it is shown (`giajax.report.RecordView`).
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure
from ._commands import (
    Figures,
    Folder,
    Force,
    Json,
    ManyProgress,
    Paths,
    Quiet,
    Renamed,
    Scheduler,
    Workers,
    argument,
    command,
    command_after,
    end_if_stopped,
    print_table,
    say_written,
    with_signature,
)

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..recordings import Run

_RESULT = Annotated[Path, argument("RESULT", "A fit; see below.")]


@dataclasses.dataclass(frozen=True)
class OnResult:
    """Shared options of the commands on a result; defaults for options that a command lacks."""

    result: Path
    data: list[Path] | None = None
    rename: list[str] | None = None
    workers: int | None = None
    scheduler: str | None = None
    folder: Path | None = None
    out: Path | None = None
    page: Path | None = None
    figures: bool = False
    force: bool = False
    as_json: bool = False
    quiet: bool = False

    @functools.cached_property
    def home(self) -> Path:
        """The folder of the result; a missing result is rejected before JAX is imported."""
        from ..recordings import stored_result

        return stored_result(self.result)[0]

    @functools.cached_property
    def renamed(self) -> Mapping[str, str]:
        """New names of columns of the files."""
        from ..recordings import parse_rename

        return parse_rename(self.rename or [])

    @functools.cached_property
    def fitted(self) -> "FitResult":
        """The result; errors that can be found without JAX are raised first."""
        _ = self.home, self.renamed
        configure()
        from ..fitting import load_result

        return load_result(self.result)

    @functools.cached_property
    def runs(self) -> "list[Run]":
        """The fitted runs."""
        from ..tasks import fitted_runs

        return fitted_runs(self.fitted, self.data or [], rename=self.renamed, folder=self.home)

    def computed(self, study: Callable[..., Any], what: str, **settings: Any) -> Any:
        """Return the result of a study of the fit, computed by the requested workers.

        `what` is the name of its tasks. The settings may override `folder` and `progress`.
        """
        from ..runtime.execution import open_executor

        usual = {"folder": self.folder, "progress": None if self.quiet else ManyProgress(what)}
        fitted, runs = self.fitted, self.runs
        with open_executor(self.workers, self.scheduler) as executor:
            return study(fitted, runs, executor=executor, **{**usual, **settings})

    def record(self, study: str, *, most: int | None = None, **settings: Any) -> None:
        """Compute a record, write it and its figure beside the result, and show it.

        The study is a function of `giajax.studies`. The file is `STUDY.json`.
        """
        path = self.checked(study)
        fitted = self.fitted
        from .. import studies

        found = self.computed(getattr(studies, study), "parts", **settings)
        files = record_files(found, fitted, path, figures=self.figures)
        self.finish(found, files, force=self.force, most=most)
        end_if_stopped(self.folder)

    def checked(self, study: str) -> Path:
        """Return the file of a study after a check; it is in `out`, or else beside the result."""
        from ..recordings import check_output_folder

        path = (self.home if self.out is None else self.out) / f"{study}.json"
        if self.out is not None and self.out.suffix == ".json":
            path = self.out  # The path of the file itself, while old forms are accepted.
        pictures = [path.with_suffix(".png").name] if self.figures else []
        check_output_folder(path.parent, [path.name, *pictures], force=self.force)
        return path

    def finish(
        self, found: Any, files: Mapping[Path, bytes], *, force: bool, most: int | None = None
    ) -> None:
        """Write files and print a record."""
        from ..recordings import make_folder, write_files

        for folder in {path.parent for path in files}:
            make_folder(folder)
        write_files(files, force=force)
        if self.as_json:
            typer.echo(found.to_json(), nl=False)
        elif not self.quiet:
            show(found, self.fitted, most)
            self.say_written(next(iter(files)).parent, [path.name for path in files])

    def say_written(self, folder: Path, names: Iterable[str]) -> None:
        """Print which files were written, and how to show those beside the result."""
        say_written(folder, names)
        if folder == self.home:
            there = ["--force"] if (folder / "report.html").exists() else []
            typer.echo(command_after("report", self.result, *there))


def record_files(
    found: Any, result: "FitResult", path: Path, *, figures: bool
) -> dict[Path, bytes]:
    """Return the file of a record, and its figure beside it."""
    from ..report import to_png, view_of

    files = {path: found.to_json().encode()}
    draw = view_of(found).figure
    if figures and draw is not None:
        files[path.with_suffix(".png")] = to_png(draw(found, result))
    return files


def show(found: Any, result: "FitResult", most: int | None = None) -> None:
    """Print the table and the sentences of a record."""
    from ..report import view_of

    view = view_of(found)
    headings, rows, words = view.table(found, result, most)
    print_table(headings, rows, left=words)
    print("\n" + "\n".join(view.sentences(found, most)))


def on_result(
    examples: str,
    *,
    group: str,
    workers: bool = False,
    folder: bool = False,
    out: str | None = None,
    page: str | None = None,
    figures: bool = False,
    pictures: bool = False,
    as_json: bool = False,
    old: Mapping[str, str | tuple[str, ...]] | None = None,
    old_words: str = "",
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function of `OnResult` and its own options a command on a result.

    The arguments `out` and `page` are the help texts of these options, which exist only if a text
    is given. A command with tasks has `workers`, and `folder` if it can store them. A command with
    `figures`, or one that always draws, has `pictures`. All other arguments are those of `command`.
    """
    shared: list[tuple[str, Any, Any]] = [
        (
            "data",
            Annotated[Paths, "RUN.csv", "New path of a fitted run whose file was moved."],
            None,
        ),
        ("rename", Renamed, None),
        ("workers", workers and Workers, None),
        ("scheduler", workers and Scheduler, None),
        ("folder", folder and Folder, None),
        ("out", out and Annotated[Path | None, "DIR", out], None),
        ("page", page and Annotated[Path | None, "FILE.html", page], None),
        ("figures", figures and Figures, True),
        ("force", Force, False),
        ("as_json", as_json and Json, False),
        ("quiet", Quiet, False),
    ]
    added = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, kind, default in shared
        if kind
    ]
    result = Parameter("result", Parameter.KEYWORD_ONLY, annotation=_RESULT)

    def register(function: Callable[..., None]) -> Callable[..., None]:
        own = list(inspect.signature(function, eval_str=True).parameters.values())[1:]

        @functools.wraps(function)
        def run(**options: Any) -> None:
            given = OnResult(**{each.name: options.pop(each.name) for each in (result, *added)})
            function(given, **options)

        keywords = [each.replace(kind=Parameter.KEYWORD_ONLY) for each in own]
        registered = command(
            examples,
            group=group,
            pictures=pictures or figures,
            old=old,
            old_words=old_words,
        )
        return registered(with_signature(run, [result, *keywords, *added]))

    return register
