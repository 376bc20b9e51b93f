"""Regenerate the runs of this folder, or check that they are reproduced.

    python data/synthetic/regenerate.py           write all runs (`make synthetic`)
    python data/synthetic/regenerate.py --check   compare; the exit status is 1 if a run differs

Each run of an arm is one `giajax simulate` command line of the first table below. Runs of a joint,
of a muscle and of hysteresis come from the functions below. `--check` compares the files with the
checksums in their sidecars, and their values with newly simulated ones. Machines differ in the last
bit, so the newly simulated values are compared before they are rounded to the digits of the file.
"""

import contextlib
import dataclasses
import io
import itertools
import math
import os
import shlex
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from giajax import Definition, InputError, Run, read_run, write_run
from giajax.cli import main as giajax
from giajax.recordings import sidecar_path

HERE = Path(__file__).resolve().parent

DIGITS = 6
# Allowed difference between machines, SI: far below the noise, far above rounding.
ALLOWED = 1e-6

_EXACT = f"--tolerance 1e-10 --digits {DIGITS}"
_ARM = (
    "--set air.drag_coefficient=1.27 --set joints.pitch_stiffness=3.6 "
    "--set joints.yaw_stiffness=37 --set joints.damping=0.04"
)

# By name: the description, and the options of `giajax simulate`.
RUNS = {
    "base_step": (
        "The paper's experiment: the base joint moves to 30 deg within one second, and four links "
        "are filmed from the side.",
        "--set air.drag_coefficient=1.12 --set joints.pitch_stiffness=2.7 "
        "--set joints.yaw_stiffness=33 --set joints.damping=0.065 --ramp 1=30@0.5:1 "
        "--channels link02_z,link06_z,link12_z,link20_z --noise position_m=0.02 --seed 1",
    ),
    "pitch_yaw": (
        "Two pitch joints and two yaw joints move in turn. Every link is tracked, and one cell in "
        "ten is empty.",
        f"{_ARM} --ramp 1=25@0.5:1 --ramp 1=-5@9:2 --ramp 1=15@17:1.5 --ramp 2=-20@1:1.5 "
        "--ramp 2=15@11:2 --ramp 9=18@3:1 --ramp 9=-10@14:1 --ramp 10=-25@5:1.5 "
        "--ramp 10=12@16:2 --channels all --noise position_m=0.01 --missing 10 --seed 2",
    ),
    "wind": (
        "The same arm as in pitch_yaw, in a gusty wind that changes direction. The wind is "
        "recorded with the run.",
        f"{_ARM} --command inputs/wind.csv --channels link06,link12,link20,tip "
        "--noise position_m=0.015 --missing 5 --seed 3",
    ),
    "full_air": (
        "The arm with all effects of the air: trim weights with which it floats, drag along the "
        "links, and added mass.",
        "--arm inputs/full_air.toml --set air.drag_coefficient=1.2 "
        "--set joints.pitch_stiffness=3.2 --set joints.yaw_stiffness=28 "
        "--set joints.damping=0.055 --ramp 1=25@0.5:1 --ramp 1=-5@9:2 --ramp 2=-20@1:1.5 "
        "--ramp 2=15@11:2 --channels link06,link12,link20 --noise position_m=0.01 --seed 5",
    ),
    "joint_memory": (
        "An arm of six links with hysteretic joints: it does not return exactly when its command "
        "returns.",
        "--links 6 --set air.drag_coefficient=1.15 --set joints.pitch_stiffness=2.6 "
        "--set joints.yaw_stiffness=21 --set joints.damping=0.07 "
        "--set joints.memory.strength=0.08 --set joints.memory.yield_angle=0.003 --duration 18 "
        "--ramp 1=30@0.5:1 --ramp 1=0@8:1 --ramp 2=-20@2:1 --ramp 2=5@11:1 "
        "--channels joints,link03,tip --noise position_m=0.01 --noise angle_deg=0.3 --seed 6",
    ),
    "short_arm_steps": (
        "An arm of six links with step commands. The angles of its joints are also measured.",
        "--links 6 --set air.drag_coefficient=1.05 --set joints.pitch_stiffness=2.2 "
        "--set joints.yaw_stiffness=18 --set joints.damping=0.09 --duration 15 --step 1=30@0.5 "
        "--step 1=0@8 --step 2=20@2 --step 3=-25@5 --channels joints,link03,tip "
        "--noise position_m=0.01 --noise angle_deg=0.5 --seed 4",
    ),
}


