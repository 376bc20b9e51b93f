"""Make the runs of this folder again, or check that they still come out the same.

    python data/synthetic/regenerate.py           write all of them (`make synthetic`)
    python data/synthetic/regenerate.py --check   compare: exit status 1 where one differs

Each run is one `giajax simulate` command line of the table below. `--check` compares the files
with the checksums in their sidecars, and their values with newly simulated ones. Two machines
do not round alike in the last bit, so values are compared before they are rounded to the digits
of the file.
"""

import contextlib
import io
import os
import shlex
import sys
import tempfile
from pathlib import Path

import numpy as np

from giajax import InputError, read_run
from giajax.cli import main as giajax
from giajax.runs import sidecar_path

HERE = Path(__file__).resolve().parent

DIGITS = 6
# What another machine may change a value by, in SI: far below the noise, far above rounding.
ALLOWED = 1e-6

_EXACT = f"--tolerance 1e-10 --digits {DIGITS}"
_ARM = (
    "--set air.drag_coefficient=1.27 --set joints.pitch_stiffness=3.6 "
    "--set joints.yaw_stiffness=37 --set joints.damping=0.04"
)

# Name: what it is, and the options of `giajax simulate`.
RUNS = {
    "base_step": (
        "The paper's experiment: the base joint to 30 deg within a second, four links filmed "
        "from the side.",
        "--set air.drag_coefficient=1.12 --set joints.pitch_stiffness=2.7 "
        "--set joints.yaw_stiffness=33 --set joints.damping=0.065 --ramp 1=30@0.5:1 "
        "--channels link02_z,link06_z,link12_z,link20_z --noise 0.02 --seed 1",
    ),
    "pitch_yaw": (
        "Two pitch and two yaw joints move in turn; every link is tracked, and one cell in ten "
        "is lost.",
        f"{_ARM} --ramp 1=25@0.5:1 --ramp 1=-5@9:2 --ramp 1=15@17:1.5 --ramp 2=-20@1:1.5 "
        "--ramp 2=15@11:2 --ramp 9=18@3:1 --ramp 9=-10@14:1 --ramp 10=-25@5:1.5 "
        "--ramp 10=12@16:2 --channels all --noise 0.01 --missing 10 --seed 2",
    ),
    "wind": (
        "The same arm as in pitch_yaw, in a breeze that gusts and turns, recorded with the run.",
        f"{_ARM} --command inputs/wind.csv --channels link06,link12,link20,tip --noise 0.015 "
        "--missing 5 --seed 3",
    ),
    "short_arm_steps": (
        "An arm of six links whose commands jump; the angles of its joints are measured too.",
        "--links 6 --set air.drag_coefficient=1.05 --set joints.pitch_stiffness=2.2 "
        "--set joints.yaw_stiffness=18 --set joints.damping=0.09 --duration 15 --step 1=30@0.5 "
        "--step 1=0@8 --step 2=20@2 --step 3=-25@5 --channels joints,link03,tip --noise 0.01 "
        "--noise-angle 0.5 --seed 4",
    ),
}


def wind_input() -> str:
    """The table behind `wind.csv`: commands, and a steady breeze with three gusts in it."""
    times = np.linspace(0.0, 25.0, 51)
    commands = [
        np.interp(times, [1, 3, 10, 13], [0, 20, 20, -5]),
        np.interp(times, [2, 4, 12, 15], [0, 15, 15, -15]),
    ]

    def gust(at: float, width: float) -> np.ndarray:
        return np.exp(-(((times - at) / width) ** 2))

    wind = [
        0.05 + 0.06 * np.sin(0.5 * times),
        0.20 + 0.25 * gust(7, 1.5) - 0.35 * gust(16, 2) + 0.05 * np.sin(1.1 * times),
        -0.03 + 0.12 * gust(11, 1) + 0.1 * gust(20, 1.5),
    ]
    header = "time_s,joint01_command_deg,joint02_command_deg," + ",".join(
        f"wind_{axis}_m_per_s" for axis in "xyz"
    )
    rows = np.stack([times, *commands, *wind], axis=1) + 0.0
    lines = [",".join(f"{value:.3f}" for value in row) for row in rows]
    return "\n".join([header, *lines]) + "\n"


