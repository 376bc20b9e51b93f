"""The suspects of an arm: its neutral values and its choices.

`notebooks/04_trust.ipynb` checks that an omitted effect is ranked first, and
`evidence/_suspects.py` measures this for each kind of effect.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import giajax
import small_arm
from giajax.fitting import Suspect
from giajax.models import ArmModel
from giajax.runtime.text import InputError
from giajax.schema.parameters import left_out, replace
from giajax.studies import inquiry
from giajax.studies._stepwise import Climb, Fits, Measured

CHANNELS = [f"link{link:02d}_{axis}" for link in (2, 4) for axis in "xyz"]
TIMES = np.linspace(0.0, 4.0, 41)
RAMP = np.clip(TIMES / 0.5, 0, 1)
COMMANDS = {"joint01_command": 0.6 * RAMP, "joint02_command": -0.5 * RAMP}


TIP_AND_HARDENING = (
    "point_masses.mass = 0.003 kg at the tip",
    "joints.laws.hardening.cubic = 1 N m/rad^3",
)


def arm(**options):
    return ArmModel(giajax.takeichi_20m(small_arm.LINKS, **options))


def recorded(truth, seed=0, commands=COMMANDS):
    model = replace(arm(), {**small_arm.TRUTH, **truth})
    stated = {"noise": {"position": small_arm.NOISE}, "constants": arm()}
    return giajax.synthesise(model, TIMES, commands, CHANNELS, seed=seed, **stated)


def asked(run):
    """Return the suspects of a fit of a plain arm, from a wrong initial guess."""
    free = list(small_arm.START)
    result = giajax.fit(arm(), run, free=free, start=small_arm.START, check=False)
    return giajax.suspects(result, run)


@pytest.mark.parametrize(
    "truth",
    [
        pytest.param({"camera.lens_k1": -0.05}, marks=pytest.mark.long),
        pytest.param({"joints.drive_saturation": 0.3}, marks=pytest.mark.slow),
    ],
    ids=lambda truth: next(iter(truth)),
)
def test_what_a_recording_has_more_comes_first(truth):
    found = asked(recorded(truth))
    first, (path, value) = found.promising[0], next(iter(truth.items()))
    assert path in (first.path, *first.alike, *first.together)
    # A wrong model must not suggest that points or columns were exchanged.
    assert all(each.kind not in ("points", "columns") for each in found.rows)
    row = found.of(path)
    assert row.p_value < 1e-6
    assert row.estimate == pytest.approx(value, abs=max(4 * row.estimate_error, 0.3 * abs(value)))


SWAPPED = {
    f"{one}_{axis}": f"{other}_{axis}"
    for one, other in (("link02", "link04"), ("link04", "link02"))
    for axis in "xyz"
}


SLOW, LONG = pytest.mark.slow, pytest.mark.long


@pytest.mark.parametrize(
    ("name", "rename", "times"),
    [
        pytest.param(
            "columns: joint01_command with the opposite sign",
            {},
            {"joint01_command": -1.0},
            id="sign",
            marks=LONG,
        ),
        pytest.param(
            "columns: joint03_command that of joint 2",
            {"joint02_command": "joint03_command"},
            {},
            id="joint",
            marks=SLOW,
        ),
        pytest.param("columns: link02 and link04 exchanged", SWAPPED, {}, id="labels", marks=LONG),
    ],
)
def test_a_mistake_with_columns_is_among_the_first_suspects(name, rename, times):
    run = recorded({})
    values = {rename.get(n, n): times.get(n, 1.0) * v for n, v in run.values.items()}
    wrong = giajax.Run.from_arrays(run.times, values, definition=run.definition.contents())
    found = asked(wrong)
    assert name in [row.path for row in found.promising[:3]]
    assert found.of(name).p_value < 1e-6
    assert not [row for row in asked(run).rows if row.kind in ("axes", "columns")]


@pytest.mark.slow
def test_a_table_of_all_joints_with_a_command_in_the_wrong_column_is_named():
    """The model is built in Python, so the run does not give the number of links."""
    right = recorded({})
    values = right.values | {"joint03_command": right.values["joint02_command"]}
    values |= {"joint02_command": 0 * TIMES, "joint04_command": 0 * TIMES}
    noise = {"noise": {"position_m": small_arm.NOISE}, "uncertainty": {"defaults": False}}
    found = asked(giajax.Run.from_arrays(TIMES, values, name="table", definition=noise))
    first = [row.path for row in found.promising[:3]]
    assert "columns: joint03_command that of joint 2" in first


@pytest.mark.long
def test_a_drive_that_does_not_move_is_named():
    """One of four commanded joints; in a fit, its gain is freed and estimated as zero."""
    # The further joints move at the same times, so that the programs are the same.
    more = {"joint03_command": 0.1 * RAMP, "joint04_command": 0.4 * RAMP}
    run = recorded({"joints.drive_gain": [1.0, 1.0, 0.0, 1.0]}, commands=COMMANDS | more)
    free = list(small_arm.START)
    result = giajax.fit(arm(), run, free=free, start=small_arm.START, check=False)
    assert result.verdict.status == "inadequate"
    found = giajax.suspects(result, run)
    first = found.promising[0]
    assert first.path == "joints.drive_gain[2]"
    assert first.kind == "parameter"
    assert first.estimate == pytest.approx(0, abs=0.2)
    freed = giajax.fit(arm(), run, free=[*free, first.path], start=small_arm.START, check=False)
    assert freed.verdict.status == "adequate"
    assert freed.parameters[first.path].value < 0.05


class NothingAsked(Fits):
    """Fits for a selection whose suspects are given."""

    def suspects(self, result, runs):
        return None


@pytest.mark.long
def test_a_drive_that_seemed_to_be_weak_alone_stands_for_all_that_are():
    """All drives reach 90 %, so the first freed gain is tied to all; if one is weak, it is not."""
    one = Suspect("joints.drive_gain[0]", "parameter", "", 1.0, 0.9, 0.01, 99.0, 1, 1e-9, True)
    for gains, tied in ((0.9, True), ([0.9, 1.0, 1.0, 1.0], False)):
        run = recorded({"joints.drive_gain": gains})
        free = list(small_arm.START)
        result = giajax.fit(arm(), run, free=free, start=small_arm.START, check=False)
        climb = Climb([run], [], NothingAsked())
        climb.take(Measured.of(result, [run], []))
        climb.step(1, lambda *_: [one])
        names = [step.change for step in climb.steps()]
        assert names == ["-", one.path, *([f"joints.drive_gain = {one.path}"] if tied else [])]
        found = giajax.get(climb.last.result.model, "joints.drive_gain")
        np.testing.assert_allclose(found, np.broadcast_to(gains, 4), atol=0.02)


class Refused(Fits):
    """Fits that are recorded, none of which can be evaluated."""

    def __init__(self):
        self.changes = []

    def suspects(self, result, runs):
        return None

    def refits(self, result, changes):
        self.changes += changes
        return [InputError("refused") for _ in changes]


def test_a_memory_is_switched_on_with_its_yield_angle_free():
    """Its value is a guess, and a wrong fixed value could compensate for other omitted effects."""
    run = recorded({})
    # If the camera has a delay, a variant moves it to the drives.
    begun = replace(arm(), {"camera.delay": 0.02})
    result = giajax.fit(begun, run, free=["joints.damping"], max_iterations=2, check=False)
    climb = Climb([run], [], Refused())
    climb.take(Measured.of(result, [run], []))
    switches = list(begun.variants())
    rows = [Suspect(name, "switch", "", 0.0, 1.0, 0.1, 9.0, 1, 1e-3, True) for name in switches]
    assert climb.step(len(rows), lambda *_: rows)
    freed = {change.name: change.changed["free"] for change in climb.fits.changes}
    assert freed == {
        **{name: [] for name in switches},
        "joints.memory.strength = 0.02 N m": [
            "joints.memory.strength",
            "joints.memory.yield_angle",
        ],
        "joints.drive_lag = camera.delay, camera.delay = 0": ["joints.drive_lag"],
        TIP_AND_HARDENING[0]: ["point_masses.mass"],
        TIP_AND_HARDENING[1]: ["joints.laws.hardening.cubic"],
    }


@pytest.mark.slow
def test_joints_of_different_stiffness_scatter():
    uneven = small_arm.TRUTH | {"joints.stiffness_factor": [1.1, 1.0, 0.9, 1.0]}
    noise = {"position": small_arm.NOISE / 10}
    truth = replace(arm(), uneven)
    run = giajax.synthesise(truth, TIMES, COMMANDS, CHANNELS, noise=noise, constants=arm())
    row = asked(run).of("joints.stiffness_factor")
    assert row.kind == "scatter"
    assert row.p_value < 1e-6
    assert row.estimate == pytest.approx(0.1, abs=0.07)


@pytest.mark.slow
def test_columns_at_a_coarser_tolerance_do_not_change_the_tests(monkeypatch):
    """The noise is so small that residuals at the tolerance of the columns would be wrong."""
    times = np.linspace(0.0, 4.0, 481)
    commands = {name: np.interp(times, TIMES, row) for name, row in COMMANDS.items()}
    truth = replace(arm(), small_arm.TRUTH)
    noise = {"position": 1e-7}
    run = giajax.synthesise(truth, times, commands, CHANNELS, noise=noise, seed=4, constants=truth)
    result = giajax.fit(truth, run, free=["joints.damping"], start={"joints.damping": 0.07})
    assert result.integration.tolerance < 1e-7
    found = giajax.suspects(result, run, parameters_alone=True)
    assert not found.significant
    monkeypatch.setattr("giajax.studies._suspects._COLUMNS", 0.0)
    exact = giajax.suspects(result, run, parameters_alone=True)
    assert found.chi_square == pytest.approx(exact.chi_square, rel=1e-9)
    drops = {row.path: row.chi_square_drop for row in exact.rows if row.testable}
    for path, drop in drops.items():
        assert found.of(path).chi_square_drop == pytest.approx(drop, rel=1e-2, abs=1e-2)
    assert drops != {path: found.of(path).chi_square_drop for path in drops}


REMEMBERS = {"joints.memory.strength": 0.3, "joints.memory.yield_angle": 0.02}


def test_what_joints_remember_at_the_first_row_is_asked_of_those_that_remember():
    assert "joints.memory.initial" not in arm().scattering()
    assert "joints.memory.initial" in arm(parameters=REMEMBERS).scattering()


# The choices of an arm with hysteresis are programs that take minutes to compile.
@pytest.mark.long
def test_what_joints_remember_at_the_first_row_is_the_first_suspect():
    """The initial memory differs between the joints."""
    model = arm(parameters=REMEMBERS)
    before = {"joints.memory.initial": [0.8, -0.7, -0.6, 0.8]}
    truth = replace(model, {**small_arm.TRUTH, **before})
    noise = {"position": small_arm.NOISE}
    run = giajax.synthesise(truth, TIMES, COMMANDS, CHANNELS, noise=noise, constants=model)
    free = list(small_arm.START)
    result = giajax.fit(model, run, free=free, start=small_arm.START, check=False)
    first = giajax.suspects(result, run).promising[0]
    assert (first.path, first.kind) == ("joints.memory.initial", "scatter")
    assert first.p_value < 1e-3
    assert first.estimate == pytest.approx(0.7, abs=0.4)


@pytest.mark.long
def test_points_that_a_camera_exchanged_or_lost_are_named():
    run, rows = recorded({}), slice(12, 30)

    def first(changed):
        values = {name: row.copy() for name, row in run.values.items()}
        for axis in "xyz":
            changed(values, f"link02_{axis}", f"link04_{axis}")
        return asked(dataclasses.replace(run, values=values)).significant[0]

    def exchange(values, one, other):
        both = values[one][rows].copy(), values[other][rows].copy()
        values[other][rows], values[one][rows] = both

    def take(values, one, other):
        values[one][rows] = values[other][rows]

    def lose(values, one, other):
        values[other][20:] = values[other][20]

    for changed, name, when in (
        (exchange, "link02 and link04 exchanged", "from 1.2 s to 2.9 s"),
        (take, "link02 shows link04", "from 1.2 s to 2.9 s"),
        (lose, "link04 does not move", "s to 4 s"),
    ):
        row = first(changed)
        assert (row.path, row.kind) == (f"points: {name}", "points")
        assert row.note.endswith(when)
        # The fit has adapted to the exchange, so the residuals of all other rows are correlated.
        assert row.p_value < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", TIP_AND_HARDENING)
def test_what_an_arm_may_have_more_is_a_choice(name):
    truth = replace(arm().variants()[name], small_arm.TRUTH)
    noise = {"position": small_arm.NOISE / 10}
    run = giajax.synthesise(truth, TIMES, COMMANDS, CHANNELS, noise=noise, constants=arm())
    found = asked(run)
    row = found.of(name)
    assert row.p_value < 1e-6
    assert row.estimate > 0.3
    assert row.chi_square_drop > 0.5 * found.promising[0].chi_square_drop


@pytest.mark.long
@pytest.mark.parametrize("parameters_alone", [True, False])
def test_lift_that_is_lost_in_a_run_is_named(parameters_alone):
    """This includes a comparison with choices, each of which is a program."""
    model = arm(trim=True, gravity=9.81)
    truth = replace(model, {**small_arm.TRUTH, "buoyancy.imbalance_drift": -0.01})
    noise = {"position": small_arm.NOISE}
    run = giajax.synthesise(truth, TIMES, COMMANDS, CHANNELS, noise=noise, constants=model)
    free = list(small_arm.START)
    result = giajax.fit(model, run, free=free, start=small_arm.START, check=False)
    first = giajax.suspects(result, run, parameters_alone=parameters_alone).promising[0]
    assert "buoyancy.imbalance_drift" in (first.path, *first.alike, *first.together)
    assert first.p_value < 1e-6


@pytest.mark.slow
def test_a_right_arm_is_not_accused():
    named = [row.path for seed in range(3) for row in asked(recorded({}, seed)).significant]
    assert len(named) <= 1


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 10])
def test_noise_with_a_memory_is_no_point_that_was_taken_for_another(seed, monkeypatch):
    """If the noise were white, these data would suggest that one link shows another's marker."""
    # The choices are separate programs that do not matter for points.
    monkeypatch.setattr(ArmModel, "variants", lambda self: {})
    times, fade = np.linspace(0.0, 12.0, 121), 0.9
    ramp = np.clip(times / 0.5, 0, 1)
    commands = {"joint01_command": 0.6 * ramp, "joint02_command": -0.5 * ramp}
    size, model = 20 * small_arm.NOISE, replace(arm(), small_arm.TRUTH)
    stated = {"noise": {"position": size}, "constants": arm()}
    points = ["link03_z", "link04_z", "tip_z"]
    run = giajax.synthesise(model, times, commands, points, seed=0, **stated)
    random, values, true = np.random.default_rng(seed), dict(run.values), giajax.predict(model, run)
    for name in run.observations:
        fresh = size * random.normal(size=len(times))
        fresh[1:] *= np.sqrt(1 - fade**2)
        values[name] = true[name] + scipy.signal.lfilter([1.0], [1.0, -fade], fresh)
    found = asked(dataclasses.replace(run, values=values))
    assert not [row.path for row in found.rows if row.kind == "points"]