def joint_run(name: str, truth: dict[str, float], torques: list[float], noise: float) -> Run:
    """Simulate a joint at angles on both sides, three times each; noise relative to full scale."""
    from giajax import build_model, synthesise

    sizes = np.tile(np.linspace(0, 60, 61), 3)
    angles = np.concatenate([sizes, -sizes[sizes > 0], np.zeros(3)])
    sides = np.where(np.arange(len(angles)) < len(sizes), "inner", "outer")
    inputs = {"angle": np.deg2rad(angles), "side": sides}
    if torques:
        inputs["torque"] = np.resize(torques, len(angles))
    run = synthesise(
        build_model("joint", {"joint": {}}, truth),
        None,
        inputs,
        ["contraction", "force"],
        # Full scale is 0.2 for the contraction and 3 N for the force.
        noise={"contraction": 0.2 * noise, "force": 3.0 * noise},
        seed=5,
        definition={"truth": truth},
        name=name,
    )
    if not any(path.startswith("geometry.") for path in truth):
        return run
    # The geometry is fitted, so the sidecar must not give it.
    stated = {key: said for key, said in run.definition.contents().items() if key != "joint"}
    return Run.from_arrays(None, run.values, name=name, definition=stated)


def muscle_run(name: str, section: dict[str, object], truth: dict[str, float]) -> Run:
    """Simulate a muscle that a test bench lengthens and shortens at six pressures."""
    from giajax import build_model, synthesise

    pressures = np.repeat([50e3, 100e3, 150e3, 200e3, 250e3, 300e3], 50)
    contraction = np.tile(np.concatenate([np.linspace(0, 0.2, 25), np.linspace(0.2, 0, 25)]), 6)
    phase = np.tile(np.repeat(["fill", "exhaust"], 25), 6)
    return synthesise(
        build_model("muscle", {"muscle": section}, truth),
        None,
        {"pressure": pressures, "contraction": contraction, "phase": phase},
        ["force"],
        noise={"force": 0.3},
        missing=0.05,
        seed=6,
        definition={"truth": truth},
        name=name,
    )


def joint_loops(name: str, truth: dict[str, float]) -> Run:
    """Simulate nested loops of a joint with a Prandtl-Ishlinskii operator, with noise and gaps."""
    from giajax import build_model, synthesise

    turns = [0, 55, -55, 40, -30, 50, -10, 20, -45, -5, -25, 30, 0]
    ways = [np.linspace(a, b, round(abs(b - a)) + 1)[1:] for a, b in itertools.pairwise(turns)]
    command = np.concatenate([[0.0], *ways])
    section = {
        "operator": "prandtl_ishlinskii",
        "thresholds": [0.15, 0.35, 0.55, 0.75],
        "input_range": [-1.0, 1.0],
    }
    return synthesise(
        build_model("hysteresis", {"hysteresis": section}, truth),
        5.0 * np.arange(len(command)),
        {"command": np.deg2rad(command)},
        ["angle"],
        noise={"angle": np.deg2rad(0.3)},
        missing=0.05,
        seed=5,
        definition={"truth": truth},
        name=name,
    )


def bouc_wen_multisine(name: str) -> Run:
    """Simulate the estimation run of the Bouc-Wen benchmark, in its usual units."""
    from giajax.apps.experiments import bouc_wen_benchmark

    run = bouc_wen_benchmark(seed=6).multisine
    stated = run.definition.contents()
    stated["noise"] = {"output_mm": 0.008}
    return dataclasses.replace(run, definition=Definition.parse(stated, name))


def one_link(name: str) -> Run:
    """Simulate the joint from which `giajax hysteresis` identifies its operator."""
    from giajax.apps.experiments import record_joint

    return record_joint()


