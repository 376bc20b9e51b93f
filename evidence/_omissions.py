"""Omissions: how often the fit of an incomplete model is judged adequate, with wrong values.

Motions of an arm of 12 links are simulated by MuJoCo (RK4 with steps of 10 ms). Each recording has
one effect that the fitted model lacks, of the camera, the drives, the air or the joints. Two sensor
sets record each motion: 12 channels with 10 mm of white noise and 4 with 20 mm, both stated. A fit
is *off* if one of its four parameters deviates from the truth by more than three standard errors.
It has *named* the omission if the omission, or an effect that the data can hardly distinguish from
it, is among the first three suspects.
"""

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ._record import ROOT, commit
from ._study import Figures, Study
from ._suspects import differing, listed

if TYPE_CHECKING:
    from giajax import FitResult, Run

Array = np.ndarray

LINKS, END, STEP, EVERY = 12, 25.0, 0.01, 0.1
ANGLES_DEG = {1: 30.0, 4: 20.0, 7: -25.0}
TRUTH = {
    "air.drag_coefficient": 1.18,
    "joints.pitch_stiffness": 2.2,
    "joints.yaw_stiffness": 25.0,
    "joints.damping": 0.07,
}
START = dict(zip(TRUTH, (0.8, 1.7, 20.0, 0.12), strict=True))
POINTS = ("link04", "link08", "link12", "tip")
SENSORS = {"12 of 10 mm": ("xyz", 0.01), "4 of 20 mm": ("z", 0.02)}
OFF, FIRST = 3.0, 3
NOTHING, MEMORY = "nothing", "nothing, and noise with a memory"
USUAL = "nothing, by a camera and an arm as they are"
SINGLE = "nothing, by a camera or an arm with one thing as it is"
UNCERTAIN = ("camera.delay", "camera.clock_rate", "camera.scale", "links.diameter")


@dataclasses.dataclass(frozen=True)
class Case:
    """Effects in a recording that the fitted model lacks.

    Attributes:
        named: correct suspects, by the start of their path.
        arm: keywords of the simulated arm.
        parameters: parameters of this arm, in addition to the true values.
        command: motion of the drives (rad), from times and commanded angles.
        friction: strength of the Dahl friction in every joint, N m.
        torque: torques of all joints (N m) in addition to their springs, from the time (s), their
            deflections (rad) and stiffnesses (N m/rad).
        stamp: true time of a time stamp, s.
        seen: recorded positions from times and true positions (m), shape (sample, point, 3).
        drawn: number of the calibration errors (delay, rate, scale and width) that are sampled for
            each recording; if it is less than four, they take turns.
    """

    named: tuple[str, ...] = ()
    arm: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    command: Callable[[Array, Array], Array] = lambda times, angles: angles
    friction: float = 0.0
    torque: Callable[[float, Array, Array], Array] | None = None
    stamp: Callable[[Array], Array] = lambda times: times
    seen: Callable[[Array, Array], Array] = lambda times, points: points
    drawn: int = 0


def _lagged(times: Array, angles: Array, lag: float = 0.4) -> Array:
    """Return a first-order lag of piecewise linear angles, exact at the rows."""
    out, step = angles.copy(), times[1] - times[0]
    fade = np.exp(-step / lag)
    for row in range(1, len(out)):
        slope = (angles[row] - angles[row - 1]) / step
        out[row] = angles[row] - slope * lag + (out[row - 1] - angles[row - 1] + slope * lag) * fade
    return out


def _exchanged(times: Array, points: Array) -> Array:
    """Exchange two markers in the second half of the run."""
    swapped = points.copy()
    late = times > END / 2
    swapped[late, 1], swapped[late, 2] = points[late, 2], points[late, 1]
    return swapped


def _without(joint: int, angles: Array) -> Array:
    """Return the angles if the drive of a joint does not move."""
    return np.where(np.arange(1, LINKS + 1) == joint, 0.0, angles)