@pytest.mark.slow
def test_what_is_switched_on_at_its_neutral_value_changes_nothing():
    """For every optional parameter of an arm with buoyancy and strip drag."""
    model = arm(drag="strip", buoyancy=True, trim=True, gravity=9.81)
    run = recorded({})
    encoders = {"joint01_angle": np.zeros(41), "joint01_rate": np.zeros(41)}
    values = {**run.values, **encoders}
    run = giajax.Run.from_arrays(TIMES, values, definition={"arm": {"links": 4}})
    whole = inquiry(model, []).model
    assert {"air.added_mass_coefficient", "encoder.scale", "camera.scale"} <= set(left_out(model))
    # The remaining ones would add states to the motion, so choices of the model contain them.
    assert all(absent.declaration.has_states for absent in left_out(whole).values())
    plain, on = giajax.predict(model, run), giajax.predict(whole, run)
    for name, row in plain.items():
        assert np.max(np.abs(on[name] - row)) < 1e-6, name


INERTIA = "arm.added_mass = inertia, air.added_mass_coefficient = 1"


def test_choices_of_an_arm():
    names = list(arm().variants())
    assert names == [
        "arm.drag = strip",
        "arm.drag_curve = cylinder",
        "joints.memory.strength = 0.02 N m",
        *TIP_AND_HARDENING,
        INERTIA,
        f"arm.drag = strip, {INERTIA}",
        "arm.trim = true",
        "arm.trim = true, trim_depth = 0.15 m",
    ]
    floating = arm(drag="strip", trim=True, gravity=9.81)
    memory = ["joints.memory.strength = 0.02 N m", *TIP_AND_HARDENING]
    assert list(floating.variants()) == [
        "arm.drag = centre", "arm.drag_curve = cylinder", *memory, INERTIA,
    ]  # fmt: skip
    heavy = ArmModel(giajax.pendulum(1))
    assert list(heavy.variants()) == [
        "arm.drag = strip", "arm.drag_curve = cylinder", *memory, INERTIA,
        f"arm.drag = strip, {INERTIA}",
    ]  # fmt: skip
    moving = {"air.added_mass_coefficient": 1.0, "joints.memory.strength": 0.1}
    remembers = dataclasses.replace(heavy, arm=giajax.replace(heavy.arm, moving))
    assert list(remembers.variants())[2:] == [*TIP_AND_HARDENING, "arm.added_mass = inertia"]
    late = replace(arm(), {"camera.delay": 0.2})
    *same, lag = late.variants()
    assert (same, lag) == (names, "joints.drive_lag = camera.delay, camera.delay = 0")
    lagging = late.variants()[lag]
    assert float(lagging.arm.joints.drive_lag) == 0.2
    assert float(lagging.sensors.camera.delay) == 0
    assert list(lagging.variants()) == names
    other = floating.variants()["arm.drag = centre"]
    assert other.arm.air.drag == "centre"
    assert floating.arm.air.drag == "strip"