def turned_camera_run(name: str) -> Run:
    """Simulate the motion of pitch_yaw, seen by a camera rotated by 5 deg and shifted by 0.1 m.

    The sidecar does not give the pose of the camera.
    """
    from giajax import model_for, replace
    from giajax.apps.synthetic import RecordingErrors, recorded_again

    first = read_run(HERE / "pitch_yaw.csv")
    frame = {
        "camera.rotation": np.deg2rad(5.0) * np.array([2.0, -1.0, 2.0]) / 3,
        "camera.origin": 0.1 * np.array([-2.0, 2.0, 1.0]) / 3,
    }
    known = {key: said for key, said in first.definition.truth.items() if "." in key}
    model = replace(model_for([first]), {**known, **frame}).refined(1e-3)
    return recorded_again(
        model,
        first,
        RecordingErrors(white={"position": 0.01}, missing=0.05, bursts=0.05),
        channels=[f"link{link:02d}_{axis}" for link in (2, 6, 12, 20) for axis in "xyz"],
        seed=7,
        truth=list(frame),
        name=name,
    )


# Noise of a tracked point, px, and number of links of the filmed arm.
_PIXEL = 2.0
_FILMED = 6
_FILMED_ARM = {
    "air.drag_coefficient": 1.2,
    "joints.pitch_stiffness": 2.5,
    "joints.yaw_stiffness": 20.0,
    "joints.damping": 0.06,
}
# Camera settings in the units of the files. Size and focal length are assumed to be known exactly.
_LENS = {"size_px": [1920, 1080], "focal_length_px": 1000.0}
_TIP_CAMERA = {
    "tip": {
        **{"mount": "tip", "size_px": [1280, 720], "focal_length_px": 640.0},
        **{"position_m": [0.12, -0.08, 0.15], "rotation_deg": [6.0, 10.0, -8.0]},
    }
}
_ROOM_CAMERAS = {
    "side": {**_LENS, "position_m": [3.5, -7.0, 1.2], "rotation_deg": [-6.0, 8.0, 80.0]},
    "front": {**_LENS, "position_m": [11.0, 2.5, 2.0], "rotation_deg": [25.0, -10.0, -160.0]},
}
_MARKS = {
    "mark01": [11.0, 2.0, 1.5],
    "mark02": [12.0, -2.5, 0.5],
    "mark03": [10.5, 0.5, -1.5],
    "mark04": [13.0, -0.5, 3.0],
    "mark05": [12.5, 3.5, -0.5],
    "mark06": [11.5, -1.0, -2.5],
}


def pixel_run(name: str, cameras: dict[str, dict[str, object]], points: list[str]) -> Run:
    """Simulate an arm filmed by cameras; the poses in the sidecar are 30 % wrong."""
    from giajax import build_model, synthesise
    from giajax.models import parameter_values

    marks = {mark: {"position_m": place} for mark, place in _MARKS.items()}
    landmarks = {"landmark": marks} if "mark01" in points else {}
    truth = {"arm": {"links": _FILMED}, "camera": cameras, **landmarks}
    guess = {
        camera: {
            key: [round(1.3 * each, 3) for each in value]  # type: ignore[attr-defined]
            if key in ("position_m", "rotation_deg")
            else value
            for key, value in about.items()
        }
        for camera, about in cameras.items()
    }
    simulation = {"simulation": {"solver": "springs5", "tolerance": 1e-10, "max_steps": 50_000}}
    model = build_model("arm", truth | simulation, _FILMED_ARM)
    times = np.linspace(0.0, 12.0, 121)
    moves = {
        "joint01_command": ([0.5, 1.5, 6.0, 7.5], [0.0, 20.0, 20.0, -10.0]),
        "joint02_command": ([1.0, 2.5, 7.0, 9.0], [0.0, -20.0, -20.0, 15.0]),
        "joint04_command": ([3.0, 4.5], [0.0, 15.0]),
    }
    poses = {
        path: value
        for path, value in parameter_values(model).items()
        if path.startswith("camera.") and path.endswith((".position", ".rotation"))
    }
    return synthesise(
        model,
        times,
        {joint: np.interp(times, at, np.deg2rad(to)) for joint, (at, to) in moves.items()},
        [f"{camera}.{point}_{axis}" for camera in cameras for point in points for axis in "uv"],
        noise={"pixel": _PIXEL},
        seed=14,
        definition={
            "arm": {"preset": "takeichi_20m"},
            "truth": {**_FILMED_ARM, **poses},
            "command": {"interpolation": "linear"},
        },
        constants=build_model("arm", truth | {"camera": guess} | simulation, _FILMED_ARM),
        name=name,
    )