def command_line(name: str) -> str:
    """The command that makes a run, to be given in this folder."""
    return f"giajax simulate --out {name}.csv {RUNS[name][1]} {_EXACT}"


def make(name: str, out: Path, *more: str) -> None:
    """Simulate one run of the table."""
    words = [*shlex.split(command_line(name))[1:], *more, "--out", str(out), "--force"]
    said = io.StringIO()
    with contextlib.chdir(HERE), contextlib.redirect_stdout(said):
        status = giajax(words)
    if status:
        raise SystemExit(f"{command_line(name)} ended with status {status}")


def readme() -> str:
    """The text of README.md, from the table and the sidecars."""
    lines = [
        "# Synthetic runs",
        "",
        "Made by `giajax simulate`, with noise and gaps, and written by `regenerate.py`",
        "(`make synthetic`) together with this text; `regenerate.py --check` compares them with",
        "newly simulated ones. Each sidecar states the arm, the noise, the truth and the command",
        "line. They test the fit; they say nothing about how well the model describes a real arm.",
    ]
    for name, (meaning, _) in RUNS.items():
        run = read_run(HERE / f"{name}.csv")
        truth = ", ".join(f"`{path}` {value:g}" for path, value in run.definition.truth.items())
        lines += [
            "",
            f"## {name}.csv",
            "",
            meaning,
            "",
            f"- truth: {truth}",
            f"- SHA-256: `{run.sha256}`",
            "",
            "```",
            command_line(name),
            "```",
        ]
    return "\n".join(lines) + "\n"


def write() -> None:
    """Make everything in this folder again."""
    (HERE / "inputs" / "wind.csv").write_text(wind_input())
    for name in RUNS:
        make(name, HERE / f"{name}.csv")
        print(f"wrote {name}.csv")
    (HERE / "README.md").write_text(readme())


def differences(name: str) -> list[str]:
    """What is not as the command line makes it, in one run; empty where all is well."""
    path = HERE / f"{name}.csv"
    try:
        kept = read_run(path)  # compares the checksum
    except InputError as error:
        return [str(error)]
    if kept.definition.sha256 is None:
        return [f"{sidecar_path(path).name} states no checksum"]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, f"{name}.csv")
        make(name, out, "--digits", "15")
        made = read_run(out)
    found = []
    ignored = {"sha256", "origin"}
    if kept.definition.model_dump(exclude=ignored) != made.definition.model_dump(exclude=ignored):
        found.append(f"{sidecar_path(path).name} states something else than its command line")
    if list(kept.values) != list(made.values) or not np.array_equal(kept.times, made.times):
        return [*found, f"{path.name} has other channels or times"]
    for channel, values in kept.values.items():
        if not np.array_equal(np.isnan(values), np.isnan(made.values[channel])):
            found.append(f"{path.name}: {channel} has other gaps")
            continue
        unit = kept.channels[channel]
        written, exact = unit.from_si(values), unit.from_si(made.values[channel])
        # Half a unit of the last digit is the file's own rounding.
        size = np.maximum(np.abs(written), 1e-300)
        rounding = 0.5 * 10.0 ** (np.floor(np.log10(size)) + 1 - DIGITS)
        off = np.abs(written - exact) - rounding * (1 + 1e-9) - unit.from_si(ALLOWED)
        if np.nanmax(off) > 0:
            found.append(f"{path.name}: {channel} differs by {np.nanmax(off):.2g} {unit.unit}")
    return found


def check() -> list[str]:
    """All differences of this folder from what its table makes."""
    found = [difference for name in RUNS for difference in differences(name)]
    if (HERE / "inputs" / "wind.csv").read_text() != wind_input():
        found.append("inputs/wind.csv is not what the table says")
    if not found and (HERE / "README.md").read_text() != readme():
        found.append("README.md is not up to date")
    return found


def main(arguments: list[str]) -> int:
    """Write, or with `--check` compare; returns the exit status."""
    if arguments not in ([], ["--check"]):
        print(f"usage: {os.path.basename(__file__)} [--check]", file=sys.stderr)
        return 2
    if not arguments:
        write()
        return 0
    found = check()
    print("\n".join(found) or f"{len(RUNS)} runs regenerate")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
