"""Makes `results`, `written` and `studies`: files of today's version, for those to come.

To be run with the version that is to be remembered, and never with a later one:

    python tests/earlier/make.py [NAME ...]

- `results/NAME` has runs, a fit definition, and `fit`, what `giajax fit` made of them.
- `written/NAME` has what other commands wrote.
- `studies/NAME` has a study that was stopped: `half`, as a process that was killed leaves it, and
  `whole`, what the same study wrote that nothing had stopped.

`tests/test_resumed.py` reads them, and ends what was stopped. With any version,

    python tests/earlier/make.py again

fits all results again, and says of each whether its numbers are the same bit for bit.
"""

import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent

ARM = """\
model = "arm"

[arm]
links = 2
{arm}
[noise]
{noise}

[truth]
"air.drag_coefficient" = 1.1
"joints.pitch_stiffness" = 2.5
{truth}
"""
FREE_ARM = """\
[fit]
data = ["run.csv"]
free = ["air.drag_coefficient", "joints.pitch_stiffness"]
{fit}
[fit.start]
"air.drag_coefficient" = 0.9
"joints.pitch_stiffness" = 3.0
"""


def steps(samples: int = 31, seconds: float = 3.0) -> dict[str, np.ndarray]:
    """Commands of two joints, deg."""
    times = np.linspace(0.0, seconds, samples)
    ramp = np.clip(times / 0.5, 0, 1)
    return {
        "time_s": times,
        "joint01_command_deg": 34.0 * ramp,
        "joint02_command_deg": -28.0 * ramp,
    }


def blank(columns: dict[str, np.ndarray], *names: str) -> dict[str, np.ndarray]:
    """With columns that `giajax synth` is to fill."""
    return {**columns, **dict.fromkeys(names, np.zeros(len(next(iter(columns.values())))))}


def loop(turns: list[float], each: int = 12) -> np.ndarray:
    """From turn to turn."""
    ways = [np.linspace(a, b, each)[1:] for a, b in itertools.pairwise(turns)]
    return np.concatenate([[turns[0]], *ways])


def arm(arm: str = "", noise: str = "position_m = 0.01", truth: str = "") -> str:
    """A sidecar of an arm of two links."""
    return ARM.format(arm=arm, noise=noise, truth=truth)


def pressures() -> dict[str, np.ndarray]:
    """Of the muscles of the first joint."""
    times = np.linspace(0.0, 3.0, 31)
    return {
        "time_s": times,
        "joint02_command_deg": 10.0 * np.clip(times, 0, 1),
        "joint01_pressure_first_kPa": 30.0 + 40.0 * np.clip(times, 0, 1),
        "joint01_pressure_second_kPa": 30.0 * np.ones_like(times),
    }


LOOPS = {"input": loop([0, 1, -0.8, 0.7, -0.4, 0.5, 0])}
CAMERA = """
[camera.side]
mount = "room"
size_px = [1280, 720]
position_m = [1.0, -4.0, 0.8]
rotation_deg = [-6.0, 8.0, 80.0]
focal_length_px = 600.0

[camera.tip]
mount = "tip"
size_px = [640, 480]
position_m = [0.1, 0.0, 0.1]
rotation_deg = [2.0, 0.0, 0.0]
focal_length_px = 320.0

[landmark.mark01]
position_m = [6.0, 1.0, 0.5]
"""
PIXELS = [
    f"{name}_{axis}_px" for name in ("side.link01", "side.link02", "tip.mark01") for axis in "uv"
]
OPERATOR = (
    'model = "hysteresis"\n[hysteresis]\n{words}\n[noise]\noutput = 0.004\n[truth]\n{truth}\n'
)

