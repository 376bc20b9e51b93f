"""`giajax suspects`: what the residuals of a fit ask for."""

import dataclasses
import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._commands import Paths, Texts
from ._on_result import OnResult, on_result
from ._options import print_table
from ._values import plain_settings

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..studies import Step, StepwiseSelection, Suspects


@on_result(
    """\b
Examples:
  giajax suspects giajax-out/run
  giajax suspects giajax-out/run --ladder
  giajax suspects giajax-out/run --ladder --tries 1
  giajax suspects giajax-out/run --ladder --held-out other.csv
  giajax suspects giajax-out/run --systematic --uncertainty links.mass=0.002
  giajax suspects giajax-out/run --json

\b
RESULT is the folder of a fit, or its result.json. The runs are read again from
where they were. The most promising suspect comes first: what lowers chi-square most.
--ladder fits the first few, takes the one whose fit has the lowest BIC, asks again,
and so on, as long as BIC falls: minutes for each step of a long arm, and fewer with
--tries 1, which takes the first one at its word.""",
    out=("FILE.json", "Write the result with its suspects there."),
    force="Write over a file.",
    as_json="Print JSON instead of tables.",
    quiet="No progress.",
)
def suspects(
    given: OnResult,
    each: Annotated[Texts, "PATH", "Test the elements of this array one by one, too."] = None,
    systematic: Annotated[bool, "Show what held numbers do to the fitted ones."] = False,
    uncertainty: Annotated[Texts, "PATH=VALUE", "Standard deviation of a held number."] = None,
    ladder: Annotated[bool, "Fit the most promising suspects in turn."] = False,
    held_out: Annotated[Paths, "RUN.csv", "A run to judge the ladder by."] = None,
    most: Annotated[int, "N", "Rows of the table and steps of the ladder.", 1] = 8,
    tries: Annotated[int | None, "N", "Suspects that each step of the ladder fits (3).", 1] = None,
) -> None:
    """Test what a fit held, switched off or left out.

    Which of it would lower chi-square, and to which value one step leads: added mass, a late
    camera, wind, friction, swapped axes and all else that the model knows.
    """
    from ..recordings import Definition, check_output_files, read_runs, write_files
    from ..tasks import held_out_runs

    deviations = plain_settings(uncertainty, "--uncertainty")
    if given.out is not None:
        check_output_files([given.out], force=given.force)
    if held_out and not ladder:
        raise typer.BadParameter("--held-out judges the fits of a ladder: add --ladder")
    if tries is not None and not ladder:
        raise typer.BadParameter("--tries is how many fits a step of a ladder makes: add --ladder")
    fitted, runs = given.fitted, given.runs
    from ..report import (
        SUSPECT_HEADINGS,
        stepwise_table,
        suspect_rows,
        suspect_summary,
        systematic_table,
    )
    from ..studies import TRIES, ladder as selected, suspects as tested, with_systematic_errors

    others = read_runs(held_out or [], Definition(), rename=given.renamed)
    found = tested(fitted, runs, each=each or [])
    fitted = dataclasses.replace(fitted, suspects=found.rows)
    fitted = with_systematic_errors(fitted, runs, deviations or None)
    shown = not (given.as_json or given.quiet)
    if shown:
        if rows := suspect_rows(found, most):
            print_table(SUSPECT_HEADINGS, rows)
            print()
        print("\n".join(suspect_summary(found)))
        if systematic or deviations:
            print("\nwhat a held number moves, in standard errors:")
            print_table(*systematic_table(fitted))
    steps = None
    if ladder:
        others += held_out_runs(fitted, given.data or [], rename=given.renamed)
        said = None if given.quiet else _say
        steps = selected(
            fitted, runs, held_out=others, most=most, tries=tries or TRIES, progress=said
        )
        if shown:
            print()
            print_table(*stepwise_table(steps))
            print("\n" + "\n".join([steps.ending, *steps.result.conditions]))
    if given.out is not None:
        write_files({given.out: fitted.to_json().encode()}, force=given.force)
    if given.as_json:
        from ..runtime.records import plain_data

        typer.echo(json.dumps(plain_data(_facts(fitted, found, steps)), indent=2))


def _say(step: "Step") -> None:
    added = "the fit" if step.suspect is None else step.change
    typer.echo(f"{added}: chi-square {step.chi_square:.5g}", err=True)


_STEP = ("removed", "chi_square", "aic", "bic", "held_out")


def _facts(
    result: "FitResult", found: "Suspects", steps: "StepwiseSelection | None"
) -> dict[str, Any]:
    """What `--json` prints."""
    facts: dict[str, Any] = {key: getattr(found, key) for key in ("chi_square", "values", "asked")}
    facts |= {"suspects": result.suspects, "systematic": result.systematic}
    if steps is not None:
        facts["ladder"] = {
            "ending": steps.ending,
            "rungs": [
                {
                    "path": None if step.suspect is None else step.suspect.path,
                    **{key: getattr(step, key) for key in _STEP},
                    "parameters": step.result.parameters,
                }
                for step in steps.steps
            ],
        }
    return facts
