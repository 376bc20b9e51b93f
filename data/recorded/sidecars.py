"""Write the sidecars of the recordings: origin, licence, checksum, and what is known of the arm.

`python data/recorded/sidecars.py` writes `<run>.toml` beside each run.
"""

import hashlib
from pathlib import Path

from giajax.recordings import Definition

HERE = Path(__file__).parent

RECORDINGS = {
    "triple_pendulum": (
        "*ion_*.csv",
        "The Experimental Multi-Arm Pendulum on a Cart, arXiv:2205.06231",
        "MIT",
        {
            "preset": "pendulum",
            "links": 3,
            "link_length_m": [0.172799737, 0.2287, 0.25],
            "link_mass_kg": [0.258171998, 0.279427783, 0.118624232],
            "base_rotation_deg": [0.0, -90.0, 0.0],
            "gravity_m_per_s2": 9.80834384,
        },
    ),
    "dfki_double_pendulum": (
        "trajectory_*.csv",
        "dfki-ric-underactuated-lab/double_pendulum, design A.0, 2022-08-15",
        "BSD-3-Clause",
        {
            "preset": "pendulum",
            "links": 2,
            "link_length_m": [0.3, 0.2],
            "link_mass_kg": [0.5593806151425046, 0.6043459469186889],
            "gravity_m_per_s2": 9.81,
        },
    ),
}

if __name__ == "__main__":
    for folder, (pattern, origin, licence, arm) in RECORDINGS.items():
        for path in sorted((HERE / folder).glob(pattern)):
            stated = {
                "model": "arm",
                "origin": origin,
                "licence": licence,
                "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
                "arm": arm,
                "initial": {"first_row": True},
            }
            path.with_suffix(".toml").write_text(Definition.parse(stated).to_toml())
