"""The stand-in for the paper's recordings: its runs, and the physics that generated them."""

import importlib.util
from pathlib import Path

import jax
import numpy as np
import pytest

from giajax import read_run, takeichi_20m
from giajax.apps.paper import compared, concordance
from giajax.mechanics.arm import acceleration
from giajax.schema.parameters import replace
from giajax.simulation import ramps, simulate

FOLDER = Path(__file__).parents[3] / "data" / "paper"
mujoco_air = pytest.importorskip("peers.mujoco_air", reason="mujoco is not installed")


def script():
    spec = importlib.util.spec_from_file_location("regenerate_paper", FOLDER / "regenerate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.quick
def test_every_run_has_its_truth_and_checksum():
    paths = sorted(FOLDER.glob("*.csv"))
    assert [path.stem for path in paths] == [f"stand_in_{seed:02d}" for seed in range(1, 22)]
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 1_000_000
    for path in paths:
        run = read_run(path)
        assert run.definition.sha256 == run.sha256
        assert run.definition.origin.startswith("MuJoCo")
        truth = run.definition.truth
        assert truth["joint_friction_N_m"] == 0.06
        assert truth["seed"] == int(path.stem[-2:])
        assert not run.winds
        assert run.noise("link20_z") == 0.02
        assert np.ptp(run.times) == 25


@pytest.mark.quick
def test_the_true_motion_has_no_full_concordance():
    """Camera noise reduces the concordance of the true motion, as docs/paper.md says."""
    rates = []
    for seed in range(1, 21):
        run = read_run(FOLDER / f"stand_in_{seed:02d}.csv")
        rows = compared(run.times)
        rates.append([])
        for link in (2, 6, 12, 20):
            name = f"link{link:02d}_z"
            noise = 0.02 * np.random.default_rng([seed, *name.encode()]).standard_normal(251)
            seen = run.values[name]
            rates[-1].append(100 * concordance((seen - noise)[rows], seen[rows]))
    median = np.median(rates, axis=0)
    np.testing.assert_allclose(median, [47, 95, 98, 87], atol=0.6)
    assert np.median(np.mean(rates, axis=1)) == pytest.approx(81, abs=0.6)


@pytest.mark.slow
def test_the_beginning_of_a_run_comes_out_of_its_script():
    regenerate = script()
    assert regenerate.differences(7, 1.0) == []
    # The check detects a changed noise.
    regenerate.NOISE = 0.021
    assert len(regenerate.differences(7, 0.1)) > 10


@pytest.mark.slow
def test_added_mass_in_mujoco_is_that_of_giajax():
    """Strip drag, trim weights, added mass and a variable wind, on five links."""
    arm = takeichi_20m(
        5,
        drag="strip",
        trim=True,
        gravity=9.80665,
        parameters={"air.added_mass_coefficient": 1.0, "buoyancy.trim_depth": 0.15},
    )
    still = ramps([0.0, 1.0], np.zeros((2, 5)))
    made = mujoco_air.MujocoInAir(arm, still)
    random = np.random.default_rng(8)
    compiled = jax.jit(acceleration)
    for _ in range(5):
        angles, rates, command = random.uniform(-1, 1, (3, 5))
        wind, wind_rate = random.normal(size=(2, 3))
        ours = compiled(arm, angles, rates, command, wind, wind_rate)
        theirs = made.acceleration(angles, rates, command, wind, wind_rate)
        assert np.abs(theirs).min() > 1e-3
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.long
def test_a_motion_with_friction_in_mujoco_is_that_of_giajax():
    """Dahl friction, drag, added mass and a variable wind, with reversals, on two links."""
    physics = {"air.added_mass_coefficient": 1.0, "joints.damping": 0.1}
    arm = takeichi_20m(2, drag="strip", parameters=physics)
    command = ramps([0.0, 0.2, 0.4, 0.6, 1.0], np.outer([0.0, 0.5, 0.5, 0.0, 0.0], [1.0, -0.5]))
    wind = ramps([0.0, 1.0], [[0.0, 0.0, 0.0], [0.0, 0.5, 0.5]])
    made = mujoco_air.MujocoInAir(arm, command, wind, friction=0.06, friction_stiffness=3.0)
    times = np.linspace(0.0, 1.0, 6)
    theirs = made.trajectory(times, 0.001)
    memory = {"joints.memory.strength": 0.06, "joints.memory.yield_angle": 0.02}
    ours = simulate(replace(arm, memory), command, times, wind=wind, rtol=1e-9, atol=1e-9)
    # The error of equal steps comes from the corners at reversals.
    np.testing.assert_allclose(theirs[:, 0], ours.angles, rtol=0, atol=1e-6)
    plain = simulate(arm, command, times, wind=wind)
    assert np.max(np.abs(theirs[:, 0] - plain.angles)) > 1e-3