# Of each: the sidecar, the columns of the run (those that are zero are made by its model), and
# the fit definition.
RESULTS = {
    "arm": (
        arm(),
        blank(steps(), "link02_z_m", "link02_y_m", "joint01_angle_deg"),
        FREE_ARM.format(
            fit='per_run = ["camera.delay"]\nhold_out = ["link02_y"]\nvalidation = ["run.csv"]'
        ).replace('stiffness"]', 'stiffness", "camera.delay", "joints.damping"]')
        + '[fit.priors]\n"joints.damping" = { value = 0.1, deviation = 0.03 }\n'
        '[fit.bounds]\n"air.drag_coefficient" = [0.2, 3.0]\n'
        '[fit.ties]\n"joints.yaw_stiffness" = "8 * joints.pitch_stiffness"\n',
    ),
    "windows": (
        arm(),
        blank(steps(61, 6.0), "link02_z_m", "joint01_angle_deg", "joint02_angle_deg"),
        FREE_ARM.format(fit='window_s = 3.0\nnoise_model = "white"\nloss = "huber"')
        + "[initial]\nfree = true\nfirst_row = true\n",
    ),
    "memory": (
        arm(
            '[arm.parameters]\n"joints.memory.strength" = 0.05\n',
            "position_m = 0.01\nangle_deg = 0.2",
        ),
        blank(steps(), "link02_z_m", "joint01_angle_deg"),
        FREE_ARM.format(fit="").replace(
            '["air.drag_coefficient"', '["joints.memory.strength", "air.drag_coefficient"'
        ),
    ),
    "air": (
        arm(
            'drag = "strip"\nstrip_points = 2\ngravity_m_per_s2 = 9.80665\nbuoyancy = true\n'
            'added_mass = "kirchhoff"\n[arm.parameters]\n"air.added_mass_coefficient" = 0.8\n'
            "[[arm.point_masses]]\nlink = 2\nmass_kg = 0.004\nposition_m = 0.9\n"
            "[wind]\nvelocity_m_per_s = [0.0, 0.2, 0.0]\n"
        ),
        blank(steps(), "link02_z_m", "link02_y_m"),
        FREE_ARM.format(fit=""),
    ),
    "contact": (
        arm(
            "contact_pressure_kPa = 1.0\ncontact_friction = 0.3\n"
            '[[arm.obstacles]]\nshape = "plane"\nname = "ground"\ncentre_m = [0.0, 0.0, -0.2]\n'
            "normal = [0.0, 0.0, 1.0]\n"
            '[[arm.obstacles]]\nshape = "box"\nname = "box"\ncentre_m = [3.0, 0.0, 3.0]\n'
            "size_m = [0.5, 0.5, 0.5]\n"
        ),
        blank(steps(), "link02_z_m", "link01_z_m"),
        FREE_ARM.format(fit=""),
    ),
    "muscles": (
        arm('muscles = "pitch"\nmuscle_law = "braided"\n'),
        blank(pressures(), "link01_z_m", "link02_y_m"),
        FREE_ARM.format(fit="").replace("joints.pitch_stiffness", "joints.damping"),
    ),
    "pixels": (
        arm(CAMERA, "pixel_px = 2.0"),
        blank(steps(), *PIXELS),
        FREE_ARM.format(fit="").replace('stiffness"]', 'stiffness", "camera.side.position"]'),
    ),
    "joint": (
        'model = "joint"\n[joint]\ntorque_N_m = 0.3\n[noise]\n'
        "contraction = 0.004\nforce_N = 0.06\n",
        blank(
            {"angle_deg": np.linspace(0, 60, 31), "side": np.array(["inner"] * 31)},
            "contraction",
            "force_N",
        ),
        '[fit]\ndata = ["run.csv"]\nfree = ["alpha.offset", "alpha.curvature"]\n',
    ),
    "muscle": (
        'model = "muscle"\n[muscle]\nlaw = "braided"\n[noise]\nforce_N = 0.3\n',
        blank(
            {
                "contraction": np.tile(
                    np.concatenate([np.linspace(0, 0.2, 8), np.linspace(0.2, 0, 8)]), 2
                ),
                "pressure_kPa": np.repeat([100.0, 200.0], 16),
                "phase": np.tile(np.repeat(["fill", "exhaust"], 8), 2),
            },
            "force_N",
        ),
        '[fit]\ndata = ["run.csv"]\nfree = ["muscle.effectiveness", "muscle.dead_band"]\n',
    ),
    "empirical": (
        'model = "muscle"\n[muscle]\nlaw = "empirical"\n[noise]\nforce_N = 0.3\n',
        blank(
            {
                "contraction": np.tile(np.linspace(0, 0.2, 12), 2),
                "pressure_kPa": np.repeat([100.0, 200.0], 12),
            },
            "force_N",
        ),
        '[fit]\ndata = ["run.csv"]\n',
    ),
    "piston": (
        'model = "muscle"\n[muscle]\nlaw = "piston"\n[noise]\nforce_N = 0.3\n',
        blank(
            {
                "position_m": np.tile(np.linspace(0, 0.02, 12), 2),
                "pressure_kPa": np.repeat([100.0, 200.0], 12),
                "phase": np.array(["fill"] * 24),
            },
            "force_N",
        ),
        '[fit]\ndata = ["run.csv"]\nfree = ["muscle.bore", "muscle.offset"]\n',
    ),
    "oscillator": (
        'model = "oscillator"\n[oscillator]\ninterpolation = "linear"\n[noise]\noutput = 1e-5\n',
        blank(
            {"time_s": np.linspace(0, 0.4, 81), "input": 60 * np.sin(30 * np.linspace(0, 0.4, 81))},
            "output",
        ),
        '[fit]\ndata = ["run.csv"]\nfree = ["mass", "damping"]\n[fit.start]\nmass = 2.4\n',
    ),
    "loops": (
        OPERATOR.format(
            words='operator = "prandtl_ishlinskii"\nthresholds = [0.2]',
            truth='"weights" = [0.8]\nelastic = 0.5\noffset = 0.1',
        ),
        blank(LOOPS, "output"),
        '[fit]\ndata = ["run.csv"]\nfree = ["elastic", "weights[0]"]\nloss = "soft_l1"\n'
        '[fit.start]\n"weights[0]" = 0.3\n[fit.fix]\noffset = 0.1\n',
    ),
    "modified": (
        OPERATOR.format(
            words='operator = "modified_prandtl_ishlinskii"\nthresholds = [0.1, 0.4]\n'
            "upper_dead_zones = 1\nlower_dead_zones = [0.2]\ninput_range = [-1.0, 1.0]",
            truth="",
        ),
        blank(LOOPS, "output"),
        '[fit]\ndata = ["run.csv"]\nstarts = 2\nseed = 3\nspread = 0.2\n',
    ),
    "preisach": (
        OPERATOR.format(
            words='operator = "preisach"\nrows = 3\ninput_range = [-1.0, 1.0]', truth=""
        ),
        blank(LOOPS, "output"),
        '[fit]\ndata = ["run.csv"]\n',
    ),
    "bouc_wen": (
        OPERATOR.format(
            words='operator = "bouc_wen"\ninput_range = [-1.0, 1.0]', truth="elastic = 0.5"
        ),
        blank(LOOPS, "output"),
        '[fit]\ndata = ["run.csv"]\nfree = ["elastic", "alpha"]\n',
    ),
}


