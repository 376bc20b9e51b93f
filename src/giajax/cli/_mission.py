"""`giajax mission`: an arm moves to an opening, or stays in front of it, once or many times."""

import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import (
    Force,
    Json,
    Quiet,
    Settings,
    argument,
    check_quiet,
    command,
    command_after,
    origin,
    print_table,
    say_written,
    write_folder,
)
from ._values import numbers, settings, with_settings

if TYPE_CHECKING:
    from ..apps.mission import Cases, Certificate, Mission, Outcome


def tell(
    mission: "Mission", outcome: "Outcome", out: Path | None, origin: str, *,
    as_json: bool, force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Print and write the result of one mission."""
    from ..apps.mission import mission_files, mission_json, recorded
    from ..recordings import write_run

    if out is not None:
        write_folder(out, mission_files(mission, outcome), force=force)
        run = recorded(mission, outcome, name="run", origin=origin)
        write_run(out / "run.csv", run.times, run.values, definition=run.definition, force=force)
    if as_json:
        typer.echo(mission_json(mission, outcome))
    if as_json or quiet:
        return
    rows = []
    for each in outcome.touched:
        numbers = (each.duration, 1e3 * each.flattening, each.force, each.impulse)
        shown = [f"{n:.{d}f}" for n, d in zip(numbers, (1, 1, 2, 2), strict=True)]
        cells = [", ".join(map(str, each.links)), *shown] if each.links else [None] * 5
        rows.append([each.obstacle, *cells])
    headings = ["contact s", "flattening mm", "max force N", "impulse N s"]
    print_table(["obstacle", "links", *headings], rows)
    wind = mission.section.wind.speed_m_per_s
    if not mission.enters and math.isfinite(outcome.swing):
        away = mission.opening.centre - outcome.station
        typer.echo(
            f"\nroot mean square motion of the tip {outcome.swing:.2f} m about a mean position "
            f"{float(sum(away**2)) ** 0.5:.2f} m from the opening (second half of "
            f"{outcome.times[-1]:.0f} s), in a wind of {wind:g} m/s"
        )
    elif outcome.reached is None:
        typer.echo(
            f"\nthe tip is not inside the opening after {outcome.times[-1]:.0f} s in a wind of "
            f"{wind:g} m/s: {outcome.reason} (smallest distance {outcome.nearest:.2f} m)"
        )
    else:
        typer.echo(
            f"\nthe tip is inside the opening after {outcome.reached:.1f} s in a wind of {wind:g} "
            "m/s"
        )
    if out is not None:
        typer.echo(f"wrote {shlex.quote(str(out))}; {command_after('view', out / 'run.csv')}")


def tell_cases(
    mission: "Mission",
    cases: "Cases",
    out: Path | None,
    *,
    as_json: bool,
    force: bool,
    quiet: bool,
) -> None:
    """Print and write the results of many missions."""
    from ..apps.mission import CASES_FILES, cases_files, cases_json

    if out is not None:
        write_folder(out, cases_files(mission, cases), force=force)
    if as_json:
        typer.echo(cases_json(mission, cases))
    if as_json or quiet:
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
    headings = ["wind m/s", "in opening", "median time s", "with contact", "max flattening mm"]
    print_table([*headings, "failures"], rows)
    typer.echo(f"\ncomputing time {cases.seconds:.2f} s per mission")
    if out is not None:
        say_written(out, CASES_FILES)


_RUN = ("run.csv", "run.toml")
_LONGEST = 3600.0  # Longest time in front of the opening, s.
_CASES = 200  # Default number of cases with a recording.
_SPEEDS = "0,0.05,0.1,0.15,0.2,0.25,0.3"
_RANGE = "0,0.6"  # Default range of speeds with a recording.


@command(
    """\b
Examples:
  giajax mission missions/naraha.toml
                            fly one mission in the wind given in the file
  giajax mission missions/naraha.toml --speed 0.3 --seed 4 --out flown
                            use another wind, and write files and a run
  giajax mission missions/naraha.toml --controller mpc
                            use model predictive control
  giajax mission missions/naraha.toml --controller mpc --keep-station 300
                            hold the tip in front of the opening for 300 s
  giajax mission missions/naraha.toml --page flown.html
                            write a page that plays the mission
  giajax view flown/run.csv
                            show the run in a browser
  giajax mission missions/naraha.toml --cases 100 --speeds 0,0.1,0.2,0.3
                            compute the success rate versus the wind speed
  giajax mission missions/naraha.toml --from-recording resting.csv
                            estimate the probability of success from a
                            recording of the arm at rest
  giajax mission missions/naraha.toml --case 17 --speed 0.3 --out flown
                            repeat one of the missions flown with --cases

\b
With --out DIR, the command writes
  mission.json, mission.png   time of entry, contacts and path of the tip
  run.csv, run.toml           commands, wind and tip position as a run
or, for many missions,
  cases.json, cases.csv, cases.png
                              success rate and time of entry versus wind speed
or, with a recording,
  certificate.json, certificate.csv, certificate.png
                              success probability, and the underlying missions

MISSION is a TOML file with an arm, [[arm.obstacles]], a [camera.NAME] at the tip, and

\b
  [mission]
  opening = "housetop"        # a wall
  [mission.operator]
  latency_s = 0.4
  approach = {joints = [1, 3], angles_deg = [-20.0, -30.0]}
  [mission.spread]            # for --cases, by parameter
  "joints.damping" = 0.5""",
    group="plan",
    pictures=True,
)
def mission(
    context: typer.Context,
    file: Annotated[Path, argument("MISSION", "Mission file; see below.")],
    speed: Annotated[float | None, "M/S", "Wind speed. [default: from the file]"] = None,
    seed: Annotated[
        int,
        "N",
        "Seed of the random numbers for gusts and pixel noise. With --cases, the seed of the "
        "first mission.",
        0,
    ] = 0,
    case: Annotated[
        int | None, "N", "Repeat the mission with this seed, one of those flown with --cases.", 0
    ] = None,
    controller: Annotated[str, "NAME", "Controller: operator or mpc."] = "operator",
    keep_station: Annotated[
        float | None, "S", "Hold the tip in front of the opening for this time."
    ] = None,
    pairs: Settings = None,
    resting_run: Annotated[
        Path | None,
        "RUN.csv",
        "Estimate the probability of success from a recording of the arm at rest.",
        "--from-recording",
    ] = None,
    cases: Annotated[
        int | None,
        "N",
        "Number of missions for each wind speed, or in total with --from-recording (default 200).",
        1,
    ] = None,
    speeds: Annotated[
        str | None,
        "M/S,M/S",
        f"Wind speeds of the missions. [default: {_SPEEDS} for --cases, the range {_RANGE} for "
        "--from-recording]",
    ] = None,
    out: Annotated[Path | None, "DIR", "Folder for tables and figures."] = None,
    as_json: Json = False,
    page: Annotated[
        Path | None, "FILE.html", "Output file for a page that plays the mission."
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Use a camera to steer an arm to an opening, or hold it there.

    The camera is at the tip. As in the paper's mock-up, there are gusts, joint hysteresis, image
    delay and a time limit. A single mission is written as a run for `giajax view`. Many missions
    give the success rate versus the wind speed.
    """
    from ..recordings import (
        Definition,
        check_output_files,
        check_output_folder,
        read_run,
        write_files,
    )

    check_quiet(quiet, written=out or page, as_json=as_json, by="--out DIR, --page or --json")
    if speeds is None:
        speeds = _SPEEDS if resting_run is None else _RANGE
    flown_at = numbers(speeds)
    if flown_at is None or min(flown_at) < 0:
        raise InputError(
            f"--speeds is '{speeds}': give non-negative numbers separated by commas, such as "
            "0,0.1,0.2"
        )
    flown_at = list(dict.fromkeys(flown_at))
    if speed is not None and not 0 <= speed < math.inf:
        raise InputError(f"--speed is {speed:g}: give a non-negative number")
    if keep_station is not None and not 1 <= keep_station <= _LONGEST:
        raise InputError(
            f"--keep-station is {keep_station:g}: give a time from 1 to {_LONGEST:g} s"
        )
    alone = ("--speed", speed), ("--page", page), ("--case", case), ("--keep-station", keep_station)
    many = (("--from-recording", resting_run), ("--cases", cases))
    other = next((option for option, given in many if given is not None), None)
    for option, given in alone:
        if given is not None and other is not None:
            raise InputError(f"{option} applies to a single mission: omit {other}")
    if page is not None:
        check_output_files([page], force=force)
    values = settings(pairs)
    definition = Definition.load(file)
    configure()
    from ..apps.mission import (
        CASES_FILES,
        CERTIFICATE_FILES,
        FEWEST_CASES,
        MISSION_FILES,
        Mission,
        Resting,
        certificate,
        fly_cases,
        fly_rested,
        motion,
    )  # fmt: skip
    from ..models import ArmModel

    if out is not None:
        names = (*MISSION_FILES, *_RUN) if cases is None else CASES_FILES
        names = names if resting_run is None else CERTIFICATE_FILES
        check_output_folder(out, names, force=force)
    model = with_settings(ArmModel.stated_in(definition), values) if values else None
    planned = Mission.from_definition(definition, str(file), controller=controller, model=model)
    if keep_station is not None:
        planned = planned.keeping_station(keep_station)
    on_case = None if quiet else _progress()
    if resting_run is not None:
        count = _CASES if cases is None else cases
        if count < FEWEST_CASES:
            raise InputError(f"--cases is {count}: give at least {FEWEST_CASES} missions")
        recorded = read_run(resting_run, definition=definition)
        resting = Resting.from_run(recorded, planned.model)
        if recorded.winds and not quiet:
            typer.echo("note: the recorded wind is not used", err=True)
        span = min(flown_at), max(flown_at)
        rested = fly_rested(planned, resting, span, count, seed=seed, on_case=on_case)
        if len(rested) == count or len(rested) > FEWEST_CASES:
            found = certificate(resting.channels, resting.shown(), rested)
            where = {
                "recording": str(resting_run),
                "channels": list(resting.channels),
                "speeds_m_per_s": list(span),
                "seed": seed,
            }
            tell_certificate(planned, found, out, where, as_json=as_json, force=force, quiet=quiet)
        _check_all_flown(len(rested), count)
        return
    if cases is not None:
        done = fly_cases(planned, flown_at, cases, seed=seed, on_case=on_case)
        if done.cases:
            tell_cases(planned, done, out, as_json=as_json, force=force, quiet=quiet)
        _check_all_flown(len(done.cases), cases * len(flown_at))
        return
    if speed is not None:
        planned = planned.in_wind(speed)
    if page is not None:
        from ..apps.viewer import check_viser

        check_viser()
    flown = planned if case is None else planned.case(case)
    outcome = flown.fly(seed if case is None else case, drawn=planned)
    how: dict[str, Any] = {"as_json": as_json, "force": force, "quiet": quiet}
    tell(flown, outcome, out, origin(context), **how)
    if page is not None:
        from ..apps.viewer import Show, recording
        from ..models import arm_scene

        content = recording([Show("mission", arm_scene(motion(flown, outcome)))])
        write_files({page: content}, force=force)
        if not quiet:
            size = f"{len(content) / 1e6:.1f} MB"
            typer.echo(f"wrote {page} ({size}): open it in a browser", err=True)


def tell_certificate(
    mission: "Mission",
    found: "Certificate",
    out: Path | None,
    origin: dict[str, Any],
    *,
    as_json: bool,
    force: bool,
    quiet: bool,
) -> None:
    """Print and write the probability of success of a mission, and its basis."""
    from ..apps.mission import CERTIFICATE_FILES, certificate_files, certificate_json

    if out is not None:
        write_folder(out, certificate_files(mission, found, **origin), force=force)
    if found.unlike and not quiet:
        typer.echo(
            "note: the recording does not resemble any of the simulated arms at rest. Either the "
            "recorded arm differs from the arm in the file, or the wind speed exceeds --speeds: do "
            "not rely on the probability",
            err=True,
        )
    if as_json:
        typer.echo(certificate_json(mission, found, **origin))
    if as_json or quiet:
        return
    low, high = (100 * each for each in found.interval)
    least, middle, most = found.air
    inside = sum(case.reached is not None for case in found.near)
    typer.echo(
        f"{inside} of the {len(found.near)} missions (of {len(found.cases)}) whose motion at rest "
        f"is most similar to the recording are successful. The wind speed in these missions is "
        f"{least:.2f} to {most:.2f} m/s, with a median of {middle:.2f} m/s.\n\n"
        f"probability of success within {mission.section.limit_s:g} s: {100 * found.chance:.0f} % "
        f"(95 % interval: {low:.0f} to {high:.0f} %)"
    )
    if out is not None:
        say_written(out, CERTIFICATE_FILES)


def _check_all_flown(done: int, whole: int) -> None:
    """End with the status of Ctrl-C if it ended the flights."""
    if done < whole:
        typer.echo(f"stopped after {done} of {whole} missions", err=True)
        raise typer.Exit(130)


def _progress() -> Callable[[int, int], None] | None:
    """Return a function that prints the number of finished missions; None without a terminal."""

    def say(done: int, whole: int) -> None:
        end = "\n" if done == whole else ""
        print(f"\rflown {done} of {whole} missions", end=end, file=sys.stderr, flush=True)

    return say if sys.stderr.isatty() else None