def test_an_arm_that_moves_air_keeps_all_forces_per_mass():
    """Drag, springs and dampers are scaled by the moving mass; with gravity, nothing is scaled."""
    model = arm()
    air = model.arm.air
    moved = float(jnp.sum(air.density * model.arm.links.volume))
    ratio = 1 + moved / float(jnp.sum(model.arm.links.mass))
    other = model.variants()[f"arm.drag = strip, {INERTIA}"]
    assert (other.arm.air.drag, other.arm.air.added_mass) == ("strip", "inertia")
    assert float(other.arm.air.added_mass_coefficient) == 1
    for path in ("air.drag_coefficient", "joints.pitch_stiffness", "joints.damping"):
        assert float(giajax.get(other, path) / giajax.get(model, path)) == pytest.approx(ratio)
    weighty = arm(gravity=9.81)
    same = weighty.variants()[INERTIA]
    assert same.arm.air.drag_coefficient == weighty.arm.air.drag_coefficient


def test_an_arm_that_is_to_float_keeps_all_forces_per_mass():
    model = arm()
    floating = model.variants()["arm.trim = true"]
    ratio = float(floating.arm.air.drag_coefficient / model.arm.air.drag_coefficient)
    moving = giajax.mechanics.arm.bodies(floating.arm).mass
    assert ratio == pytest.approx(float(jnp.sum(moving) / jnp.sum(model.arm.links.mass)))
    assert ratio == pytest.approx(0.0843 / 0.047, rel=1e-3)
    for path in ("joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping"):
        changed = float(giajax.get(floating, path) / giajax.get(model, path))
        assert changed == pytest.approx(ratio)
    assert not any("trim" in name for name in floating.variants())