def giajax(*words: str | Path | int) -> None:
    """A command."""
    from giajax.cli import main

    print("giajax", *words, flush=True)
    found = main([str(word) for word in words])
    # 1: the model is not adequate, which is as good a file as any.
    assert found in (0, 1), found


def write_run(path: Path, columns: dict[str, np.ndarray], sidecar: str) -> None:
    rows = [",".join(columns)]
    rows += [
        ",".join(each if isinstance(each, str) else f"{each:.6g}" for each in row)
        for row in zip(*columns.values(), strict=True)
    ]
    path.write_text("\n".join(rows) + "\n")
    path.with_suffix(".toml").write_text(sidecar)


def write_inputs(case: str, seed: int = 1) -> None:
    """The run and the fit definition of a case, here."""
    sidecar, columns, definition = RESULTS[case]
    write_run(Path("blank.csv"), columns, sidecar)
    values = [
        word
        for section, option in (("[truth]", "--set"), ("[noise]", "--noise"))
        for line in sidecar.partition(section)[2].partition("\n[")[0].strip().splitlines()
        for path, _, value in [line.partition(" = ")]
        for word in (option, f"{path.strip(chr(34))}={value.strip('[]')}")
    ]
    giajax("synth", "blank.csv", "--out", "run.csv", "--seed", seed, "--digits", 6, *values)
    for path in Path().glob("blank.*"):
        path.unlink()
    Path("run_fit.toml").write_text(definition)


