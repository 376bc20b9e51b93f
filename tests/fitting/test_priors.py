"""Priors as rows of the residual, compared with closed forms and scipy."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from test_blocks import OwnHeights, bends, recording

from giajax import InputError, Prior, fit, model_for
from giajax.fitting import BlockJacobian, begin, linearise, residual, set_up
from small_arm import START, TRUTH, small_run
from toy_model import Decay, run

DECAY = 0.7
SIGMA = 0.01


def linear(noise):
    """Return design, data and run of a model that is linear in amplitude and offset."""
    recorded = run(sigma=SIGMA)
    design = np.stack([np.exp(-DECAY * recorded.times), np.ones(60)], axis=1)
    stated = dataclasses.replace(
        recorded,
        definition=recorded.definition.model_copy(
            update={"noise": recorded.definition.noise.model_copy(update={"position_m": noise})}
        ),
    )
    return design / noise, recorded.observations["tip_z"] / noise, stated


@pytest.mark.parametrize("noise", [2 * SIGMA, SIGMA / 3])
def test_a_normal_prior_is_a_ridge(noise):
    """Compare estimate and covariance; excess residuals do not scale the part of the prior."""
    design, data, recorded = linear(noise)
    centre, spread = np.array([1.9, 0.0]), np.array([0.02, np.inf])
    precision = np.diag(spread**-2)
    inverse = np.linalg.inv(design.T @ design + precision)
    expected = inverse @ (design.T @ data + precision @ centre)
    left = np.append(design @ expected - data, (expected[0] - 1.9) / 0.02)
    # The residual of the prior does not change the noise, and prior knowledge uses no freedom.
    trace = np.trace(inverse @ design.T @ design)
    reduced = np.sum(left[:-1] ** 2) / (60 - trace)
    scale = max(reduced, 1.0)
    covariance = inverse @ (scale * design.T @ design + precision) @ inverse

    result = fit(
        Decay(decay=DECAY),
        recorded,
        free=["amplitude", "offset"],
        start={"amplitude": 1.0, "offset": 0.0},
        priors={"amplitude": Prior(1.9, deviation=0.02)},
        noise_model="white",
    )
    assert result.status == "converged"
    estimates = [result.parameters[path] for path in ("amplitude", "offset")]
    # The fit stops within a hundredth of a standard error.
    errors = np.sqrt(np.diag(covariance))
    assert np.all(np.abs([e.value for e in estimates] - expected) < 0.01 * errors)
    assert_allclose([e.standard_error for e in estimates], errors, rtol=1e-4)
    # The remaining distance to the optimum affects the data part to first order.
    assert result.reduced_chi_square == pytest.approx(reduced, rel=1e-3)
    assert result.cost == pytest.approx(np.sum(left**2) / 2, rel=1e-4)
    assert estimates[0].prior_share == pytest.approx(inverse[0, 0] / 0.02**2, rel=1e-4)
    assert estimates[1].prior_share is None
    assert result.gradient_check.relative_difference < 1e-6
    assert (scale > 1) == (noise < SIGMA)


@pytest.mark.parametrize(("deviation", "offset"), [(1e-3, 0.3), (10.0, 0.3), (0.01, 0.5)])
def test_the_noise_is_that_of_the_cells_whatever_a_prior_says(deviation, offset):
    """The case has 12 cells and two parameters, and includes priors that are far off."""
    recorded = run(sigma=SIGMA, samples=12, state_noise=False, seed=3)
    design = np.stack([np.exp(-DECAY * recorded.times), np.ones(12)], axis=1)
    squares = np.linalg.lstsq(design, recorded.observations["tip_z"], rcond=None)[1]
    result = fit(
        Decay(decay=DECAY),
        recorded,
        free=["amplitude", "offset"],
        start={"amplitude": 1.0, "offset": 0.0},
        priors={"offset": Prior(offset, deviation=deviation)},
        noise_model="white",
        check=False,
    )
    expected = np.sqrt(squares[0] / (12 - 2))
    assert result.runs[0].channels["tip_z"].noise == pytest.approx(expected, rel=2e-3)


def test_a_log_normal_prior_is_normal_in_the_logarithm():
    design, data, recorded = linear(4 * SIGMA)

    def rows(values):
        return np.append(design @ values - data, np.log(values[0] / 1.9) / np.log(1.01))

    reference = least_squares(rows, [1.0, 0.1], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    covariance = np.linalg.inv(reference.jac.T @ reference.jac)
    result = fit(
        Decay(decay=DECAY),
        recorded,
        free=["amplitude", "offset"],
        start={"amplitude": 1.0},
        priors={"amplitude": {"value": 1.9, "factor": 1.01}},
        noise_model="white",
    )
    estimates = [result.parameters[path] for path in ("amplitude", "offset")]
    assert_allclose([e.value for e in estimates], reference.x, atol=1e-4)
    errors = np.sqrt(np.diag(covariance))
    assert_allclose([e.standard_error for e in estimates], errors, rtol=1e-3)
    assert 1.91 < estimates[0].value < 1.99  # between the prior and the data


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_what_no_channel_responds_to_is_as_known_as_before(loss):
    """This holds whether the noise is half of the stated one, or three times as large."""
    for noise in (2 * SIGMA, SIGMA / 3):
        result = fit(
            Decay(),
            linear(noise)[2],
            free=["amplitude", "decay", "offset", "idle"],
            start={"idle": 1.0},
            priors={"idle": Prior(3.0, deviation=0.5)},
            loss=loss,
        )
        idle = result.parameters["idle"]
        assert idle.value == pytest.approx(3.0, abs=0.005)
        assert idle.standard_error == pytest.approx(0.5, rel=1e-3)
        assert idle.prior_share == pytest.approx(1.0, rel=1e-3)
        assert idle.remark.startswith("its value comes mainly from its prior (100%")
        assert result.parameters["amplitude"].remark == ""


def test_a_prior_breaks_what_only_a_product_determines():
    """Without a prior, neither has an error; with it, both have that of the prior."""
    free = ["amplitude", "decay", "offset", "twin"]
    loose = fit(Decay(), run(), free=free, start={"twin": 1.3})
    assert loose.parameters["twin"].standard_error is None
    result = fit(
        Decay(), run(), free=free, start={"twin": 1.3}, priors={"twin": Prior(1.1, factor=1.2)}
    )
    twin, amplitude = (result.parameters[path] for path in ("twin", "amplitude"))
    assert twin.value == pytest.approx(1.1, rel=2e-3)
    assert twin.standard_error == pytest.approx(1.1 * np.log(1.2), rel=2e-3)
    assert amplitude.value * twin.value == pytest.approx(2.0, rel=0.02)
    assert amplitude.standard_error / amplitude.value == pytest.approx(np.log(1.2), rel=1e-2)


def test_a_fit_starts_where_its_prior_is_unless_told_otherwise():
    def start(**options):
        setup = set_up(Decay(), run(), priors={"decay": Prior(0.5, deviation=0.1)}, **options)
        return float(setup.model.decay)

    assert start() == 0.5
    assert start(start={"decay": 1.5}) == 1.5


def test_the_states_of_single_runs_may_have_priors():
    """A prior may be for one element of a path or for a whole path, in each run."""
    runs = [recording(index)[0] for index in (0, 1)]
    free = fit(OwnHeights(), runs, start={"decay": 1.5})
    priors = {"height": Prior(1.0, deviation=1e-4), "drift[1]": Prior(0.0, deviation=1e-4)}
    held = fit(OwnHeights(), runs, start={"decay": 1.5}, priors=priors)
    for before, after in zip(free.runs, held.runs, strict=True):
        for path in ("height", "drift[1]"):
            assert before.parameters[path].standard_error > 1e-3
            assert after.parameters[path].standard_error == pytest.approx(1e-4, rel=0.02)
        assert after.parameters["height"].remark.startswith("its value comes mainly from its prior")
        assert after.parameters["drift[0]"].standard_error > 1e-3


@pytest.mark.slow
def test_rows_of_priors_are_rows_of_the_whole_jacobian():
    """With groups of runs and a tie: blocks, against jacfwd of the residual."""
    runs = [run(seed=seed, samples=20 + seed) for seed in range(3)]
    setup = set_up(
        Decay(),
        runs,
        free=["decay", "amplitude"],
        start={"decay": 1.2},
        groups={"amplitude": [["run0", "run2"], ["run1"]]},
        per_run=["offset"],
        ties={"twin": "2 * offset / exp(0.1 * decay)"},
        priors={"decay": Prior(0.8, factor=1.3), "offset": Prior(0.2, deviation=0.05)},
        loss="huber",
    )
    state = begin(setup)
    problem = state.problem
    assert problem.size == 1 + 2 + 3
    coordinate = state.coordinate + 0.1 * jnp.arange(6.0)
    row, blocks, factor, projected, _ = eqx.filter_jit(linearise)(coordinate, problem)
    residuals = jax.jit(lambda z: residual(z, problem)[0])
    whole = np.asarray(jax.jit(jax.jacfwd(residuals))(coordinate))
    assert_allclose(row, residuals(coordinate), rtol=1e-13)
    bent = whole * bends(problem, np.asarray(row))[:, None]
    assert_allclose(factor.T @ factor, bent.T @ bent, rtol=1e-10, atol=1e-8)
    assert_allclose(factor.T @ projected, whole.T @ row, rtol=1e-10, atol=1e-8)
    blocked = BlockJacobian.of(problem, blocks)
    assert_allclose(blocked.times(np.arange(1.0, 7.0)), whole @ np.arange(1.0, 7.0), atol=1e-9)
    weights = np.random.default_rng(0).uniform(size=len(row))
    assert_allclose(blocked.transposed_times(weights), whole.T @ weights, atol=1e-9)
    assert np.count_nonzero(whole[-4:]) == 4


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"factor": 0.9}, "the factor of the prior is 0.9: give a number above 1"),
        ({}, "must have a deviation, or a factor"),
        ({"deviation": 1.0, "factor": 2.0}, "must have a deviation, or a factor"),
    ],
)
def test_what_is_no_prior_is_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        Prior(1.0, **options)
    with pytest.raises(InputError, match=rf"\[fit.priors.decay\] .*{sentence}"):
        fit(Decay(), run(), priors={"decay": {"value": 1.0, **options}})
    with pytest.raises(InputError, match="the deviation of the prior is 0: give a positive number"):
        Prior(1.0, deviation=0.0)


@pytest.mark.parametrize(
    ("priors", "sentence"),
    [
        ({"idle": Prior(1.0, deviation=1.0)}, "'idle' has a prior but is not free"),
        ({"decay": Prior(10.0, deviation=1.0)}, "'decay' has the value 10, which is outside"),
        ({"offset": Prior(1.0, factor=2.0)}, "'offset' may be negative"),
        ({"decoy": Prior(1.0, factor=2.0)}, "no parameter 'decoy': did you mean 'decay'?"),
        ({"decay": 3.0}, "priors.decay. must be a table of keys"),
    ],
)
def test_a_prior_that_cannot_be_is_refused(priors, sentence):
    with pytest.raises(InputError, match=sentence):
        fit(Decay(), run(), priors=priors)


@pytest.mark.slow
def test_a_prior_of_the_mass_sets_the_scale_that_motion_leaves_open(tmp_path):
    """For a weightless arm, only ratios to its mass are identifiable, but with a prior all are."""
    recorded = small_run(tmp_path)
    model = model_for([recorded])
    links = model.arm.links
    options = {
        "check": False,
        "free": ["links.mass", *START],
        "start": START,
        "ties": {
            "links.mass": "links.mass[0]",
            **{
                f"links.{name}": f"{float(getattr(links, name)[0] / links.mass[0])} * links.mass"
                for name in ("inertia_transverse", "inertia_axial")
            },
        },
    }
    loose = fit(model, recorded, **options)
    assert [estimate.standard_error for estimate in loose.free.values()] == [None] * 5
    result = fit(model, recorded, priors={"links.mass[0]": Prior(0.05, factor=1.2)}, **options)
    assert result.status == "converged"
    for path, truth in {**TRUTH, "links.mass[0]": 0.047}.items():
        estimate = result.parameters[path]
        known = np.log(1.2) * estimate.value
        assert 0.99 * known < estimate.standard_error < 3 * known
        assert abs(estimate.value - truth) < 3 * estimate.standard_error
    mass = result.parameters["links.mass[0]"]
    assert mass.value == pytest.approx(0.05, rel=1e-2)
    assert mass.prior_share == pytest.approx(1.0, rel=1e-3)
    inertia = result.derived["links.inertia_transverse"]
    assert inertia.standard_error / inertia.value == pytest.approx(np.log(1.2), rel=1e-2)