def test_what_is_fitted_is_not_asked_for():
    model = arm()
    free = ["air.drag_coefficient", "links.mass[1]"]
    asked = inquiry(model, free)
    paths = [one.path for one in asked.candidates]
    assert "air.drag_coefficient" not in paths
    (mass,) = [one for one in asked.candidates if one.path == "links.mass"]
    assert mass.direction.step.tolist() == [1, 0, 1, 1]
    assert asked.free[1].step.tolist() == [0, 1, 0, 0]
    # Different masses change in proportion.
    model = dataclasses.replace(
        model, arm=replace(model.arm, {"links.mass": jnp.asarray([0.04, 0.05, 0.05, 0.05])})
    )
    (mass,) = [one for one in inquiry(model, []).candidates if one.path == "links.mass"]
    assert (mass.kind, mass.value, mass.unit, mass.lower) == ("factor", 1, "", 0)
    assert mass.direction.step.tolist() == pytest.approx([0.04, 0.05, 0.05, 0.05])
    assert set(asked.impossible) == {"air.axial_coefficient"}


@pytest.mark.long
def test_added_mass_in_a_wind_that_changes_is_not_tested_where_it_is_not_neutral():
    """Accelerating air exerts a force on the displaced volume, even for a coefficient of 0."""
    model = replace(arm(), small_arm.TRUTH)
    wind = {"wind_x": 0.3 * RAMP, "wind_y": 0.0 * RAMP, "wind_z": 0.5 * np.sin(TIMES)}
    noise = {"position": small_arm.NOISE}
    run = giajax.synthesise(model, TIMES, {**COMMANDS, **wind}, CHANNELS, noise=noise, seed=1)
    free = ["air.drag_coefficient", "joints.pitch_stiffness"]
    result = giajax.fit(model, run, free=free, start={"joints.pitch_stiffness": 2.0}, check=False)
    found = giajax.suspects(result, run)
    assert found.chi_square == pytest.approx(2 * result.cost, rel=0.05)
    assert found.significant == ()
    row = found.of("air.added_mass_coefficient")
    assert not row.testable
    assert "the parameter cannot be tested: free it in a fit" in row.note
