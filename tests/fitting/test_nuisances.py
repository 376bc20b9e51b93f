"""Nuisance parameters of camera and arm: free, with a prior, unless the user disables them."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import ArmModel, InputError, Prior, fit, model_for, read_run, takeichi_20m
from giajax.apps.synthetic import synthesise
from giajax.fitting import set_up
from giajax.models import capabilities
from giajax.recordings import Definition
from giajax.schema.parameters import get, replace
from giajax.tasks._stored import reached_by
from small_arm import LINKS, NOISE, START, TRUTH, small_run

USUAL = ("camera.delay", "camera.clock_rate", "camera.scale", "links.diameter[0]")


def stating(run, uncertainty=None, **sections):
    """Return a run whose sidecar has an [uncertainty] section, or none."""
    contents = {**run.definition.contents(), **sections}
    contents.pop("uncertainty", None)
    if uncertainty is not None:
        contents["uncertainty"] = uncertainty
    return dataclasses.replace(run, definition=Definition.parse(contents))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a run whose sidecar does not declare the camera exact."""
    return stating(small_run(tmp_path_factory.mktemp("run")))


def prepared(run, **keywords):
    return set_up(model_for([run]), run, **keywords)


def test_what_is_usual_is_free_with_a_prior(recorded):
    setup = prepared(recorded, free=["air.drag_coefficient"])
    assert [p.path for p in setup.parameters] == ["air.drag_coefficient", *USUAL]
    assert setup.nuisances == USUAL
    # The prior is half of the frame interval of 0.1 s plus half of 50 ms.
    assert setup.priors["camera.delay"] == Prior(0.075, deviation=0.075)
    assert setup.priors["camera.clock_rate"] == Prior(0.0, deviation=0.001)
    assert setup.priors["camera.scale"] == Prior(1.0, deviation=0.01)
    assert setup.priors["links.diameter[0]"] == Prior(0.3, deviation=0.003)
    assert [tie.path for tie in setup.ties] == ["links.diameter"]
    assert setup.config["nuisances"] == list(USUAL)
    # They are also added to the parameters that are free by default, if some of these are fixed.
    setup = prepared(recorded, fix={"joints.damping": 0.1})
    paths = [p.path for p in setup.parameters]
    assert set(paths) == {*TRUTH, *USUAL} - {"joints.damping"}


def test_what_somebody_says_goes_before(recorded):
    assert prepared(recorded, nuisances=False).nuisances == ()
    assert "nuisances" not in prepared(recorded, nuisances=False).config
    said = prepared(
        recorded,
        free=["air.drag_coefficient", "camera.delay"],
        fix={"camera.scale": 1.0},
        ties={"links.diameter": "links.diameter[0]"},
    )
    assert said.nuisances == ("camera.clock_rate",)
    # A calibration in the sidecar, with its uncertainty.
    stated = stating(recorded, sensors={"camera_scale": 1.02})
    assert "camera.scale" not in prepared(stated).nuisances
    stated = stating(recorded, {"camera.scale": 0.001}, sensors={"camera_scale": 1.02})
    assert prepared(stated).priors["camera.scale"] == Prior(1.02, deviation=0.001)
    exact = stating(recorded, {"defaults": False, "camera.delay": 0.01})
    assert prepared(exact).nuisances == ("camera.delay",)
    known = stating(recorded, {"camera.delay": 0, "links.diameter": 0})
    assert prepared(known).nuisances == ("camera.clock_rate", "camera.scale")


def test_an_array_is_off_as_a_whole_or_element_by_element(recorded):
    masses = [0.04, 0.05, 0.05, 0.06]
    run = stating(
        recorded,
        {"defaults": False, "links": {"mass": 0.002}},  # an unquoted dotted key in TOML
        arm={"links": LINKS, "link_mass_kg": masses, "link_diameter_m": [0.3, 0.3, 0.2, 0.1]},
    )
    setup = prepared(run)
    assert setup.nuisances == ("links.mass[0]",)
    moved = replace(setup.model, {"links.mass[0]": 0.041})
    for tie in setup.ties:
        moved = replace(moved, {tie.path: tie.values(moved)})
    assert_allclose(get(moved, "links.mass"), np.add(masses, 0.001), rtol=1e-12)
    each = stating(run, {"defaults": False, "links.mass": [0.002, 0, 0.001, 0]})
    assert prepared(each).nuisances == ("links.mass[0]", "links.mass[2]")
    # The default is proportional to the value.
    setup = prepared(stating(run))
    moved = replace(setup.model, {"links.diameter[0]": 0.33})
    for tie in setup.ties:
        moved = replace(moved, {tie.path: tie.values(moved)})
    assert_allclose(get(moved, "links.diameter"), [0.33, 0.33, 0.22, 0.11], rtol=1e-12)


@pytest.mark.parametrize(
    ("uncertainty", "sentence"),
    [
        ({"camera.dealy": 0.1}, "camera.delay"),
        ({"links.mass": [0.1, 0.1]}, "gives 2 values for links.mass, which has 4"),
        ({"camera.delay": -0.1}, r"'camera.delay' is not a standard deviation"),
        ({"camera.delay": "late"}, r"'camera.delay' is not a standard deviation"),
        ({"links.mass": 0.1, "links.mass[1]": 0.2}, "give a list for all"),
        (
            {"joints.friction": 0.01},
            "not part of this model: give the value of joints.friction, too",
        ),
        ({"defaults": "no"}, "must be true or false"),
    ],
)
def test_what_is_wrong_is_refused(recorded, uncertainty, sentence):
    with pytest.raises(InputError, match=sentence):
        prepared(stating(recorded, uncertainty))