def _by_a_lens(times: Array, points: Array) -> Array:
    """Apply a lens that points at the middle of the straight arm and contracts its ends."""
    del times
    middle = np.array([LINKS / 2, 0.0, 0.0])
    across = (points - middle) / (LINKS / 2)
    return points - 0.05 * (points - middle) * np.sum(across**2, axis=-1, keepdims=True)


def _glitching(times: Array, points: Array) -> Array:
    """Replace 2 % of the cells by outliers with a standard deviation of 0.3 m."""
    del times
    random = np.random.default_rng(7)
    wrong = random.random(points.shape) < 0.02
    return points + 0.3 * wrong * random.normal(size=points.shape)


def _still(times: Array, points: Array) -> Array:
    """Hold one marker at its position in the second half of the run."""
    still = points.copy()
    late = np.flatnonzero(times > END / 2)
    still[late, 1] = points[late[0], 1]
    return still


_SCATTER = 1 + 0.15 * np.random.default_rng(5).normal(size=LINKS)
_TURN = np.deg2rad(2.0)

CASES = {
    NOTHING: Case(),
    MEMORY: Case(),
    USUAL: Case(drawn=len(UNCERTAIN)),
    "camera 30 ms late": Case(("camera.delay",), stamp=lambda t: t - 0.03),
    "camera 50 ms late": Case(("camera.delay",), stamp=lambda t: t - 0.05),
    "clock 0.5 % slow": Case(("camera.clock_rate",), stamp=lambda t: 1.005 * t),
    "scale 1 % off": Case(("camera.scale", "links.length"), seen=lambda _, p: 1.01 * p),
    "camera turned 2 deg": Case(
        ("camera.rotation", "base_rotation"),
        seen=lambda _, p: (
            p
            @ np.array(
                [
                    [np.cos(_TURN), 0, np.sin(_TURN)],
                    [0, 1, 0],
                    [-np.sin(_TURN), 0, np.cos(_TURN)],
                ]
            )
        ),
    ),
    "camera 2 cm aside": Case(
        ("camera.origin", "marker"), seen=lambda _, p: p - np.array([0.0, 0.02, 0.02])
    ),
    "two markers exchanged": Case(("points",), seen=_exchanged),
    "drives with a lag of 0.4 s": Case(("joints.drive_lag",), command=_lagged),
    "drives reach 97 %": Case(("joints.drive_gain",), command=lambda _, angles: 0.97 * angles),
    "wind of 5 cm/s": Case(("air.wind",), parameters={"air.wind": [0.0, 0.05, 0.02]}),
    "drag along the links": Case(("arm.drag = strip",), arm={"drag": "strip"}),
    "friction of 0.03 N m": Case(
        ("joints.friction", "joints.memory", "joints.stops"),
        parameters={"joints.friction": 0.03},
    ),
    "gravity, trimmed but for 3 %": Case(
        ("gravity", "buoyancy", "arm.trim"),
        arm={"gravity": 9.81, "trim": True},
        parameters={"buoyancy.imbalance": 0.03},
    ),
    "3 g more at the tip": Case(
        ("links.mass", "point_masses", "links.inertia"),
        arm={"tip": 0.003},
    ),
    "stiffness scatters by 15 %": Case(
        ("joints.stiffness_factor",), parameters={"joints.stiffness_factor": _SCATTER}
    ),
    "stiffness leaks by 30 %": Case(
        ("joints.stiffness_drift",),
        torque=lambda time, bent, stiffness: 0.3 * min(time / END, 1.0) * stiffness * bent,
    ),
    "lens with k1 = -0.05": Case(("camera.lens",), seen=_by_a_lens),
    "drives end at 27 deg": Case(
        ("joints.drive_saturation", "joints.drive_gain"),
        command=lambda _, angles: np.clip(angles, *np.deg2rad([-27, 27])),
    ),
    "the drive of joint 7 is dead": Case(
        ("joints.drive_gain",), command=lambda _, angles: _without(7, angles)
    ),
    "that of joint 4, the only yaw": Case(
        ("joints.drive_gain",), command=lambda _, angles: _without(4, angles)
    ),
    "joints remember 0.03 N m": Case(
        ("joints.memory", "joints.stops", "joints.friction"), friction=0.03
    ),
    "air that moves along": Case(
        ("air.added_mass",), parameters={"air.added_mass_coefficient": 1.0}
    ),
    "joints harden": Case(
        ("joints.laws.hardening",),
        torque=lambda time, bent, stiffness: -10 * stiffness * bent**3,
    ),
    "2 % of cells wrong by 0.3 m": Case(("outliers",), seen=_glitching),
    "a marker that stands still": Case(("points",), seen=_still),
    SINGLE: Case(drawn=1),
}
OMITTED = tuple(name for name in CASES if name != SINGLE)
AND = " + "


