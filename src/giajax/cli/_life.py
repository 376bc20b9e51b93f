"""`giajax life`: an arm is unrolled, filled, raised, flown on its mission and deflated."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.process import configure
from ._commands import (
    Force,
    Json,
    Quiet,
    Settings,
    argument,
    check_quiet,
    command,
    origin,
    print_table,
    say_written,
    write_folder,
)
from ._values import settings, with_settings

if TYPE_CHECKING:
    from ..apps.life import Life

_RUN = ("run.csv", "run.toml")
_PAGE = "life.html"


@command(
    """\b
Examples:
  giajax life missions/naraha.toml --out life
                            simulate all phases; write files and a page
  giajax life missions/naraha.toml --set supply.flow=0.0005 --no-page
                            use half the gas flow; print a table
  giajax life missions/naraha.toml --seed 4 --json
                            use other gusts; print JSON

\b
With --out DIR, the command writes
  life.json, life.csv     time, gas, lift, force margin, energy of each phase
  life.png                gas, pressures and work as a figure
  life.html               a page that plays all phases
  run.csv, run.toml       the mission as a run

MISSION is a mission file, as for `giajax mission`. The sections [unrolling] and [filling]
of this file set the properties of the roll and of the gas supply.""",
    group="arm",
    pictures=True,
)
def life(
    context: typer.Context,
    file: Annotated[Path, argument("MISSION", "Mission file, as for 'giajax mission'.")],
    seed: Annotated[int, "N", "Seed of the random numbers for gusts and pixel noise.", 0] = 0,
    pairs: Settings = None,
    out: Annotated[Path | None, "DIR", "Folder for tables, a figure and a page."] = None,
    no_page: Annotated[bool, "Do not write the page."] = False,
    as_json: Json = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Unroll, fill, raise, fly and deflate an arm in one run.

    Gas is fed until every link withstands the pull of a muscle. The mission is flown at the
    pressures reached at that time. Reports time, gas and energy of each phase, and the balances of
    helium, energy and momentum.
    """
    from ..recordings import Definition, check_output_folder, write_run

    check_quiet(quiet, written=out, as_json=as_json, by="--out DIR or --json")
    values = settings(pairs)
    definition = Definition.load(file)
    configure()
    from ..apps.life import LIFE_FILES, life_files, life_json, life_show, live
    from ..apps.mission import Mission, recorded
    from ..mechanics.inflation import Filling
    from ..mechanics.unrolling import Unrolling
    from ..models import ArmModel
    from ..schema import FILM, GAS, HAND, PORTS, ROLL, SKIN, SUPPLY

    paged = out is not None and not no_page
    if paged:
        from ..apps.viewer import check_viser, recording

        check_viser()
    names = (*LIFE_FILES, *_RUN, *([_PAGE] if paged else []))
    if out is not None:
        check_output_folder(out, names, force=force)
    # Parameters that are not those of the arm belong to the roll or the gas.
    groups = (GAS, SKIN, PORTS, SUPPLY, ROLL, FILM, HAND)
    others = {each.path for group in groups for each in group}
    own = {path: value for path, value in values.items() if path.partition("[")[0] in others}
    model = ArmModel.stated_in(definition)
    model = with_settings(model, {k: v for k, v in values.items() if k not in own})
    mission = Mission.from_definition(definition, str(file), model=model)
    filling = Filling.from_section(definition.filling, model.arm)
    unrolling = with_settings(Unrolling.from_section(definition.unrolling, filling), own)
    watched = sys.stderr.isatty() and not quiet
    say = (lambda what: typer.echo(f"{what} ...", err=True)) if watched else None
    found = live(mission, unrolling, seed=seed, on_phase=say)
    if out is not None:
        files = life_files(found)
        if paged:
            if say is not None:
                say("page")
            files[_PAGE] = recording([life_show(found)])
        write_folder(out, files, force=force)
        run = recorded(found.mission, found.outcome, name="run", origin=origin(context))
        write_run(out / "run.csv", run.times, run.values, definition=run.definition, force=force)
    if as_json:
        typer.echo(life_json(found))
    if as_json or quiet:
        return
    _show(found)
    if out is not None:
        say_written(out, names)


def _show(life: "Life") -> None:
    """Print a row for each phase, and the results for the whole life."""
    rows = []
    for each in life.phases:
        rows.append(
            (
                each.name,
                f"{(each.end - each.begin) / 60:.2f}",
                f"{1e3 * each.fed:.2f}",
                f"{1e3 * each.let_out:.2f}",
                f"{1e3 * each.lift:.1f}",
                f"{each.margin:.1f}",
                str(each.weakest),
                ", ".join(each.obstacles) or None,
                f"{each.energy.gained:.3f}",
                f"{each.energy.lost:.3f}",
                f"{each.energy.stored:.3f}",
            )
        )
    headings = ["phase", "duration min", "gas in g", "gas out g", "lift g", "margin N", "at link"]
    print_table([*headings, "touched", "gained J", "lost J", "stored J"], rows)
    outcome = life.outcome
    how = f"the tip is not inside the opening: {outcome.reason}"
    if outcome.reached is not None:
        how = f"the tip is inside the opening after {outcome.reached:.1f} s of the mission"
    typer.echo(f"\n{how}; total duration {life.duration / 60:.1f} min")
    _, _, feed, _, mission, *_ = life.phases
    fed = f"after gas was fed for another {feed.end - feed.begin:.1f} s"
    holds = f"every link withstands the maximum pull of a muscle ({life.pull:.1f} N) {fed}"
    if mission.margin < 0:
        holds += f", but during the mission link {mission.weakest} does not withstand it"
    typer.echo(holds)
    typer.echo(
        f"relative imbalance: {life.helium:.1e} of the helium, {life.energy_imbalance:.1e} of the "
        f"exchanged energy, {life.momentum_imbalance:.1e} of the impulses"
    )
    typer.echo(
        "the balances of the mission are from a second simulation, whose joint angles differ by "
        f"at most {life.apart:.1e} rad"
    )