def result(case: str) -> None:
    """A fit of one kind of model."""
    write_inputs(case)
    Path("fit").mkdir()
    giajax("fit", "run_fit.toml", "--out", "fit", "--no-figures", "--quiet", "--max-iterations", 25)


def several() -> None:
    """An arm and a joint of it on a bench, by one least squares."""
    write_inputs("memory")
    Path("run.csv").rename("arm.csv")
    Path("run.toml").rename("arm.toml")
    bench = OPERATOR.format(
        words='operator = "bouc_wen"\ninput_range = [-0.4, 0.5]\nprevious_extremes = [0.0]',
        truth="",
    )
    write_run(Path("blank.csv"), blank({"input": 0.4 * LOOPS["input"]}, "output"), bench)
    noise = ["--noise", "output=0.004"]
    giajax("synth", "blank.csv", "--out", "bench.csv", "--digits", 6, *noise)
    for path in Path().glob("blank.*"):
        path.unlink()
    Path("run_fit.toml").write_text(
        '[fit]\ndata = ["arm.csv", "bench.csv"]\n'
        'free = ["air.drag_coefficient", "joints.memory.strength", "elastic"]\n'
        '[fit.ties]\nalpha = "joints.memory.strength / joints.memory.yield_angle"\n'
        'beta = "1 / joints.memory.yield_angle"\n'
    )
    giajax("fit", "run_fit.toml", "--out", "fit", "--no-figures", "--quiet", "--max-iterations", 25)


def beside() -> None:
    """All that is written beside the result of a fit."""
    result("loops")
    giajax("bootstrap", "fit", "--size", 20, "--no-figures", "--quiet")
    giajax("influence", "fit", "--spans", 3, "--no-figures", "--quiet")
    giajax("profile", "fit", "elastic", "--no-figures", "--quiet")
    giajax("posterior", "fit", "--draws", 16, "--warmup", 20, "--chains", 2, "--quiet")
    giajax("suspects", "fit", "--quiet", "--out", "suspected.json")
    shutil.rmtree("fit/posterior_chains", ignore_errors=True)
    for path in Path("fit").glob("*.png"):
        path.unlink()


def design() -> None:
    """The next experiment."""
    Path("arm.toml").write_text("[arm]\nlinks = 2\n")
    giajax(
        "design", "arm.toml", "--parameter", "air.drag_coefficient", "--out", "design",
        "--duration", 3, "--rate", 5, "--markers", 1,
    )  # fmt: skip
    Path("design/design.png").unlink()


def drive() -> None:
    """What a pad did."""
    Path("arm.toml").write_text("[arm]\nlinks = 2\n")
    times = np.linspace(0.0, 2.0, 9)
    rows = [f"{t:.3g},{np.sin(t):.3g},{-np.cos(t):.3g},0" for t in times]
    Path("pad.csv").write_text("\n".join(["time_s,axis0,axis1,axis3", *rows]) + "\n")
    giajax(
        "drive",
        "arm.toml",
        "--replay",
        "pad.csv",
        "--noise",
        "position_m=0.01",
        "--out",
        "drive.csv",
    )


def fill() -> None:
    """Two balloons."""
    Path("filling.toml").write_text('[arm]\nlinks = 2\n[filling]\nsupply = "regulator"\n')
    giajax("fill", "filling.toml", "--no-curve", "--out", "filling")
    Path("filling/filling.png").unlink()


def wind() -> None:
    """The gusts about a resting arm."""
    giajax(
        "simulate", "--out", "run.csv", "--links", 2, "--wind", "0,0.5,0.2", "--gusts", "0.15:2",
        "--duration", 60, "--rate", 4, "--channels", "link02_y,link02_z,joint01_angle",
        "--noise", "position_m=0.0002", "--noise", "angle_deg=0.01", "--digits", 6,
    )  # fmt: skip
    giajax("wind", "--data", "run.csv", "--wind", "0,0.5,0.2", "--out", "wind")
    Path("wind/wind.png").unlink(missing_ok=True)


