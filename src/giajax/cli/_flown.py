"""What `giajax mission` tells and writes."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from ..mission import Cases, Mission, Outcome


def tell(
    mission: "Mission", outcome: "Outcome", out: Path | None, origin: str, *,
    as_json: bool, force: bool,
) -> None:  # fmt: skip
    """Tell and write what came of one mission."""
    from ..mission import recorded
    from ..report import mission_files, mission_json
    from ..runs import make_folder, write_files, write_run
    from ._output import print_table

    if out is not None:
        make_folder(out)
        write_files(
            {out / name: data for name, data in mission_files(mission, outcome).items()},
            force=force,
        )
        run = recorded(mission, outcome, name="run", origin=origin)
        write_run(out / "run.csv", run.times, run.values, definition=run.definition, force=force)
    if as_json:
        typer.echo(mission_json(mission, outcome))
        return
    rows = [
        (
            each.obstacle,
            ", ".join(map(str, each.links)) or None,
            f"{each.duration:.1f}" if each.links else None,
            f"{1e3 * each.flattening:.1f}" if each.links else None,
            f"{each.force:.2f}" if each.links else None,
            f"{each.impulse:.2f}" if each.links else None,
        )
        for each in outcome.touched
    ]
    print_table(["obstacle", "links", "for s", "flattened mm", "most N", "N s"], rows)
    wind = mission.section.wind.speed_m_per_s
    if outcome.reached is None:
        typer.echo(
            f"\nnot inside after {outcome.times[-1]:.0f} s in air of {wind:g} m/s: "
            f"{outcome.reason} (nearest {outcome.nearest:.2f} m)"
        )
    else:
        typer.echo(f"\ninside after {outcome.reached:.1f} s, in air of {wind:g} m/s")
    if out is not None:
        typer.echo(f"wrote {shlex.quote(str(out))}; see: giajax view {out / 'run.csv'}")


def show(mission: "Mission", outcome: "Outcome", page: Path, *, force: bool) -> None:
    """Write a page that plays a mission."""
    from ..mission import motion
    from ..models import arm_scene
    from ..runs import write_files
    from ..viewer import Show, recording

    content = recording([Show("mission", arm_scene(motion(mission, outcome)))])
    write_files({page: content}, force=force)
    typer.echo(f"wrote {page} ({len(content) / 1e6:.1f} MB): open it in a browser", err=True)


def tell_cases(
    mission: "Mission", cases: "Cases", out: Path | None, *, as_json: bool, force: bool
) -> None:
    """Tell and write what came of many missions."""
    from ..report import (
        CASES_FILES,
        cases_files,
        cases_json,
    )
    from ..runs import make_folder, write_files
    from ._output import print_table

    if not cases.cases:
        return
    if out is not None:
        make_folder(out)
        contents = cases_files(mission, cases)
        write_files({out / name: contents[name] for name in CASES_FILES}, force=force)
    if as_json:
        typer.echo(cases_json(mission, cases))
        return
    rows = [
        (
            f"{tally.wind:g}",
            f"{tally.inside} of {len(tally.cases)}",
            None if tally.quartiles is None else f"{tally.quartiles[1]:.0f}",
            str(tally.touched),
            f"{1e3 * tally.flattening:.1f}",
            ", ".join(f"{count}: {reason}" for reason, count in tally.reasons.items()) or None,
        )
        for tally in cases.tallies
    ]
    headings = ["m/s", "inside", "median s", "touched", "flattened mm", "why not"]
    print_table(headings, rows)
    typer.echo(f"\n{cases.seconds:.2f} s for each")
    if out is not None:
        typer.echo(f"wrote {shlex.quote(str(out))}: {', '.join(CASES_FILES)}")