# An arm of three links whose pitch joints have muscles and whose joints all have hysteresis.
_WHOLE_ARM = {"preset": "takeichi_20m", "links": 3, "muscles": "pitch"}
_WHOLE_CORRECTIONS = {
    "alpha.offset": 0.04,
    "alpha.threshold": 0.45,
    "alpha.curvature": 0.9,
    "beta.threshold": 0.45,
    "beta.curvature": 0.5,
}
_WHOLE_JOINT = {
    "drive.passive_stiffness": 0.12,
    "joints.memory.strength": 0.03,
    "joints.memory.yield_angle": 0.02,
}
_WHOLE_AIR = {
    "air.drag_coefficient": 1.15,
    "joints.yaw_stiffness": 5.0,
    "joints.damping": 0.07,
}


def whole_arm(name: str) -> Run:
    """Simulate the arm, driven by pressures of a controller that ignores friction and stiffness."""
    import jax.numpy as jnp

    from giajax import model_for, replace, synthesise
    from giajax.models import arm_from_definition

    options = {path: _WHOLE_JOINT[path] for path in list(_WHOLE_JOINT)[:2]}
    known = {"arm": {**_WHOLE_ARM, "parameters": options}}
    drive = arm_from_definition(Definition.parse(known)).pneumatics
    assert drive is not None
    times = np.linspace(0.0, 16.0, 161)
    knots = [0.0, 1.0, 1.5, 6.0, 6.5, 11.0, 16.0]
    angles = [(0, 0), (0, 0), (35, 25), (35, 25), (50, -35), (25, -50), (40, -30)]
    rows = [drive.commanded(jnp.deg2rad(jnp.asarray([one, 0.0, other]))) for one, other in angles]
    inputs = {
        f"joint{joint:02d}_pressure_{which}": np.interp(
            times, knots, np.stack(rows)[:, row, joint - 1]
        )
        for joint in (1, 3)
        for row, which in enumerate(("first", "second"))
    }
    inputs["joint02_command"] = np.interp(times, [1, 2, 8, 9], [0, 0.4, 0.4, -0.3])
    channels = ["link01_z", "link03_x", "link03_y", "link03_z"]
    blank = {channel: np.zeros_like(times) for channel in channels}
    model = model_for([Run.from_arrays(times, {**inputs, **blank}, definition=known)])
    truth = {**_WHOLE_AIR, **_WHOLE_JOINT, **_WHOLE_CORRECTIONS}
    return synthesise(
        replace(model.refined(1e-3), truth),
        times,
        inputs,
        channels,
        noise={"position": 0.005},
        constants=model,
        seed=8,
        definition={**known, "truth": truth},
        name=name,
    )


def whole_loop(name: str) -> Run:
    """Simulate the torque of one joint of this arm without pressure, over loops of its angle."""
    from giajax import model_for, replace, synthesise

    turns = [0, 20, -20, 10, -5, 30, 0]
    ways = [np.linspace(a, b, abs(b - a) + 1)[1:] for a, b in itertools.pairwise(turns)]
    stiffness, strength, width = _WHOLE_JOINT.values()
    truth = {"elastic": stiffness, "alpha": strength / width, "beta": 1 / width}
    section = {"operator": "bouc_wen", "previous_extremes": [0.0]}
    shape = {"gamma": 1.0, "delta": 0.0, "nu": 1.0, "offset": 0.0}
    angle = np.deg2rad(np.concatenate([[0.0], *ways]))
    known = {"model": "hysteresis", "hysteresis": section}
    blank = Run.from_arrays(None, {"input": angle, "output": 0 * angle}, definition=known)
    return synthesise(
        replace(model_for([blank]), {**truth, **shape}),
        None,
        {"input": angle},
        ["output"],
        noise={"output": 0.001},
        seed=9,
        definition={"truth": _WHOLE_JOINT},
        name=name,
    )


