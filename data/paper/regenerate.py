"""Make the runs of this folder again, or check that they still come out the same.

    python data/paper/regenerate.py                write all of them: eleven minutes of one core
    python data/paper/regenerate.py 3 7            those of two seeds
    python data/paper/regenerate.py --check 3      compare: exit status 1 where one differs

The recordings of the paper's section IV.C are not public. These runs stand in for them: an arm with
more physics than the paper's model has, simulated by MuJoCo (`peers/mujoco_air.py`) and not by
giajax, and filmed with noise. Needs the bench extra, and runs from the root of the project.
"""

import sys
from pathlib import Path

import jax
import mujoco
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from giajax import Definition, Run, read_run, takeichi_20m, write_run  # noqa: E402
from giajax.apps.synthetic import gusts  # noqa: E402
from giajax.mechanics.arm import Arm  # noqa: E402
from giajax.recordings import sidecar_path  # noqa: E402
from giajax.simulation import Signal, ramps  # noqa: E402
from peers.mujoco_air import MujocoInAir  # noqa: E402

# The last one is fitted by a model that is compared with the others.
SEEDS = range(1, 22)

# What is fixed by the description of the stand-in. Fits of the paper's model are told none of it;
# giajax's own model is told of trim weights and added mass (`giajax.apps.paper`).
TRUTH = {
    "air.drag_coefficient": 1.1,
    "air.added_mass_coefficient": 1.0,
    "buoyancy.trim_depth": 0.15,
    "joints.pitch_stiffness": 2.6,
    "joints.yaw_stiffness": 30.0,
    "joints.damping": 0.04,
}
FRICTION = {"joint_friction_N_m": 0.06, "joint_friction_stiffness_N_m_per_rad": 60.0}
# A level flow across the arm, 0.05 m/s in the mean; the fastest gust of a run is 0.15 to 0.36 m/s,
# 0.20 in the median.
WIND = {"mean": [0.0, 0.05, 0.0], "intensity": [2.0, 0.0, 0.0], "length_scale": 0.5}
NOISE = 0.02

DURATION, RATE, STEP = 25.0, 10.0, 0.005
# The base joint to 30 deg within a second, and back.
UP, BACK, TURN, LASTS = 0.5, 12.0, np.deg2rad(30.0), 1.0
LINKS = (1, 2, 3, 6, 12, 20)


def arm() -> Arm:
    """The paper's arm as it floats: trimmed, so that each link moves with 0.084 kg."""
    return takeichi_20m(20, drag="strip", trim=True, gravity=9.80665, parameters=TRUTH)


def command() -> Signal:
    """Of all joints: that of the base goes up and comes back."""
    times = np.array([0.0, UP, UP + LASTS, BACK, BACK + LASTS])
    values = np.zeros((len(times), 20))
    values[2:4, 0] = TURN
    return ramps(times, values)


def motion(seed: int, duration: float = DURATION, step: float = STEP) -> dict[str, np.ndarray]:
    """Positions without noise, m, by channel, with `time` and `command`."""
    wind = gusts(**WIND, duration=DURATION, interval=1 / RATE, seed=seed)
    rows = np.stack([wind.values[f"wind_{axis}"] for axis in "xyz"], axis=1)
    times = np.linspace(0.0, duration, round(duration * RATE) + 1)
    simulated = MujocoInAir(
        arm(),
        command(),
        ramps(wind.times, rows, tolerance=0.0),
        friction=FRICTION["joint_friction_N_m"],
        friction_stiffness=FRICTION["joint_friction_stiffness_N_m_per_rad"],
    )
    centres, tips = simulated.places(simulated.trajectory(times, step)[:, 0])
    base = np.interp(times, [UP, UP + LASTS, BACK, BACK + LASTS], [0, TURN, TURN, 0])
    found = {"time": times, "command": base}
    for component, axis in enumerate("xyz"):
        found |= {f"link{n:02d}_{axis}": centres[:, n - 1, component] for n in LINKS}
        found[f"tip_{axis}"] = tips[:, component]
    return found


def filmed(seed: int, duration: float = DURATION) -> Run:
    """One run, or its beginning, as the camera sees it."""
    seen = motion(seed, duration)
    times, base = seen.pop("time"), seen.pop("command")
    values = {"joint01_command": base}
    for name in sorted(seen):
        random = np.random.default_rng([seed, *name.encode()])
        noise = random.standard_normal(round(DURATION * RATE) + 1)[: len(times)]
        values[name] = seen[name] + NOISE * noise
    return Run.from_arrays(times, values, name=name_of(seed), definition=stated(seed))


def stated(seed: int) -> Definition:
    """What the sidecar says: the constants of the paper's table 2, the noise, and the truth."""
    wind = {
        "wind_mean_m_per_s": WIND["mean"],
        "wind_intensity": WIND["intensity"],
        "wind_length_scale_m": WIND["length_scale"],
        "wind_spectrum": "von Karman, the same along the whole arm",
    }
    physics = {"drag": "strip", "trim": True, "gravity_m_per_s2": 9.80665, "seed": seed}
    return Definition.parse(
        {
            "schema_version": 1,
            "model": "arm",
            "origin": f"MuJoCo {mujoco.__version__}, data/paper/regenerate.py {seed}",
            "arm": {"preset": "takeichi_20m"},
            "command": {"interpolation": "linear"},
            "noise": {"position_m": NOISE},
            "truth": {**TRUTH, **FRICTION, **wind, **physics},
        },
        name_of(seed),
    )


def name_of(seed: int) -> str:
    """Of a run, without its ending."""
    return f"stand_in_{seed:02d}"


def write(seed: int) -> None:
    """Make the run of one seed, in whole millimetres: a twentieth of the noise."""
    run = filmed(seed)
    units = {name: "mm" for name in run.values if name != "joint01_command"}
    values = {
        name: column if name == "joint01_command" else np.round(column, 3)
        for name, column in run.values.items()
    }
    path = HERE / f"{name_of(seed)}.csv"
    write_run(path, run.times, values, definition=run.definition, units=units, digits=6, force=True)
    print(f"wrote {path.name}", flush=True)


def differences(seed: int, duration: float = DURATION) -> list[str]:
    """What is not as this script makes it, in the run of one seed; empty where all is well.

    Arguments:
        seed: of the run.
        duration: of its beginning that is made again, s.
    """
    path = HERE / f"{name_of(seed)}.csv"
    kept, made = read_run(path), filmed(seed, duration)  # the first compares the checksum
    found = []
    if kept.definition.truth != made.definition.truth:
        found.append(f"{sidecar_path(path).name} states another truth")
    if kept.values.keys() != made.values.keys():
        return [*found, f"{path.name} has other channels"]
    for name, column in made.values.items():
        # Half a millimetre is the file's own rounding; a tenth of that is left to other machines.
        off = float(np.max(np.abs(column - kept.values[name][: len(column)])))
        if off > 0.55e-3:
            found.append(f"{path.name}: {name} differs by {off:.2g}")
    return found


def main(words: list[str]) -> int:
    """Write, or with `--check` compare; returns the exit status."""
    jax.config.update("jax_enable_x64", True)
    check = "--check" in words
    seeds = [int(word) for word in words if word != "--check"] or list(SEEDS)
    if not check:
        for seed in seeds:
            write(seed)
        return 0
    found = [difference for seed in seeds for difference in differences(seed)]
    print("\n".join(found) or f"{len(seeds)} runs regenerate")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
