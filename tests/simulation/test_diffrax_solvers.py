"""Any diffrax solver and step-size controller, as objects and as text."""

import json

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import giajax
from giajax import InputError
from giajax.runtime.programs import content
from giajax.runtime.solvers import as_text, from_text

ARM = giajax.takeichi_20m(1)
TIMES = jnp.linspace(0.0, 2.0, 21)
COMMAND = giajax.joint_ramps(1, {1: 0.5}, start=0.1, duration=0.5)
LESS = diffrax.PIDController(1.0, 1.0, pcoeff=0.2, icoeff=0.5)


class Own(diffrax.Midpoint):
    """A user-defined method."""


def move(**options):
    return giajax.simulate(ARM, COMMAND, TIMES, **options)


@pytest.fixture(scope="module")
def exact():
    return move(solver="dopri8", rtol=1e-10, atol=1e-10).angles


@pytest.mark.parametrize(
    ("options", "within"),
    [
        pytest.param({"solver": diffrax.Kvaerno4()}, 2e-5, marks=pytest.mark.slow),
        ({"solver": "Midpoint()"}, 2e-5),
        ({"solver": diffrax.ReversibleHeun()}, 2e-5),
        ({"solver": "springs5", "stepsize_controller": LESS}, 2e-4),
        (
            {"solver": "springs5", "stepsize_controller": diffrax.ClipStepSizeController(LESS)},
            2e-4,
        ),
        ({"solver": diffrax.HalfSolver(diffrax.Euler()), "rtol": 1e-5, "atol": 1e-5}, 3e-3),
        (
            {
                "solver": diffrax.Euler(),
                "stepsize_controller": diffrax.StepTo(jnp.linspace(0.0, 2.0, 2001)),
            },
            1e-3,
        ),
    ],
    ids=["implicit", "text", "reversible", "controller", "clipped", "halves", "steps"],
)
def test_it_moves_the_arm(exact, options, within):
    motion = move(**options)
    assert_allclose(motion.angles, exact, atol=within)
    assert np.max(np.abs(exact)) > 0.1


def test_a_method_of_ones_own_is_what_moves_the_arm():
    own, its_base, other = (move(solver=each) for each in (Own(), "Midpoint()", "dopri8"))
    assert_allclose(own.angles, its_base.angles, rtol=0, atol=0)
    assert_array_equal(own.steps, its_base.steps)
    assert own.steps[0] > 5 * other.steps[0]


def test_an_object_is_the_word():
    """They are equal, so the motion is that of `exact`, too."""
    for named, known in (("dopri5", diffrax.Dopri5()), ("Ralston()", diffrax.Ralston())):
        assert giajax.simulation.solver(named) == giajax.simulation.solver(known) == known


@pytest.mark.parametrize(
    ("mode", "derivative"),
    [
        pytest.param("forward", jax.jacfwd, marks=pytest.mark.slow),
        pytest.param("reverse", jax.jacrev, marks=pytest.mark.long),
    ],
)
def test_derivatives_follow_from_the_mode(mode, derivative):
    def end(damping, solver):
        arm = giajax.replace(ARM, {"joints.damping": damping})
        options = {"rtol": 1e-4, "atol": 1e-4, "derivatives": mode, "max_steps": 1000}
        return giajax.simulate(arm, COMMAND, TIMES[:7], solver=solver, **options).angles[-1]

    at = jnp.asarray(0.3)
    found, known = (derivative(end)(at, each) for each in (diffrax.Ralston(), "tsit5"))
    assert np.all(known)
    assert_allclose(found, known, rtol=1e-2)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"solver": diffrax.Euler()}, "Euler does not estimate the error of a step, .*HalfSolver"),
        ({"solver": diffrax.ShARK()}, "ShARK is for stochastic or split equations"),
        (
            {"solver": diffrax.SemiImplicitEuler()},
            "SemiImplicitEuler is for stochastic or split equations",
        ),
        ({"solver": diffrax.KenCarp4()}, "KenCarp4 is for stochastic or split equations"),
        (
            {"stepsize_controller": diffrax.ConstantStepSize()},
            "ConstantStepSize, which does not choose step sizes",
        ),
        (
            {"stepsize_controller": 0.1},
            "the step size controller is float, which does not choose step sizes",
        ),
        ({"solver": 5}, "there is no solver '5': use one of tsit5, .* or a diffrax solver"),
        ({"solver": "euler"}, "there is no solver 'euler': use one of"),
        (
            {"solver": "Euller()"},
            "the solver Euller is unknown: give a diffrax solver, or register",
        ),
        (
            {"solver": "Tsit5(order=5)"},
            r"Tsit5\(order=5\)' is not a solver: write it as in Python",
        ),
        ({"solver": "open('x').read()"}, "is not a solver: write it as in Python"),
        ({"solver": "HalfSolver(5)"}, r"there is no solver 'HalfSolver\(5\)'"),
        (
            {"solver": diffrax.ImplicitEuler(), "stepsize_controller": diffrax.StepTo(TIMES)},
            r"ImplicitEuler takes the tolerances .* StepTo has no tolerances: give the solver",
        ),
        ({"solver": "PIDController(1, 1)"}, "there is no solver 'PIDController"),
    ],
)
def test_what_does_not_work_is_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        move(**options)