def sensitivity() -> None:
    """How a motion responds."""
    giajax(
        "sensitivity", "--parameter", "air.drag_coefficient", "--links", 2, "--ramp", "1=30",
        "--duration", 2, "--rate", 5, "--channels", "tip", "--out", "sensitivity",
    )  # fmt: skip
    for path in Path("sensitivity").glob("*.png"):
        path.unlink()


def kept_journals() -> list[bytes]:
    """From now on, what each journal had when its fit was done."""
    from giajax.tasks import Journal

    found: list[bytes] = []
    remove = Journal.remove

    def kept(journal: Journal) -> None:
        found.append(journal.path.read_bytes())
        remove(journal)

    Journal.remove = kept  # type: ignore[method-assign]
    return found


def halved(data: bytes, lines: int) -> bytes:
    """The first lines, and a part of the next one."""
    whole = data.splitlines(keepends=True)
    assert len(whole) > lines + 1, len(whole)
    return b"".join(whole[:lines]) + whole[lines][:40]


def journal(case: str, lines: int, *words: str | int) -> None:
    """A fit that was killed at a step: its journal ends within a line."""
    write_inputs(case)
    found = kept_journals()
    giajax("fit", "run_fit.toml", "--out", "fit", "--no-figures", "--quiet", *words)
    Path("fit").rename("whole")
    Path("fit").mkdir()
    Path("fit/journal.jsonl").write_bytes(halved(found[-1], lines))
    os.rename("fit", "half")


def keep_some(folder: Path, gone: int) -> None:
    """Remove the files of the last tasks that were done."""
    files = sorted(folder.glob("*.json"), key=lambda path: path.stat().st_mtime_ns)
    assert len(files) > gone, files
    Path("tasks.json").write_text(json.dumps(sorted(path.name for path in files), indent=1) + "\n")
    for path in files[-gone:]:
        path.unlink()


def starts(case: str, **settings: float) -> None:
    """Several starts in processes of their own, of which the last ones were not fitted."""
    from giajax.cli import _fit

    write_inputs(case)
    lines = [f"{name} = {value}\n" for name, value in settings.items()]
    path = Path("run_fit.toml")
    path.write_text(path.read_text().replace("[fit]\n", "".join(["[fit]\n", *lines])))
    _fit.forget_starts = lambda out: None
    words = ["fit", "run_fit.toml", "--starts", 5, "--seed", 2, "--workers", 1, "--no-figures"]
    giajax(*words, "--out", "whole", "--quiet")
    Path("half").mkdir()
    (folder,) = (path for path in Path("whole").iterdir() if path.is_dir())
    shutil.move(folder, Path("half") / folder.name)
    keep_some(Path("half") / folder.name, 2)


def sweep() -> None:
    """Four fits, two of which were done."""
    write_inputs("loops")
    Path("plan.toml").write_text(
        'fit = "run_fit.toml"\n[grid]\nfix.offset = [0.1, 0.2]\nstart."weights[0]" = [0.3, 0.8]\n'
    )
    giajax("sweep", "plan.toml", "--out", "whole", "--quiet")
    import polars as pl

    table = pl.read_parquet("whole/sweep.parquet")
    Path("half").mkdir()
    shutil.move("whole/fits", "half/fits")
    Path("whole/table.json").write_text(json.dumps(table.to_dict(as_series=False), indent=1) + "\n")
    keep_some(Path("half/fits"), 2)


def of_result(case: str, name: str, gone: int, *words: str | int) -> None:
    """A study of a result, of whose tasks the last ones were not done."""
    result(case)
    giajax(name, "fit", *words, "--folder", "half/tasks", "--no-figures", "--quiet")
    Path("whole").mkdir()
    (written,) = {"profiles.json", f"{name}.json"} & set(os.listdir("fit"))
    shutil.move(f"fit/{written}", "whole")
    keep_some(Path("half/tasks"), gone)


