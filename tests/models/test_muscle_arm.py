"""An arm with muscles as a model: its files, runs with pressures, and fits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax import InputError, Run
from giajax.cli import main
from giajax.fitting import fit
from giajax.mechanics.arm import acceleration
from giajax.mechanics.joint import Joint
from giajax.models import (
    SCALE,
    ArmModel,
    JointModel,
    MuscleModel,
    arm_from_definition,
    arm_to_definition,
    arm_variants,
    build_model,
    model_for,
    parameter_values,
)
from giajax.recordings import Definition
from giajax.schema.parameters import declared, default_free, get, replace

LINKS = 3
TIMES = np.linspace(0.0, 16.0, 161)
CHANNELS = ("link01_z", "link03_x", "link03_y", "link03_z")
NOISE = 0.005
ARM = {"links": LINKS, "muscles": "pitch", "parameters": {"drive.lag": 0.3}}
TRUTH = {
    "air.drag_coefficient": 1.2,
    "joints.damping": 0.08,
    "joints.yaw_stiffness": 5.0,
    "muscle.effectiveness": 1.0,
    "alpha.offset": 0.03,
    "drive.lag": 0.3,
}


def arm_of(section):
    return arm_from_definition(Definition.parse({"arm": section}))


@pytest.mark.parametrize(
    "section",
    [
        ARM,
        {"links": 2, "muscles": "all", "muscle_law": "empirical", "muscle_blend_deg": 2.0},
        {"links": 4, "muscles": [1, 4], "muscle_correction": "none"},
        {"links": 2, "muscles": [1], "muscle_blend_deg": 1.56},
        {"links": 2, "muscles": [1], "parameters": {"geometry.anchor_y": 0.2, "torque": 0.4}},
        {"links": 2, "muscles": [1], "parameters": {"neck.radius": 0.04, "neck.length": 0.03}},
    ],
)
def test_an_arm_with_muscles_goes_through_its_files(section):
    arm = arm_of(section)
    assert eqx.tree_equal(arm_of(arm_to_definition(arm)), arm)
    model = ArmModel(arm)
    again = build_model("arm", model.definition(), parameter_values(model))
    assert eqx.tree_equal(again.arm, arm)


def test_each_key_changes_the_arm():
    keys = {"muscle_law": "empirical", "muscle_correction": "none", "muscle_blend_deg": 3.0}
    plain = arm_of({"links": 2, "muscles": "pitch"})
    assert plain.pneumatics.joints == (1,)
    assert arm_of({"links": 2, "muscles": "all"}).pneumatics.joints == (1, 2)
    for key, value in keys.items():
        assert not eqx.tree_equal(arm_of({"links": 2, "muscles": "pitch", key: value}), plain)
        with pytest.raises(InputError, match=f"sets {key}, but no joint has muscles"):
            arm_of({"links": 2, key: value})
    with pytest.raises(InputError, match="pressure_limit"):
        arm_of({"links": 2, "muscles": "all", "parameters": {"muscle.pressure_limit": -1.0}})


def test_paths_are_those_of_a_joint_and_of_a_muscle():
    arm = declared(ArmModel(giajax.takeichi_20m(2, muscles="all")))
    others = [declared(JointModel(Joint())), declared(MuscleModel())]
    shared = [path for other in others for path in other if path != "length"]
    assert len(shared) > 20
    for path in shared:
        own = next(other[path].declaration for other in others if path in other)
        assert arm[path].declaration.unit == own.unit
        assert arm[path].declaration.default == own.default


def test_a_fit_frees_what_an_arm_can_tell():
    free = default_free(ArmModel(giajax.takeichi_20m(2, muscles="pitch")))
    assert free == ("joints.yaw_stiffness", "joints.damping", "air.drag_coefficient")
    free = default_free(ArmModel(giajax.takeichi_20m(2, muscles=[2])))
    assert free == ("joints.pitch_stiffness", "joints.damping", "air.drag_coefficient")


@eqx.filter_jit
def commanded(drive, angles):
    """Return the pressures for rows of angles (rad), by one program for all operations."""
    return jax.vmap(drive.commanded)(angles)


def driven_run(measured=None, **changes):
    """Simulate pressures and a yaw command that lead through stable angles on both sides."""
    drive = arm_of(ARM).pneumatics
    knots = np.asarray([0.0, 1.0, 1.5, 6.0, 6.5, 11.0, 16.0])
    angles = [(0, 0), (0, 0), (35, 25), (35, 25), (50, -35), (25, -50), (40, -30)]
    rows = commanded(drive, np.deg2rad([(a, 0.0, b) for a, b in angles]))
    values = {
        f"joint{joint:02d}_pressure_{name}": np.interp(TIMES, knots, rows[:, row, joint - 1])
        for joint in (1, 3)
        for row, name in enumerate(("first", "second"))
    }
    yaw = np.interp(TIMES, [0, 1, 2, 8, 9, 16], [0, 0, 0.4, 0.4, -0.3, -0.3])
    values["joint02_command"] = yaw
    measured = {name: np.zeros_like(TIMES) for name in CHANNELS} if measured is None else measured
    definition = {"arm": ARM}
    return Run.from_arrays(TIMES, {**values, **measured}, definition=definition, **changes)


@pytest.mark.parametrize(
    "off", [pytest.param(1.3, marks=pytest.mark.slow), pytest.param(0.7, marks=pytest.mark.long)]
)
def test_muscles_are_fitted_beside_drag(off):
    blank = driven_run()
    exact = giajax.predict(replace(model_for([blank]), TRUTH), blank, CHANNELS)
    random = np.random.default_rng(0)
    noisy = {name: row + random.normal(scale=NOISE, size=row.shape) for name, row in exact.items()}
    run = driven_run(noisy, noise={"position": NOISE})
    start = {path: off * value for path, value in TRUTH.items()}
    result = fit(model_for([run]), run, free=list(TRUTH), start=start, check=False)
    assert result.status == "converged", result.message
    for path, value in TRUTH.items():
        estimate = result.free[path]
        assert abs(estimate.value - value) < 3 * estimate.standard_error, path
        assert estimate.standard_error < 0.06 * value, path
    # One of the scaled parameters is the strength of the muscles.
    assert any("per unit of mass" in sentence for sentence in result.conditions)


NECK = {"neck.radius": 0.045, "neck.length": 0.03, "joints.damping": 0.08}


def bent_run(measured=None, **changes):
    """Simulate pressures that bend the joint of one link to and fro, until a neck folds."""
    section = {"links": 1, "muscles": "pitch", "parameters": {"neck.radius": 0.05}}
    times = np.linspace(0.0, 12.0, 121)
    angles = np.deg2rad([[0.0], [0.0], [35.0], [35.0], [-45.0], [-45.0], [30.0]])
    rows = commanded(arm_of(section).pneumatics, jnp.asarray(angles))
    values = {
        f"joint01_pressure_{name}": np.interp(times, [0, 1, 2, 5, 6, 9, 12], rows[:, row, 0])
        for row, name in enumerate(("first", "second"))
    }
    values |= {"joint01_angle": np.zeros_like(times)} if measured is None else measured
    return Run.from_arrays(times, values, definition={"arm": section}, **changes)


@pytest.mark.long
def test_a_fit_finds_the_neck_of_an_arm():
    """Other initial guesses of radius, length and damping; muscles must not crush the neck."""
    blank, noise = bent_run(), float(np.deg2rad(0.5))
    exact = giajax.predict(replace(model_for([blank]), NECK), blank, ("joint01_angle",))
    assert np.ptp(np.rad2deg(exact["joint01_angle"])) > 80
    noisy = exact["joint01_angle"] + np.random.default_rng(0).normal(scale=noise, size=121)
    run = bent_run({"joint01_angle": noisy}, noise={"angle": noise})
    start = {"neck.radius": 0.04, "neck.length": 0.02, "joints.damping": 0.12}
    result = fit(model_for([run]), run, free=list(NECK), start=start, check=False)
    assert result.status == "converged", result.message
    for path, value in NECK.items():
        estimate = result.free[path]
        low, high = estimate.interval
        assert low < value < high, path
        assert estimate.standard_error < 0.02 * value, path


def test_the_gas_of_a_neck_moves_what_pressures_hold():
    arm = arm_of(ARM)
    necked = ArmModel(replace(arm, {"neck.radius": 0.04}))
    for path, model in (("neck.length", necked), ("links.pressure", necked)):
        assert model.for_derivatives([path]).steps_for == "derivatives"
    assert ArmModel(arm).for_derivatives(["links.pressure"]).steps_for == "motion"


def test_pressures_set_the_scale_only_by_the_strength_of_the_muscles():
    run = driven_run()
    model = model_for([run])
    (held,) = [c for c in model.conditions(["air.drag_coefficient"], [run]) if "muscle" in c]
    assert "valid for muscle.effectiveness = 1, muscle.diameter = 0.0035 m" in held
    for strength in ("muscle.effectiveness", "muscle.diameter"):
        free = ["air.drag_coefficient", strength]
        (scaled,) = [c for c in model.conditions(free, [run]) if strength in c]
        assert "strength of muscles and damping together leaves the motion" in scaled
        assert "fixed by links.mass" in scaled
    # Scaling these parameters together does not change the motion.
    paths = [path for path in (*SCALE, "muscle.effectiveness") if path in declared(model)]
    heavy = replace(model, {path: 2 * get(model, path) for path in paths}).arm
    angles, rates = jnp.asarray([[0.3, -0.2, 0.5], [0.1, 0.4, -0.2]])
    pressures = commanded(model.arm.pneumatics, angles[None])[0]
    moved = eqx.filter_jit(acceleration)
    one, other = (
        moved(arm, angles, rates, 0 * angles, pressures=pressures) for arm in (model.arm, heavy)
    )
    assert_allclose(one, other, rtol=1e-10)


@pytest.mark.parametrize("law", ["braided", "empirical"])
def test_muscles_of_an_arm_that_floats_are_as_much_stronger_as_it_is_heavier(law):
    arm = arm_of({"links": 2, "muscles": "pitch", "muscle_law": law})
    floating = arm_variants(arm)["arm.trim = true"]
    ratio = float(floating.air.drag_coefficient / arm.air.drag_coefficient)
    assert ratio > 1.1
    own, other = arm.pneumatics.muscle, floating.pneumatics.muscle
    # The force is proportional to one strength parameter; the others are kept.
    at = (jnp.asarray(1e5), jnp.asarray(0.05), jnp.asarray(1.96))
    assert float(other.force(*at)) == pytest.approx(ratio * float(own.force(*at)))


def test_what_the_controller_is_taken_to_know_is_said():
    run = driven_run()
    model = model_for([run])
    free = ["air.drag_coefficient", "alpha.offset"]
    assert not any("the controller" in c for c in model.conditions(free, [run]))
    values = {"joint01_command": np.zeros_like(TIMES), "link01_z": np.zeros_like(TIMES)}
    angled = Run.from_arrays(TIMES, values, definition={"arm": ARM})
    (said,) = [c for c in model.conditions(free, [angled]) if "the controller" in c]
    assert said.startswith("alpha.offset: ")


TOML = """
[arm]
links = 3
muscles = "pitch"

