"""`giajax check`: what a recording holds."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ._options import Renamed
from ._registry import command


@command("""\b
Examples:
  giajax check run.csv
  giajax check camera.csv --rename t=time_s --rename "z 6"=link06_z_m
  giajax check run.csv --json""")
def check(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run, a .csv or .parquet file.")],
    rename: Renamed = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Say what a run holds.

    Model, samples, commands, channels with their range and noise, and what is assumed because
    the sidecar does not state it.
    """
    from ..runs import describe, parse_rename, read_run

    facts = describe(read_run(run, rename=parse_rename(rename or [])))
    if as_json:
        import json

        typer.echo(json.dumps(facts, indent=2))
    else:
        _show(facts)


def _show(facts: dict[str, Any]) -> None:
    from ._output import print_table

    print_table(["", ""], _summary(facts), left=2)
    print()
    headings = ["channel", "part", "unit", "values", "missing %", "min", "max", "noise"]
    print_table(headings, [_row(channel) for channel in facts["channels"]], left=3)
    if facts["notes"]:
        print()
    for note in facts["notes"]:
        print(f"note: {note}")


def _summary(facts: dict[str, Any]) -> list[tuple[str, str]]:
    from ..kinds import KINDS

    rows = [("run", facts["path"]), ("model", facts["model"]), ("rows", str(facts["rows"]))]
    if facts["time"] is not None:
        rows.append(("time", _time(facts["time"])))
    command, wind, sidecar = facts["command"], facts["wind"], facts["sidecar"]
    if command is not None:
        names, corners = ", ".join(command["channels"]), command["corners"]
        rows.append(("command", f"{names}; {command['interpolation']}, {corners} corners"))
    elif KINDS[facts["model"]].uncommanded:
        rows.append(("command", KINDS[facts["model"]].uncommanded))
    if wind is not None and wind["source"] == "constant":
        rows.append(("wind", f"constant, {wind['velocity_m_per_s']} m/s"))
    elif wind is not None:
        rows.append(("wind", f"{', '.join(wind['channels'])}; {wind['interpolation']}"))
    if sidecar is None:
        rows.append(("sidecar", "none"))
    else:
        sections = dict.fromkeys(key.partition(".")[0] for key in sidecar["keys"])
        rows.append(("sidecar", f"{sidecar['path']}, checksum {sidecar['checksum']}"))
        rows.append(("stated", ", ".join(sections)))
    return rows


def _time(time: dict[str, float]) -> str:
    span = f"{time['start_s']:.6g} to {time['end_s']:.6g} s"
    median, least, most = (time[f"interval_{which}_s"] for which in ("median", "min", "max"))
    if most - least <= 1e-6 * median:
        return f"{span}, every {median:.6g} s"
    return f"{span}, every {median:.6g} s (median; from {least:.6g} to {most:.6g} s)"


def _row(channel: dict[str, Any]) -> list[Any]:
    texts = channel.get("texts")
    if texts is not None:
        counts = ", ".join(f"{count} {text}" for text, count in texts.items())
        return [channel["name"], channel["part"], "text", counts, "0", None, None, None]
    missing = f"{channel['missing_percent']:.3g}"
    measured = [channel[key] for key in ("min", "max", "noise")]
    unit = channel["unit"] or None
    return [channel["name"], channel["part"], unit, channel["count"], missing, *measured]
