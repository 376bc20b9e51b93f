"""`giajax bootstrap` and `giajax influence`: a fit repeated, and without parts of its data."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.text import InputError
from ._on_result import OnResult, on_result, record_files, show
from ._options import ManyProgress

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..recordings import Run

# Repetitions of a self-test: the spread within 7 %, in about a minute for a fit of some seconds.
_SELF_TEST = 96

_KEPT = "Keep each task there; what is there is not done again."


@on_result(
    """\b
Examples:
  giajax bootstrap giajax-out/run
  giajax bootstrap giajax-out/run --size 400 --workers 2
  giajax bootstrap giajax-out/run --block --out blocks.json
  giajax bootstrap giajax-out/run --whole --size 100 --folder repetitions

\b
RESULT is the folder of a fit, or its result.json. The runs are read again from
where they were. Writes bootstrap.json and bootstrap.png beside the result, where
giajax report finds them. Ctrl-C keeps what was done; with --folder DIR the same
command and --force go on from there.""",
    workers=True,
    folder=_KEPT,
    out=("FILE.json", "Where it goes (bootstrap.json beside RESULT)."),
    figures="Draw the repetitions.",
    as_json="Print JSON instead of tables.",
)
def bootstrap(
    given: OnResult,
    size: Annotated[int, "N", "Repetitions.", 2] = 200,
    block: Annotated[bool, "With blocks of the residuals, not noise of a model."] = False,
    whole: Annotated[bool, "Fit each as the data were, noise and all."] = False,
    seed: Annotated[int, "N", "Of all random numbers.", 0] = 0,
) -> None:
    """Repeat a fit with noise drawn anew: are its errors right, and does it come back?

    Bias, spread and intervals of the repetitions, and how often the 95 % interval holds the truth.
    """
    method = "block" if block else "parametric"
    given.record("bootstrap", size=size, method=method, whole=whole, seed=seed)


def self_test(
    result: "FitResult", runs: "Sequence[Run]", folder: Path, *, shown: bool
) -> list[Path]:
    """Repeat a fit that has just ended, write it beside the result and show it.

    No files are written where nothing could be repeated, which a sentence says.
    """
    from ..recordings import write_files
    from ..studies import bootstrap as repeat

    if shown:
        typer.echo("\nself-test: the fit repeated with noise drawn anew", err=True)
    progress = ManyProgress("parts") if shown else None
    try:
        found = repeat(result, runs, size=_SELF_TEST, progress=progress)
    except InputError as error:
        typer.echo(f"giajax: no self-test: {error}", err=True)
        return []
    files = record_files(found, result, folder / "bootstrap.json", figures=True)
    write_files(files, force=True)
    if shown:
        print()
        show(found, result)
    return list(files)


@on_result(
    """\b
Examples:
  giajax influence giajax-out/run
  giajax influence giajax-out/both --exact --workers 2
  giajax influence giajax-out/run --spans 20 --out spans.json

\b
RESULT is the folder of a fit, or its result.json. The runs are read again from
where they were. Writes influence.json and influence.png beside the result, where
giajax report finds them.""",
    workers=True,
    folder=_KEPT,
    out=("FILE.json", "Where it goes (influence.json beside RESULT)."),
    figures="Draw a map.",
    as_json="Print JSON instead of tables.",
)
def influence(
    given: OnResult,
    exact: Annotated[bool, "Fit without each marker, channel and span, too."] = False,
    spans: Annotated[int, "N", "Spans of time of each run; 1 for none.", 1] = 10,
    most: Annotated[int, "N", "Rows of the table.", 1] = 20,
) -> None:
    """Tell what each run, marker, channel and span of time does to each parameter.

    Without it, how far would the parameter move, and how large would its error be?
    """
    given.record("influence", most=most, exact=exact, spans=spans)