_CORRECTIONS = {
    "alpha.offset": 0.035,
    "alpha.threshold": 0.66,
    "alpha.curvature": 2.3,
    "beta.offset": 0.012,
    "beta.width": 0.05,
    "beta.threshold": 0.38,
    "beta.curvature": 0.72,
}

# By name: the description, the function that makes the run, and its arguments.
STILL = {
    "camera_frame": (
        "The motion of pitch_yaw, recorded by a camera whose frame is rotated by 5 deg and "
        "shifted by 0.1 m. The sidecar does not specify this pose. Links are hidden for several "
        "seconds.",
        turned_camera_run,
        (),
    ),
    "pixels_side": (
        "An arm of six links in front of two cameras in the room, with noise of 2 px. The camera "
        "poses in the sidecar are wrong by 30 %.",
        pixel_run,
        (_ROOM_CAMERAS, ["link02", "link04", "link06", "tip"]),
    ),
    "pixels_tip": (
        "The same motion, recorded by a camera on the tip. The camera shows six landmarks in the "
        "room, which leave the image and return.",
        pixel_run,
        (_TIP_CAMERA, list(_MARKS)),
    ),
    "joint": (
        "One muscle of a joint under 0.3 N m on both sides, with noise of 2 % of full scale. This "
        "is the measurement of the paper's fig. 9.",
        joint_run,
        (_CORRECTIONS, [], 0.02),
    ),
    "joint_loads": (
        "A joint with a different geometry under three torques in turn, with noise of 0.2 % of "
        "full scale.",
        joint_run,
        (
            {
                "geometry.anchor_x": 0.92,
                "geometry.anchor_y": 0.19,
                "geometry.wire_x": 0.028,
                "geometry.wire_y": 0.042,
                "geometry.contact_x": 0.06,
                "geometry.contact_y": 0.155,
                "geometry.wire_length": 0.35,
                "geometry.muscle_length": 1.98,
            },
            [0.2, 0.3, 0.4],
            0.002,
        ),
    ),
    "muscle": (
        "A thin braided muscle at six pressures, during filling and exhausting.",
        muscle_run,
        (
            {"law": "braided", "friction": "coulomb"},
            {
                "muscle.effectiveness": 0.85,
                "muscle.end_correction": 1.7,
                "muscle.dead_band": 25e3,
                "friction.half_width[0]": 0.9,
            },
        ),
    ),
    "muscle_empirical": (
        "The same test with a muscle that follows the empirical law, without friction.",
        muscle_run,
        (
            {"law": "empirical"},
            {
                "muscle.force_limit": 42.0,
                "muscle.contraction_limit": 0.24,
                "muscle.bell": 0.8,
                "muscle.decay": 3.0,
            },
        ),
    ),
    "joint_loops": (
        "Nested loops of a joint with hysteresis, generated by a Prandtl-Ishlinskii operator with "
        "plays.",
        joint_loops,
        (
            {
                "elastic": 0.52,
                "weights[0]": 0.09,
                "weights[1]": 0.25,
                "weights[2]": 0.14,
                "weights[3]": 0.2,
                "offset": 0.03,
            },
        ),
    ),
    "bouc_wen_multisine": (
        "A mass on a spring and a damper with a Bouc-Wen element, driven by a multisine of 50 N "
        "RMS from 5 to 150 Hz. This is the estimation run of a benchmark of nonlinear system "
        "identification.",
        bouc_wen_multisine,
        (),
    ),
    "whole_arm": (
        "An arm whose pitch joints are bent by muscles, with pressures as inputs. Its joints have "
        "hysteresis. `fits/whole_arm.toml` fits this run together with the two runs below.",
        whole_arm,
        (),
    ),
    "whole_joint": (
        "One muscle of a joint of this arm on a test bench, as in joint.csv.",
        joint_run,
        (_WHOLE_CORRECTIONS, [], 0.02),
    ),
    "whole_loop": (
        "Torque versus angle of a joint of this arm without pressure: a spring and Dahl friction.",
        whole_loop,
        (),
    ),
    "one_link": (
        "A simulated arm with one link that snaps through at about 0 deg, for the command history "
        "of the paper and for loops within it (`giajax hysteresis`).",
        one_link,
        (),
    ),
}