def case_of(name: str) -> Case:
    """Return one of `CASES`, or the combination of several whose names are joined by `AND`."""
    parts = [CASES[one] for one in name.split(AND)]
    torques = [each.torque for each in parts if each.torque is not None]

    def in_turn(which: str) -> Callable[[Array, Array], Array]:
        steps = [getattr(each, which) for each in parts]
        return lambda times, given: functools.reduce(lambda v, f: f(times, v), steps, given)

    def torque(time: float, bent: Array, stiffness: Array) -> Array:
        return sum((each(time, bent, stiffness) for each in torques), np.zeros(LINKS))

    return Case(
        named=tuple(path for each in parts for path in each.named),
        arm={key: value for each in parts for key, value in each.arm.items()},
        parameters={key: value for each in parts for key, value in each.parameters.items()},
        command=in_turn("command"),
        friction=sum(each.friction for each in parts),
        torque=torque if torques else None,
        stamp=lambda times: functools.reduce(lambda v, each: each.stamp(v), parts, times),
        seen=in_turn("seen"),
        drawn=max(each.drawn for each in parts),
    )


def run(size: int, seed: int, names: Sequence[str] = OMITTED) -> Figures:
    """Return the figures of `size` recordings of each case and sensor set."""
    return {cell: counted(found) for cell, found in repeated(size, seed, names, one).items()}


def part(size: int, seed: int) -> Figures:
    """Return the figures of a delayed camera only."""
    return run(size, seed, ("camera 30 ms late",))


def repeated(
    size: int, seed: int, names: Sequence[str], single: Callable[..., Figures]
) -> dict[str, list[Figures]]:
    """Return the results of `single` for `size` recordings of each case and sensor set."""
    cells = [(name, sensors) for name in names for sensors in SENSORS]
    arguments = [
        {"name": name, "sensors": sensors, "entropy": [seed, number]}
        for number in range(size)
        for name, sensors in cells
    ]
    found = kept(single, arguments, every=20)
    return {
        f"{name}; {sensors}": found[at :: len(cells)] for at, (name, sensors) in enumerate(cells)
    }


def kept(
    single: Callable[..., Figures], arguments: Sequence[Mapping[str, Any]], every: int
) -> list[Figures]:
    """Return the result of `single` for each of these arguments, computed by this commit.

    Two processes share the work. Each result is stored until all results of this commit are
    complete, because the studies take hours and the same command must be able to continue.
    """
    from giajax.runtime.execution import open_executor, run_tasks
    from giajax.runtime.tasks import Task

    code = commit()
    tasks = [Task(single, {**each, "code": code}) for each in arguments]

    def told(outcome: Any, done: int, count: int) -> None:
        if done % every == 0 or outcome.status == "failed":
            print(f"{done} of {count}: {outcome.message or outcome.status}", flush=True)

    # Results of uncommitted code are not stored, because their code would not be known later.
    folder = None if code is None else ROOT / "giajax-out" / "evidence" / "omissions"
    with open_executor(2) as executor:
        outcomes = run_tasks(tasks, executor=executor, folder=folder, progress=told)
    if undone := [outcome for outcome in outcomes if outcome.status != "done"]:
        raise RuntimeError(f"{len(undone)} fits were not computed: {undone[0].message}")
    return [outcome.value for outcome in outcomes]


