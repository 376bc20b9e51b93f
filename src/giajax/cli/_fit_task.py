"""Which task the arguments of `giajax fit` name, before its options are put on top."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from ..tasks import FitTask


def named_task(
    definition: Path | None,
    config: Path | None,
    again: Path | None,
    resume: Path | None,
    has_data: bool,
) -> "FitTask":
    """The task of a fit definition, of a result, of a journal, or of data alone.

    Arguments:
        definition, config: the fit definition as argument and as option; at most one of them.
        again: the result whose numbers are to come again.
        resume: the folder whose journal is to be gone on with.
        has_data: whether there is data on the command line.
    """
    from ..runs import Definition
    from ..tasks import FitTask

    if definition is not None and config is not None:
        raise typer.BadParameter(
            "there are two fit definitions: give one, as argument or by --config, not both"
        )
    source = definition or config
    if again is not None:
        if source is not None or has_data or resume is not None:
            raise typer.BadParameter(
                "--again takes data and settings from the result: leave out the others"
            )
        return FitTask.again(again)
    if source is not None:
        return FitTask.load(source)
    if resume is not None and not has_data:
        return FitTask.resumed(resume)
    return FitTask(Definition())