# Units of the runs whose channels may have any quantity.
UNITS = {
    "bouc_wen_multisine": {"input": "N", "output": "mm"},
    "whole_loop": {"input": "deg", "output": "N_m"},
}


def wind_input() -> str:
    """Return the input table of `wind.csv`: commands, and a steady breeze with gusts."""
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


# A cardboard tube that swings from a pin. docs/film.md uses the same tube with another C_D.
_TUBE: dict[str, dict[str, Any]] = {
    "arm": {
        "preset": "pendulum",
        "links": 1,
        "link_length_m": 0.6,
        "link_diameter_m": 0.08,
        "link_mass_kg": 0.03,
        "buoyancy": True,
        "parameters": {"air.drag_coefficient": 1.15},
    },
    "initial": {"angle_deg": 50.0},
}


def film() -> str:
    """Return `film.txt`: positions of the end of a swinging tube in cm, from Tracker, with gaps."""
    from giajax import model_for, predict

    times = np.arange(181) / 30
    still = np.zeros_like(times)
    plan = Run.from_arrays(times, {"tip_x": still, "tip_z": still}, definition=_TUBE)
    seen = predict(model_for([plan]).refined(1e-3), plan)
    random = np.random.default_rng(12)
    places = 100 * np.stack([seen["tip_x"], seen["tip_z"]], axis=1)
    places += 0.2 * random.normal(size=places.shape)
    lines = ["\ttip\t\t", "t\tx\ty\t"]
    for time, place, lost in zip(times, places, random.random(len(times)) < 0.05, strict=True):
        cells = ["", ""] if lost else [f"{value:.3f}" for value in place]
        lines.append("\t".join([f"{time:.4f}", *cells]))
    return "\n".join(lines) + "\n"


def command_line(name: str) -> str:
    """Return the command that generates a run in this folder."""
    if name in STILL:
        return "python regenerate.py"
    return f"giajax simulate --to {name}.csv {RUNS[name][1]} {_EXACT}"


def make(name: str, out: Path, digits: int = DIGITS) -> None:
    """Generate one run of the tables."""
    if name in STILL:
        _, function, arguments = STILL[name]
        run = function(name, *arguments)
        facts = {"definition": run.definition, "units": UNITS.get(name), "digits": digits}
        write_run(out, run.times, run.values, **facts, force=True)
        return
    more = ["--digits", str(digits), "--to", str(out), "--force"]
    words = [*shlex.split(command_line(name))[1:], *more]
    said = io.StringIO()
    with contextlib.chdir(HERE), contextlib.redirect_stdout(said):
        status = giajax(words)
    if status:
        raise SystemExit(f"{command_line(name)} ended with status {status}")


def readme() -> str:
    """Return the text of README.md, from the tables and the sidecars."""
    lines = [
        "# Synthetic runs",
        "",
        "The runs in this folder are simulated with giajax, with noise and gaps. `regenerate.py`",
        "(`make synthetic`) writes them together with this text, and `regenerate.py --check`",
        "compares them with newly simulated runs. Each sidecar gives the constants, the noise,",
        "the true parameter values and, for an arm, the command line. The runs test the fit. They",
        "do not show how well a model describes a real arm, joint or muscle.",
    ]
    for name, (meaning, *_) in {**RUNS, **STILL}.items():
        run = read_run(HERE / f"{name}.csv")
        truth = ", ".join(
            f"`{path}` " + " ".join(f"{number:g}" for number in np.atleast_1d(value))
            for path, value in run.definition.truth.items()
            if path != "recording"
        )
        lines += [
            "",
            f"## {name}.csv",
            "",
            meaning,
            "",
            f"- truth: {truth or 'simulated with other models than those that are fitted'}",
            f"- SHA-256: `{run.sha256}`",
            "",
            "```",
            command_line(name),
            "```",
        ]
    lines += [
        "",
        "## film.txt",
        "",
        "A table from Tracker with the positions of the end of a swinging tube (`docs/film.md`).",
        "",
        f"- truth: `air.drag_coefficient` {_TUBE['arm']['parameters']['air.drag_coefficient']:g}",
    ]
    return "\n".join(lines) + "\n"