@functools.cache
def _motion(name: str) -> tuple[Array, Array, Array]:
    """Return fine times (s), commanded angles (rad), and positions (m), (sample, point, 3)."""
    import jax.numpy as jnp

    from giajax import takeichi_20m
    from giajax.mechanics.arm import PointMasses
    from giajax.simulation import ramps
    from peers.mujoco_air import MujocoInAir

    case = case_of(name)
    fine = np.arange(round((END + 1) / STEP) + 1) * STEP
    commanded = np.zeros((len(fine), LINKS))
    for joint, degrees in ANGLES_DEG.items():
        begin = 0.5 + 3.0 * (joint - 1) / 3
        up_and_down = [0, degrees, degrees, degrees / 3]
        commanded[:, joint - 1] = np.interp(
            fine, [begin, begin + 2, begin + 9, begin + 11], np.deg2rad(up_and_down)
        )
    keywords = dict(case.arm)
    if (mass := keywords.pop("tip", None)) is not None:
        weight, place = jnp.array([mass]), jnp.array([0.99])
        keywords["point_masses"] = PointMasses(links=(LINKS,), mass=weight, position=place)
    values = {**TRUTH, **case.parameters}
    arm = takeichi_20m(LINKS, parameters=values, **keywords)
    driven = ramps(fine, case.command(fine, commanded), tolerance=1e-12)
    peer = MujocoInAir(arm, driven, friction=case.friction, friction_stiffness=3.0)
    chain = peer.chain
    chain.command = peer.command
    if (torque := case.torque) is not None:
        plain, stiffness = chain._passive, chain._stiffness

        def further(model: Any, data: Any) -> None:
            plain(model, data)
            bent = data.qpos - chain._command_now(data.time)
            data.qfrc_passive[:] += torque(data.time, bent, stiffness)

        chain._passive = further  # type: ignore[method-assign]
    own = case.friction or "air.added_mass_coefficient" in case.parameters
    angles = (peer if own else chain).trajectory(fine, STEP)[:, 0]
    centres, tips = peer.places(angles)
    links = [int(point[4:]) - 1 for point in POINTS[:-1]]
    return fine, commanded, np.concatenate([centres[:, links], tips[:, None]], axis=1)


def recorded(
    name: str, sensors: str, entropy: list[int], **arm: Any
) -> tuple["Run", dict[str, float]]:
    """Return a recording with its own noise, by seed and number, and the true values.

    Its definition of the arm contains the number of links and `arm`.
    """
    from scipy.interpolate import CubicSpline

    import giajax

    fine, commanded, positions = _motion(name)
    case, (axes, noise) = case_of(name), SENSORS[sensors]
    stamps = np.arange(round(END / EVERY) + 1) * EVERY
    seed, number = entropy
    cases = [list(CASES).index(one) for one in name.split(AND)]
    places = [seed, *cases, list(SENSORS).index(sensors), number]
    random, values, truth = np.random.default_rng(places), {}, dict(TRUTH)
    late, rate, scale, width = _of_device(case.drawn, random, number)
    # Drag is proportional to C_D times the width, so a wider arm with equal drag has a smaller C_D.
    truth["air.drag_coefficient"] /= width
    true = np.clip((1 + rate) * case.stamp(stamps) - late, 0.0, fine[-1])
    points = scale * case.seen(stamps, CubicSpline(fine, positions)(true))
    for place, point in enumerate(POINTS):
        for axis in axes:
            fresh = noise * random.normal(size=len(stamps))
            if name == MEMORY:
                slow, kept = noise * random.normal(), []
                for each in fresh:
                    kept.append(slow := 0.9 * slow + np.sqrt(0.19) * each)
                fresh = np.array(kept)
            values[f"{point}_{axis}"] = points[:, place, "xyz".index(axis)] + fresh
    rows = np.round(stamps / STEP).astype(int)
    for joint in ANGLES_DEG:
        values[f"joint{joint:02d}_command"] = commanded[rows, joint - 1]
    model = {"model": "arm", "arm": {"links": LINKS, **arm}, "noise": {"position_m": noise}}
    return giajax.Run.from_arrays(stamps, values, name="omission", definition=model), truth