[arm.parameters]
"joints.damping" = 0.5
"""


def test_the_commands_know_muscles(tmp_path, capsys):
    """A run with pressures is generated from angles, simulated again, checked and listed."""
    (tmp_path / "arm.toml").write_text(TOML)
    arm = Definition.load(tmp_path / "arm.toml")
    drive = arm_from_definition(arm).pneumatics
    first, second = np.asarray(commanded(drive, np.deg2rad([[25.0, 0, 0]])))[0, :, 0] / 1e3
    rows = "".join(f"{t:g},{first / 1e3:.12g},{second:.12g},0\n" for t in (0.0, 1.0, 30.0))
    columns = "time_s,joint01_pressure_first_MPa,joint01_pressure_second_kPa,joint02_command_deg\n"
    path, out = tmp_path / "pressures.csv", tmp_path / "run.csv"
    path.write_text(columns + rows)
    made = ["simulate", "--to", str(out), "--arm", str(tmp_path / "arm.toml")]
    made += ["--command", str(path), "--channels", "joint01_angle", "--rate", "1"]
    assert main(made) == 0
    run = giajax.read_run(out)
    assert_allclose(np.rad2deg(run.values["joint01_angle"][-1]), 25.0, atol=0.01)
    assert run.definition.arm.muscles == "pitch"
    capsys.readouterr()
    assert main(["check", "--data", str(out)]) == 0
    assert "joint01_pressure_first" in capsys.readouterr().out
    assert main(["parameters", "--data", str(out)]) == 0
    listed = capsys.readouterr().out
    for name in ("geometry.anchor_x", "alpha.offset", "muscle.effectiveness", "drive.lag"):
        assert name in listed
    assert main(["init", "--data", str(path)]) == 0
    assert '# muscles = "pitch"' in path.with_suffix(".toml").read_text()


@pytest.mark.quick
@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"joint01_pressure_first": 1e4}, "add the column joint01_pressure_second_kPa"),
        ({"joint01_pressure_second": 1e4}, "add the column joint01_pressure_first_kPa"),
        (
            {"joint01_pressure_first": 1e4, "joint01_pressure_second": -1.0},
            "'joint01_pressure_second' is below 0 in sample 0",
        ),
        (
            {
                "joint01_pressure_first": 1e4,
                "joint01_pressure_second": 1e4,
                "joint01_command": 0.0,
            },
            "joint 1 has a command and pressures",
        ),
    ],
)
def test_columns_that_are_no_drive_are_refused(columns, sentence):
    values = {name: np.full(3, value) for name, value in columns.items()}
    with pytest.raises(InputError) as refused:
        Run.from_arrays([0.0, 1.0, 2.0], {**values, "link01_z": np.zeros(3)})
    assert sentence in str(refused.value)


@pytest.mark.quick
@pytest.mark.parametrize(
    "section",
    [
        {"muscles": "pitch"},
        {"muscles": [1, 3]},
        {"links": 2, "muscles": "pitch", "joint_axes": ["pitch", "yaw"]},
    ],
)
def test_pressures_of_a_joint_without_muscles_are_found_in_the_file(section):
    values = {f"joint02_pressure_{name}": np.full(3, 1e4) for name in ("first", "second")}
    values["link01_z"] = np.zeros(3)
    with pytest.raises(InputError, match="joint 2 has no muscles"):
        Run.from_arrays([0.0, 1.0, 2.0], values, definition={"arm": section})
    other = {**section, "muscles": "all"}
    Run.from_arrays([0.0, 1.0, 2.0], values, definition={"arm": other})


def test_pressures_need_muscles():
    values = {f"joint01_pressure_{name}": np.full(3, 1e4) for name in ("first", "second")}
    run = Run.from_arrays([0.0, 1.0, 2.0], {**values, "link01_z": np.zeros(3)})
    with pytest.raises(InputError, match='muscles = "pitch" in'):
        model_for([run]).prepare(run)