def write() -> None:
    """Regenerate all files of this folder."""
    (HERE / "inputs" / "wind.csv").write_text(wind_input())
    (HERE / "film.txt").write_text(film())
    for name in (*RUNS, *STILL):
        make(name, HERE / f"{name}.csv")
        print(f"wrote {name}.csv")
    (HERE / "README.md").write_text(readme())


def same(one: object, other: object) -> bool:
    """Return whether two definitions agree, apart from rounding on another machine."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-12)
    return one == other


def differences(name: str) -> list[str]:
    """Return the differences of one run from its regenerated version; empty if there are none."""
    path = HERE / f"{name}.csv"
    try:
        kept = read_run(path)  # compares the checksum
    except InputError as error:
        return [str(error)]
    if kept.definition.sha256 is None:
        return [f"{sidecar_path(path).name} states no checksum"]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, f"{name}.csv")
        make(name, out, digits=15)
        made = read_run(out)
    found = []
    ignored = {"sha256", "origin"}
    stated = (item.definition.model_dump(exclude=ignored) for item in (kept, made))
    if not same(*stated):
        found.append(f"{sidecar_path(path).name} states something else than its command line")
    if list(kept.values) != list(made.values) or not np.array_equal(kept.times, made.times):
        return [*found, f"{path.name} has other channels or times"]
    for channel, values in kept.values.items():
        if kept.channels[channel].quantity == "text":
            if list(values) != list(made.values[channel]):
                found.append(f"{path.name}: {channel} has other words")
            continue
        if not np.array_equal(np.isnan(values), np.isnan(made.values[channel])):
            found.append(f"{path.name}: {channel} has other gaps")
            continue
        unit = kept.channels[channel]
        written, exact = unit.from_si(values), unit.from_si(made.values[channel])
        # The file rounds to half a unit of the last digit.
        size = np.maximum(np.abs(written), 1e-300)
        rounding = 0.5 * 10.0 ** (np.floor(np.log10(size)) + 1 - DIGITS)
        off = np.abs(written - exact) - rounding * (1 + 1e-9) - unit.from_si(ALLOWED)
        if np.nanmax(off) > 0:
            found.append(f"{path.name}: {channel} differs by {np.nanmax(off):.2g} {unit.unit}")
    return found


def check() -> list[str]:
    """Return all differences of this folder from its regenerated contents."""
    found = [difference for name in (*RUNS, *STILL) for difference in differences(name)]
    if (HERE / "inputs" / "wind.csv").read_text() != wind_input():
        found.append("inputs/wind.csv is not what the table says")
    seen = [
        np.genfromtxt(io.StringIO(text), delimiter="\t", skip_header=2)
        for text in (
            (HERE / "film.txt").read_text(),
            film(),
        )
    ]
    if not np.allclose(*seen, atol=2e-3, rtol=0, equal_nan=True):  # rounding of the last digit
        found.append("film.txt is not what its function makes")
    if not found and (HERE / "README.md").read_text() != readme():
        found.append("README.md is not up to date")
    return found


def main(arguments: list[str]) -> int:
    """Write, or compare with `--check`; return the exit status."""
    if arguments not in ([], ["--check"]):
        print(f"usage: {os.path.basename(__file__)} [--check]", file=sys.stderr)
        return 2
    if not arguments:
        write()
        return 0
    found = check()
    print("\n".join(found) or f"{len(RUNS) + len(STILL)} runs regenerate")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