def _of_device(drawn: int, random: np.random.Generator, number: int) -> Array:
    """Return delay (s), rate, scale and width of a recording; `drawn` of them are not exact."""
    right = np.array([0.0, 0.0, 1.0, 1.0])
    if not drawn:
        return right
    late, rate = random.uniform(0, EVERY + 0.05), random.normal(0, 1e-3)
    usual = np.array([late, rate, *random.normal(1, 0.01, size=2)])
    return np.where(np.isin(np.arange(4), (number + np.arange(drawn)) % 4), usual, right)


def one(name: str, sensors: str, entropy: list[int], code: str | None) -> Figures:
    """Return the figures of the fit of one recording; `code` is the commit of giajax."""
    del code
    recording, truth = recorded(name, sensors, entropy)
    return judged(CASES[name], fitted(recording), truth)


def judged(case: Case, result: "FitResult", truth: Mapping[str, float]) -> Figures:
    """Return the figures of a fit to a recording with known true values."""
    shares, covered = {}, 0
    for path, value in truth.items():
        found = result.parameters[path]
        low, high = found.interval or (0, 0)
        shares[path] = float((found.value - value) / (found.standard_error or np.inf))
        covered += bool(low <= value <= high)
    paths = _first(result)
    there = [path for path in result.nuisances if _is_there(result, path)]
    rank = next((i for i, those in enumerate(paths, 1) if _is_named(case, those)), None)
    if rank is None and _is_named(case, tuple(there)):
        rank = 1  # the fit includes the effect
    return {
        "status": result.verdict.status,
        "reasons": [reason.code for reason in result.verdict.reasons],
        "shares": shares,
        "covered": covered,
        "rank": rank,
        "first": [list(those) for those in paths],
    }


def counted(found: Sequence[Figures]) -> Figures:
    """Return the counts of the outcomes of the fits of a case."""
    counts: Counter[str] = Counter()
    instead: Counter[str] = Counter()
    for each in found:
        off = max(map(abs, each["shares"].values())) > OFF
        counts[each["status"]] += 1
        counts["covered"] += each["covered"]
        counts["off"] += off
        counts["adequate and off"] += off and each["status"] == "adequate"
        counts["named"] += each["rank"] is not None
        counts["with suspects"] += bool(each["first"])
        counts["accused"] += each["status"] != "adequate" or bool(each["first"])
        if each["status"] != "adequate" and each["rank"] != 1:
            instead[each["first"][0][0] if each["first"] else "nothing"] += 1
    kinds = ["adequate", "doubtful", "inadequate", "off", "adequate and off", "named", "covered"]
    kinds += ["with suspects", "accused"]
    return {"recordings": len(found), **{k: counts[k] for k in kinds}, "instead": dict(instead)}


def fitted(recording: "Run") -> "FitResult":
    """Fit a recording, with the suspects of `giajax fit`."""
    import giajax
    from giajax.studies import with_suspects

    model: Any = giajax.model_for([recording])
    result = giajax.fit(model, recording, free=list(START), start=START, check=False)
    adequate = result.verdict.status == "adequate"
    try:
        return with_suspects(result, recording, parameters_alone=adequate)
    except giajax.InputError:
        # With all parts switched on, the model may not be computable where the fit ended.
        return result


def _first(result: "FitResult") -> list[tuple[str, ...]]:
    """Return the first significant suspects, each with those that are indistinguishable."""
    from giajax.studies import LEVEL, promising

    rows = [
        row
        for row in promising(result.suspects)
        if (row.p_value or 0.0) < LEVEL and not row.explained_by
    ]
    return [(row.path, *row.alike, *row.together) for row in rows[:FIRST]]