def posterior() -> None:
    """Three chains, two of which were drawn."""
    result("loops")
    giajax(
        "posterior", "fit", "--chains", 3, "--draws", 12, "--warmup", 20, "--quiet", "--out", "half"
    )
    (folder,) = (path for path in Path("half").iterdir() if path.is_dir())
    Path("whole").mkdir()
    shutil.move("half/posterior.json", "whole")
    for path in Path("half").iterdir():
        if path.is_file():
            path.unlink()
    keep_some(folder, 1)


def keys() -> None:
    """Keys and seeds of a task, by what it is about, in 64-bit."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from giajax import load_result, read_run
    from giajax.runtime.tasks import Task
    from giajax.studies import Fitted

    found = {}
    for folder in sorted((HERE / "results").iterdir()):
        read = load_result(folder / "fit")
        about: dict[str, object] = {"model": read.model}
        if (folder / "run.csv").exists() and len(read.runs) == 1 and not read.held_out:
            about["fitted"] = Fitted.of(read, read_run(folder / "run.csv"))
        for what, argument in about.items():
            task = Task("math:hypot", {what: argument}, seed=1)
            found[f"{what} of {folder.name}"] = [task.key, task.own_seed]
    Path("keys.json").write_text(json.dumps(found, indent=1) + "\n")


MAKE = {
    **{f"results/{case}": lambda case=case: result(case) for case in RESULTS},
    "results/several": several,
    "written/beside": beside,
    "written/design": design,
    "written/drive": drive,
    "written/fill": fill,
    "written/wind": wind,
    "written/sensitivity": sensitivity,
    "studies/journal": lambda: journal("loops", 4),
    "studies/journal_of_starts": lambda: journal("loops", 14, "--starts", 3),
    "studies/journal_of_arm": lambda: journal("arm", 4),
    "studies/starts": lambda: starts("loops"),
    # Keys of the later starts have the tolerance that the first one chose, unless it is given.
    "studies/starts_of_arm": lambda: starts("memory", tolerance=1e-6),
    "studies/sweep": sweep,
    "studies/profile": lambda: of_result("loops", "profile", 2),
    "studies/profile_of_arm": lambda: of_result("memory", "profile", 1, "joints.pitch_stiffness"),
    "studies/bootstrap": lambda: of_result("loops", "bootstrap", 1, "--size", 40, "--seed", 3),
    "studies/blocks": lambda: of_result("loops", "bootstrap", 1, "--size", 20, "--block"),
    "studies/influence": lambda: of_result("loops", "influence", 1, "--exact", "--spans", 17),
    "studies/posterior": posterior,
    # Of results that are there.
    "keys.json": keys,
}


def again() -> None:
    """Fit all results again, each in a process of its own, as a user would."""
    for folder in sorted((HERE / "results").iterdir()):
        with tempfile.TemporaryDirectory() as home:
            shutil.copytree(folder, home, dirs_exist_ok=True)
            words = ["fit", "--again", "fit", "--out", "again", "--no-figures"]
            done = subprocess.run(
                [sys.executable, "-m", "giajax", *words],
                cwd=home, capture_output=True, text=True, check=False,
            )  # fmt: skip
        said = [line for line in done.stdout.splitlines() if " the same" in line]
        print(f"{folder.name}: {said[-1] if said else done.stderr.splitlines()[-1:]}", flush=True)


def main() -> None:
    """Make those that are named, or all."""
    # Each in a process of its own, because some of them change what commands do.
    if sys.argv[1:] == ["again"]:
        again()
        return
    asked = sys.argv[1:] or list(MAKE)
    if len(asked) > 1:
        failed = [name for name in asked if os.system(f'"{sys.executable}" "{__file__}" {name}')]
        sys.exit(f"failed: {failed}" if failed else 0)
    (name,) = asked
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        MAKE[name]()
        for lock in Path().rglob("*.lock"):
            lock.unlink()
        if Path(name).is_file():
            shutil.copy(name, HERE / name)
            return
        shutil.rmtree(HERE / name, ignore_errors=True)
        shutil.copytree(".", HERE / name)


if __name__ == "__main__":
    main()
