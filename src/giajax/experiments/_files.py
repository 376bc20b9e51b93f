"""The 1-link experiment as files."""

from pathlib import Path

import numpy as np

from ..report import to_csv, to_png
from ..runs import check_output_folder, make_folder, write_files, write_run
from ._figure_12 import figure_12
from ._one_link import OneLink

ONE_LINK_FILES = (
    "fig12.png",
    "fig12.csv",
    "errors.csv",
    "result.json",
    "recording.csv",
    "recording.toml",
)
"""What the 1-link experiment writes."""


def write_one_link(study: OneLink, folder: Path, *, force: bool = False) -> list[Path]:
    """Write the picture, its numbers, the errors, the recording and the fit.

    Arguments:
        study: what to write.
        folder: where; made if it is missing.
        force: write over files that are there.

    Returns:
        The paths of the files.

    Raises:
        InputError: the folder cannot be made, or (without `force`) a file is there.
    """
    check_output_folder(folder, ONE_LINK_FILES, force=force)
    make_folder(folder)
    contents = {
        folder / "fig12.png": to_png(figure_12(study)),
        folder / "fig12.csv": to_csv(one_link_table(study)),
        folder / "errors.csv": _errors(study).encode(),
        folder / "result.json": study.result.to_json().encode(),
    }
    write_files(contents, force=force)
    run = study.recording
    recording = folder / "recording.csv"
    write_run(recording, run.times, run.values, definition=run.definition, force=force, digits=7)
    return [*contents, recording, recording.with_suffix(".toml")]


def one_link_table(study: OneLink) -> dict[str, list[str]]:
    """Every sample of every trial: the numbers of fig. 12.

    Arguments:
        study: the experiment.

    Returns:
        Columns of equal length, in the units that their names say; an empty cell was not measured.
    """
    columns: dict[str, list[str]] = {
        name: []
        for name in ("history", "compensation", "time_s", "target_deg", "command_deg", "angle_deg")
    }
    for trial in study.trials:
        plan = trial.history
        for time, target, command, angle in zip(
            plan.times, plan.target, trial.commands, trial.angles, strict=True
        ):
            cells = (
                plan.name,
                trial.compensation,
                f"{time:g}",
                f"{target:g}",
                f"{command:.4f}",
                "" if np.isnan(angle) else f"{angle:.4f}",
            )
            for column, cell in zip(columns.values(), cells, strict=True):
                column.append(cell)
    return columns


def _errors(study: OneLink) -> str:
    lines = ["history,compensation,mean_error_deg,largest_error_deg"]
    for trial in study.trials:
        names = f"{trial.history.name},{trial.compensation}"
        lines.append(f"{names},{trial.mean:.4f},{trial.largest:.4f}")
    return "\n".join(lines) + "\n"
