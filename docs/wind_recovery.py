"""Known winds, estimated from simulated recordings: the table of docs/wind.md.

    python docs/wind_recovery.py            measure, and write the table into docs/wind.md
    python docs/wind_recovery.py --print    measure and print

An arm rests in gusts. The simulation includes the non-linear drag, and a camera records the links.
A pull is the error of the logarithm of an estimate divided by its standard error. Over many seeds,
the pulls should have a mean of 0 and a standard deviation of 1.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from giajax import ArmModel, Run, fit_wind, gusts, takeichi_20m
from giajax.apps.synthetic import synthesise
from giajax.apps.wind import WindFit
from giajax.mechanics.arm import link_centres

PAGE = Path(__file__).with_name("wind.md")
BEGIN, END = "<!-- wind_recovery.py writes from here -->\n", "<!-- to here -->\n"

MEAN, LENGTH_SCALE = (0.0, 0.4, 0.1), 2.0
NOISE = 1e-3
FREE = ("speed", "deviation", "length_scale")

LINKS, LASTS, SEEDS = 3, 600.0, 10
# Intensity, and number of frequencies of which the gusts consist.
CASES = ((0.1, 3000), (0.2, 3000), (0.4, 3000), (0.1, 400))
# Time in which the straight arm reaches its position of rest, s.
SKIP = 30.0


def recording(model: ArmModel, intensity: float, lines: int, seed: int) -> Run:
    """Simulate the arm in gusts, recorded by a camera at 5 Hz that shows y and z of its links."""
    count = model.arm.count
    wind = gusts(
        MEAN,
        intensity=intensity,
        length_scale=LENGTH_SCALE,
        duration=LASTS + SKIP,
        interval=0.1,
        seed=seed,
        places=np.asarray(link_centres(model.arm, jnp.zeros(count))),
        lines=lines,
    )
    # The wind is linear between its rows, which are twice as many as those of the camera.
    run = synthesise(
        model,
        wind.times,
        wind.values,
        [f"link{link + 1:02d}_{axis}" for link in range(count) for axis in "yz"],
        noise={"position": NOISE},
        seed=seed,
        definition={"free_motion": True, "arm": {"links": count}},
    )
    values = {name: column[::2] for name, column in run.observations.items()}
    return Run.from_arrays(
        wind.times[::2], values, noise={"position": NOISE}, definition={"free_motion": True}
    )


def found_again(model: ArmModel, run: Run) -> WindFit:
    """Fit the wind, starting from a weaker mean flow and stronger, longer gusts."""
    return fit_wind(
        model,
        run,
        mean=[0.75 * part for part in MEAN],
        intensity=0.3,
        length_scale=5.0,
        free=FREE,
        skip=SKIP,
        highest=0.6,
    )


def pulls(found: WindFit, intensity: float) -> list[float]:
    """Return the pulls of the free numbers."""
    speed = float(np.linalg.norm(MEAN))
    truth = {"speed": speed, "deviation": intensity * speed, "length_scale": LENGTH_SCALE}
    row = []
    for name in FREE:
        one = found.numbers[name]
        assert one.standard_error is not None, name
        row.append(float(np.log(one.value / truth[name]) * one.value / one.standard_error))
    return row


def line(intensity: float, lines: int) -> str:
    """Return one row of the table."""
    model = ArmModel(takeichi_20m(LINKS))
    table, errors, misfits = [], [], []
    for seed in range(SEEDS):
        found = found_again(model, recording(model, intensity, lines, seed))
        numbers = [found.numbers[name] for name in FREE]
        table.append(pulls(found, intensity))
        errors.append([(one.standard_error or np.nan) / one.value for one in numbers])
        misfits.append(found.misfit[0])
        print(seed, np.round(table[-1], 2), found.converged, found.notes, file=sys.stderr)
    cells = [f"{intensity:g}", str(lines)]
    for column, error in zip(np.transpose(table), np.median(errors, axis=0), strict=True):
        cells += [f"{error:.1%}", f"{column.mean():+.2f} {column.std():.2f}"]
    cells.append(f"{np.abs(table).max():.1f}")
    cells.append(f"{np.mean(misfits):.2f}")
    return "| " + " | ".join(cells) + " |"


def main(arguments: list[str]) -> int:
    """Measure, then write or print the table; return the exit status."""
    if arguments not in ([], ["--print"]):
        print(f"usage: {Path(__file__).name} [--print]", file=sys.stderr)
        return 2
    jax.config.update("jax_enable_x64", True)
    heads = ["intensity", "lines"]
    for name in ("U", "deviation", "L"):
        heads += [f"error of {name}", "pull"]
    heads += ["largest pull", "misfit"]
    lines = ["| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
    for case in CASES:
        lines.append(line(*case))
        print(lines[-1], flush=True)
    if not arguments:
        before, _, rest = PAGE.read_text().partition(BEGIN)
        text = before + BEGIN + "\n" + "\n".join(lines) + "\n\n" + END + rest.partition(END)[2]
        PAGE.write_text(text)
        print(f"written to {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