def _is_there(result: "FitResult", path: str) -> bool:
    """Return whether a fitted calibration error is significant."""
    estimate = result.parameters[path]
    right = 1.0 if path == "camera.scale" else 0.0
    return abs(estimate.value - right) > OFF * (estimate.standard_error or np.inf)


def _is_named(case: Case, paths: tuple[str, ...]) -> bool:
    return any(path.startswith(right) for path in paths for right in case.named)


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report counts of this study that differ by more than by chance."""
    return differing(stored, new, {"adequate": "judged adequate in", "named": "named in"})


_SHOWN = {
    SINGLE: "no omission, one usual calibration error of camera or arm",
    USUAL: "no omission, usual calibration errors of camera and arm",
    MEMORY: "no omission, correlated noise",
    NOTHING: "no omission",
    "clock 0.5 % slow": "camera clock 0.5 % slow",
    "scale 1 % off": "camera scale with an error of 1 %",
    "camera turned 2 deg": "camera rotated by 2 deg",
    "camera 2 cm aside": "camera displaced by 2 cm",
    "drives reach 97 %": "drives with a gain of 97 %",
    "drives end at 27 deg": "drives saturated at 27 deg",
    "gravity, trimmed but for 3 %": "gravity, with 3 % of the weight not balanced",
    "3 g more at the tip": "additional mass of 3 g at the tip",
    "stiffness scatters by 15 %": "stiffness with a scatter of 15 % between joints",
    "stiffness leaks by 30 %": "decrease of stiffness by 30 % during the run",
    "the drive of joint 7 is dead": "failed drive of joint 7",
    "that of joint 4, the only yaw": "failed drive of joint 4, the only yaw drive",
    "joints remember 0.03 N m": "joint memory of 0.03 N m",
    "air that moves along": "added mass of the air",
    "joints harden": "hardening joint springs",
    "2 % of cells wrong by 0.3 m": "2 % of outliers, 0.3 m",
    "a marker that stands still": "a marker that stops moving",
    "camera 30 ms late": "camera delay of 30 ms",
    "camera 50 ms late": "camera delay of 50 ms",
    "drives with a lag of 0.4 s": "drive lag of 0.4 s",
    "lens with k1 = -0.05": "lens distortion with k1 = -0.05",
    "12 of 10 mm": "x, y, z, noise of 10 mm",
    "4 of 20 mm": "z, noise of 20 mm",
}


def shown(case: str) -> str:
    """Return the stored name of one or more cases in the wording of the page."""
    for stored, words in _SHOWN.items():
        if case == stored or case.startswith(f"{stored}; ") or f"; {stored}" in case:
            case = case.replace(stored, words, 1)
    return case


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each omission and sensor set."""
    rows = [
        "| omission; recorded coordinates | verdict `adequate` | verdict `doubtful` | deviation "
        "above 3 standard errors | `adequate` and deviation above 3 standard errors | omission "
        "identified | values within their 95 % intervals | other first suspects |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        cells = [each[key] for key in ("adequate", "doubtful", "off", "adequate and off", "named")]
        shares = " | ".join(f"{cell} of {each['recordings']}" for cell in cells)
        covered = f"{each['covered']} of {each['recordings'] * len(TRUTH)}"
        instead = {"none" if path == "nothing" else path: n for path, n in each["instead"].items()}
        rows.append(f"| {shown(name)} | {shares} | {covered} | {listed(instead)} |")
    return rows


OMISSIONS = Study(
    name="omissions",
    meaning=(
        "MuJoCo simulates recordings of an arm of 12 links, each with one effect that the fitted "
        "model omits. The table lists how often the verdict is `adequate`, how often a parameter "
        "deviates from the truth by more than three standard errors, how often both occur "
        "together, and how often the omission is identified. An omission is identified if the "
        "omitted effect, or an effect that the data can hardly distinguish from it, is among the "
        "first three suspects. It is also identified if every fit frees the effect as a nuisance "
        "parameter. The recordings contain x, y and z of four points with a noise of 10 mm, or "
        "only z with a noise of 20 mm."
    ),
    size=20,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