def test_settings_and_a_stepper_refuse_what_a_fit_or_a_motion_would():
    with pytest.raises(InputError, match=r"fit.solver.*the solver Euller is unknown: give"):
        giajax.recordings.fit_settings({"solver": "Euller()"})
    giajax.simulation.Stepper(ARM, 0.1, solver=diffrax.Euler())
    with pytest.raises(InputError, match="Euler does not estimate the error of a step"):
        giajax.simulation.Stepper(ARM, 0.1, solver=diffrax.Euler(), tolerance=1e-6)


@pytest.mark.parametrize(
    "law",
    [pytest.param("memory", marks=pytest.mark.long), pytest.param("stops", marks=pytest.mark.slow)],
)
def test_what_remembers_moves_by_a_method_without_an_error(law):
    strength = 0.1 if law == "memory" else [0.1]
    hysteresis = {f"joints.{law}.strength": strength, f"joints.{law}.yield_angle": 0.05}
    arm = giajax.takeichi_20m(1, parameters=hysteresis)
    ends = np.linspace(TIMES[0], TIMES[-1], 4001)
    fixed = {"solver": diffrax.Euler(), "stepsize_controller": diffrax.StepTo(ends)}
    found = giajax.simulate(arm, COMMAND, TIMES, **fixed).angles
    assert_allclose(found, giajax.simulate(arm, COMMAND, TIMES).angles, atol=5e-3)
    stepper = giajax.simulation.Stepper(arm, 0.01, solver=diffrax.Euler())
    assert np.all(np.isfinite(stepper.advance(stepper.start(), jnp.asarray([0.01])).state))


def test_given_steps_are_those_of_the_times():
    steps = diffrax.StepTo(TIMES[:-1])
    with pytest.raises(InputError, match=r"StepTo covers \[0.0, 1.9.*\] s, but the times cover"):
        move(stepsize_controller=steps)
    with pytest.raises(InputError, match="StepTo contains the step times of a single run: give"):
        giajax.ArmModel(ARM, stepsize_controller=steps)


@pytest.mark.quick
@pytest.mark.parametrize(
    "solver",
    [
        diffrax.Tsit5(),
        diffrax.HalfSolver(diffrax.Heun()),
        diffrax.Kvaerno5(root_finder=diffrax.VeryChord(rtol=1e-8, atol=1e-9)),
        LESS,
    ],
    ids=as_text,
)
def test_text_is_read_as_it_was_written(solver):
    assert from_text(as_text(solver)) == solver


@giajax.register
class Known(Own):
    """A method that files can name."""

    registered_as = "solver"


def test_a_model_goes_through_its_definition_with_its_solver_and_controller():
    for solver in (diffrax.Heun(), Known()):
        model = giajax.ArmModel(ARM, solver=solver, stepsize_controller=LESS)
        stored = json.loads(json.dumps(model.definition()))
        again = giajax.ArmModel.from_definition(stored)
        assert (again.solver, again.stepsize_controller) == (solver, LESS)
        assert content(again) == content(model)
    assert content(again) != content(giajax.ArmModel(ARM, solver="Midpoint()"))
    own = giajax.ArmModel(ARM, solver=Own())
    with pytest.raises(
        InputError, match=r"the solver .*Own\(\).* cannot be stored in a file: give a diffrax"
    ):
        own.definition()


@pytest.mark.slow
def test_a_fit_by_it_is_written_and_read(tmp_path):
    arm = giajax.takeichi_20m(1)
    command = {"joint01_command": np.sin(3 * np.asarray(TIMES))}
    truth = giajax.ArmModel(giajax.replace(arm, {"air.drag_coefficient": 1.5}))
    run = giajax.synthesise(
        truth, np.asarray(TIMES), command, ["link01_z"], noise={"position": 0.001}
    )
    result = giajax.fit(
        giajax.ArmModel(arm),
        run,
        free=["joints.damping", "air.drag_coefficient"],
        start={"air.drag_coefficient": 0.8, "joints.damping": 0.1},
        solver=Known(),
        tolerance=1e-6,
        check=False,
    )
    drag = result.parameters["air.drag_coefficient"]
    assert abs(drag.value - 1.5) < 3.5 * drag.standard_error
    assert result.config["solver"] == result.integration.solver == "Known()"
    assert result.versions[f"{__name__.rpartition('.')[2]}.py"].startswith("sha256 ")
    giajax.write_result(result, run, tmp_path, figures=False)
    again = giajax.load_result(tmp_path)
    assert again.model.solver == Known()
    assert_allclose(again.predict(run)["link01_z"], result.predict(run)["link01_z"], atol=1e-12)
    record = json.loads((tmp_path / "result.json").read_text().replace("Known()", "Unknown()"))
    (tmp_path / "result.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="the solver Unknown is unknown: give a diffrax solver"):
        giajax.load_result(tmp_path)
