"""Write the runs of this folder from the original files.

python data/recorded/pneumatic_piston_friction/convert.py FOLDER-OF-THE-ORIGINALS
"""

import sys
from pathlib import Path

import numpy as np

from giajax import write_run

HERE = Path(__file__).resolve().parent

PRESSURES = (1, 3, 5, 7)  # bar
TIME, POSITION, PRESSURE, FORCE = 0, 4, 5, 6  # columns: ms, mm, bar, N

ORIGIN = (
    "GitHub EvaZillen/3D-printed-pneumatic-actuator, commit "
    "6e0bcb4633bd53b2a8544cdbd497c4c06539afc7, results_pneumatic-actuator/data/friction/{name}.csv"
)


def convert(original: Path, folder: Path) -> Path:
    """Write one run and its sidecar; returns the run's path."""
    table = np.loadtxt(original)
    return write_run(
        folder / original.name,
        table[:, TIME] / 1e3,
        {
            "position": table[:, POSITION] / 1e3,
            "pressure": table[:, PRESSURE] * 1e5,
            "force": table[:, FORCE],
        },
        units={"position": "mm", "pressure": "bar"},
        digits=6,
        definition={
            "model": "muscle",
            "origin": ORIGIN.format(name=original.stem),
            "licence": "CC0-1.0",
            "muscle": {
                "law": "piston",
                "friction": "coulomb",
                "friction_pressures_kPa": [100.0 * bar for bar in PRESSURES],
            },
            "truth": {"muscle.bore": 0.0257},
        },
        force=True,
    )


def main(arguments: list[str]) -> int:
    """Convert all; returns the exit status."""
    if len(arguments) != 1 or not Path(arguments[0]).is_dir():
        print(f"usage: {Path(__file__).name} FOLDER-OF-THE-ORIGINALS", file=sys.stderr)
        return 2
    for bar in PRESSURES:
        print(f"wrote {convert(Path(arguments[0], f'O-ring257_{bar}bar.csv'), HERE)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