def test_runs_must_agree(recorded):
    one, other = (stating(recorded, {"camera.delay": size}) for size in (0.01, 0.02))
    other = dataclasses.replace(other, name="other", sha256=None)
    with pytest.raises(InputError, match=r"different values for camera.delay in \[uncertainty\]"):
        set_up(model_for([one]), [one, other])


def test_what_is_left_out_is_expected_where_it_does_nothing(recorded):
    """The prior mean of an omitted effect is zero effect; similar joints scatter independently."""
    setup = prepared(stating(recorded, {"defaults": False, "base_rotation": 0.01}))
    assert setup.priors["base_rotation[1]"] == Prior(0.0, deviation=0.01)
    setup = prepared(stating(recorded, {"defaults": False, "joints.stiffness_factor": [0.1] * 4}))
    assert setup.nuisances == tuple(f"joints.stiffness_factor[{joint}]" for joint in range(4))
    assert setup.priors["joints.stiffness_factor[2]"] == Prior(1.0, deviation=0.1)
    freed = prepared(
        stating(recorded, {"defaults": False}),
        free=["joints.stiffness_factor"],
        priors={"joints.stiffness_factor": Prior(1.0, deviation=0.15)},
    )
    assert len(freed.parameters) == 4


def test_rows_that_are_far_apart_are_no_frames(recorded):
    rows = recorded.times[::10]
    values = {name: row[::10] for name, row in recorded.values.items()}
    slow = dataclasses.replace(recorded, times=20 * rows, values=values)
    assert prepared(slow, free=["joints.damping"]).priors["camera.delay"].value == 0.075
    one = dataclasses.replace(
        recorded, times=rows[:1], values={name: row[:1] for name, row in recorded.values.items()}
    )
    known = capabilities.uncertain(model_for([one]), [one])
    assert "camera.delay" not in known


def test_an_arm_and_its_bench_have_those_of_the_arm():
    runs = [read_run(f"data/synthetic/whole_{name}.csv") for name in ("arm", "joint")]
    runs[0] = stating(runs[0])
    model = model_for(runs)
    assert set(capabilities.uncertain(model, runs)) >= {"links.diameter"}


def test_another_fit_begins_with_a_camera_of_its_own(recorded):
    result = fit(model_for([recorded]), recorded, max_iterations=1, check=False)
    assert set(result.nuisances) == set(USUAL)
    reached = reached_by(result)["values"]
    assert set(reached) == set(result.asked)


def made(late, rate, noise=NOISE / 5):
    """Simulate a run of a delayed camera with a slow clock, which its sidecar does not mention."""
    times = np.linspace(0.0, 8.0, 161)
    ramp = np.clip(times / 0.5, 0, 1) - np.clip((times - 4) / 0.5, 0, 1)
    commands = {"joint01_command": 0.6 * ramp, "joint02_command": -0.5 * ramp}
    arm = ArmModel(replace(takeichi_20m(LINKS), TRUTH))
    true = replace(arm, {"camera.delay": late, "camera.clock_rate": rate})
    channels = ["link02_y", "link04_y", "link04_z"]
    noisy = {"position": noise}
    run = synthesise(true, times, commands, channels, noise=noisy, constants=arm)
    assert run.definition.contents()["uncertainty"] == {"defaults": False}
    return stating(run)


def test_a_late_camera_moves_no_drag_coefficient():
    run = made(0.03, 0.0005)
    model = replace(model_for([run]), START)
    options = {"noise_model": "white", "check": False, "free": list(START)}
    held = fit(model, run, nuisances=False, **options)
    free = fit(model, run, **options)
    path = "air.drag_coefficient"

    def away(result):
        one = result.parameters[path]
        return (one.value - TRUTH[path]) / one.standard_error

    assert abs(away(held)) > 4
    assert abs(away(free)) < 3
    assert free.nuisances == USUAL
    assert free.asked == tuple(START)
    delay = free.parameters["camera.delay"]
    assert abs(delay.value - 0.03) < 3 * delay.standard_error
    # The conditional error, given the nuisance parameters, equals that of a fit that knows them.
    known = {name.partition("[")[0]: free.parameters[name].value for name in USUAL}
    alone = fit(model, run, fix=known, nuisances=False, **options)
    for name in START:
        one = free.parameters[name]
        assert one.noise_error == pytest.approx(alone.parameters[name].standard_error, rel=0.02)
        assert one.nuisance_error**2 + one.noise_error**2 == pytest.approx(one.standard_error**2)
    assert "from nuisance parameters" in free.parameters[path].remark
    shown = list(free.shown)
    assert shown[-4:] == list(USUAL)
    assert "links.diameter" not in shown
    assert free.verdict.status == "adequate"


def test_a_clock_that_no_prior_expects_makes_a_model_doubtful():
    run = made(0.0, 0.02, noise=NOISE)
    model = replace(model_for([run]), START)
    result = fit(model, run, free=list(START), noise_model="white", check=False)
    reason = next(each for each in result.verdict.reasons if each.code == "prior")
    assert "camera.clock_rate" in reason.sentence
    assert result.verdict.status != "adequate"
    command = " ".join(f"--free {path}" for path in (*START, "camera.clock_rate"))
    assert reason.sentence.endswith(command)
    asked = fit(model, run, free=[*START, "camera.clock_rate"], noise_model="white", check=False)
    assert asked.nuisances == ("camera.delay", "camera.scale", "links.diameter[0]")
    assert asked.verdict.status == "adequate"
    rate = asked.parameters["camera.clock_rate"]
    assert abs(rate.value - 0.02) < 3 * rate.standard_error
