"""Parameters of single runs: the Jacobian in blocks equals the whole one, at the expected cost."""

import dataclasses
import re
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import Run, fit, pendulum
from giajax.fitting import (
    Bijector,
    BlockJacobian,
    Layout,
    Noise,
    Problem,
    build_batches,
    linearise,
    loss_of,
    own_start,
    residual,
)
from giajax.models import AbstractModel, ArmModel
from giajax.schema import InitialSection
from giajax.schema.parameters import parameter
from toy_model import Decay

SIGMA = 0.01


class Inputs(eqx.Module):
    times: Any
    height: Any = parameter(1.0, unit="m", doc="height at the start of this run")
    drift: Any = parameter(0.0, unit="m/s", doc="drift of this run, in two directions")


class OwnHeights(AbstractModel):
    """tip_z = height exp(-decay t) + drift . (t, t^2); height and drift belong to each run."""

    kind: ClassVar[str] = "heights"

    decay: Any = parameter(1.0, unit="1/s", lower=0, upper=9, doc="rate", frozen=False)

    refined = Decay.refined
    definition = Decay.definition

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        return ("height", "drift") if run.definition.section(InitialSection).free else ()

    def prepare(self, run: Run) -> Inputs:
        return Inputs(jnp.asarray(run.times), 1.0, jnp.zeros(2))

    def predict(self, inputs: Inputs, channels: Sequence[str]) -> Any:
        t = inputs.times
        drift = inputs.drift[0] * t + inputs.drift[1] * t**2
        height = inputs.height * jnp.exp(-self.decay * t) + drift
        return dict.fromkeys(channels, height), jnp.asarray(True)


def recording(index, *, free=True, samples=40):
    random = np.random.default_rng(index)
    times = np.linspace(0.0, 2.0, samples)
    height, drift = 1 + 0.5 * random.normal(), 0.1 * random.normal(size=2)
    clean = height * np.exp(-0.7 * times) + drift[0] * times + drift[1] * times**2
    run = Run.from_arrays(
        times,
        {"tip_z": clean + SIGMA * random.normal(size=samples)},
        name=f"run{index}",
        noise={"position": SIGMA},
        definition={"initial": {"free": True}} if free else {"free_motion": True},
    )
    return run, np.array([height, *drift])


def problem_of(runs, loss="linear"):
    model = OwnHeights()
    layout = Layout.of(["decay"], {}, len(runs))
    batches = build_batches(model, runs, Noise.of(runs, "correlated", per_run=False), layout)
    own = own_start(batches, runs, {})
    bijector = Bijector.of(
        (0.0, *(-np.inf for _ in own)), (9.0, *(np.inf for _ in own)), (1.5, *own)
    )
    problem = Problem(model, batches, bijector, ("decay",), loss_of(loss))
    coordinate = jnp.asarray(bijector.inverse(np.array([1.5, *own])))
    return problem, coordinate


def bends(problem, row):
    """Return the curvature ratio of each row, computed for each run separately."""
    priors = np.ones(len(problem.priors.columns))
    if problem.loss.is_linear:
        return np.ones(len(row))
    ratios, first = [], 0
    for batch in problem.batches:
        for weight in np.asarray(batch.weight):
            part = row[first : first + weight.size]
            measured = (weight.ravel() > 0).astype(float)
            # For |r| > 1, Huber's t^2 is 2 |r| - 1.
            r = jnp.where(part**2 > 1, jnp.sign(part) * (part**2 + 1) / 2, part)
            ratios.append(np.asarray(problem.loss.curvature_ratio(r, measured)))
            first += weight.size
    assert np.ptp(np.concatenate(ratios)) > 0.1
    return np.concatenate([*ratios, priors])


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_blocks_are_the_whole_jacobian(loss):
    """Two batches (one run has a fixed state, one is shorter), against jacfwd of the residual."""
    runs = [recording(0)[0], recording(1, free=False)[0], recording(2, samples=25)[0]]
    problem, coordinate = problem_of(runs, loss)
    assert problem.size == 1 + 2 * 3
    row, blocks, factor, projected, _ = eqx.filter_jit(linearise)(coordinate, problem)
    residuals = jax.jit(lambda z: residual(z, problem)[0])
    whole = np.asarray(jax.jit(jax.jacfwd(residuals))(coordinate))
    assert_allclose(row, residuals(coordinate), rtol=1e-13)
    # The triangular factor includes the curvature of the loss. The gradient is that of the cost.
    bent = whole * bends(problem, np.asarray(row))[:, None]
    assert_allclose(factor.T @ factor, bent.T @ bent, rtol=1e-10, atol=1e-8)
    assert_allclose(factor.T @ projected, whole.T @ row, rtol=1e-10, atol=1e-8)

    found = BlockJacobian.of(problem, blocks)
    vector = np.arange(1.0, 8.0)
    weights = np.random.default_rng(0).uniform(size=len(row))
    assert_allclose(found.times(vector), whole @ vector, atol=1e-9)
    assert_allclose(found.transposed_times(weights), whole.T @ weights, atol=1e-9)
    assert_allclose(found.norms(), np.linalg.norm(whole, axis=0), rtol=1e-12)
    small, weighted = found.reduced(weights), whole * weights[:, None]
    assert_allclose(small.T @ small, weighted.T @ weighted, rtol=1e-9, atol=1e-9)
    scaled = found.scaled(vector)
    assert_allclose(scaled.times(np.ones(7)), whole @ vector, atol=1e-9)


def test_no_run_is_differentiated_by_the_parameters_of_another():
    """A block is as wide as the shared parameters and those of one run, for any number of runs."""
    problem, coordinate = problem_of([recording(index)[0] for index in range(12)])
    assert problem.size == 1 + 12 * 3
    _, blocks, *_ = jax.eval_shape(linearise, coordinate, problem)
    assert [block.shape for block in blocks] == [(12, 40, 4), (0,)]
    # No array in the program has the rows of all runs and the columns of all parameters.
    program = str(jax.make_jaxpr(linearise)(coordinate, problem))
    shapes = [
        tuple(map(int, shape.split(","))) for shape in re.findall(r"f64\[([\d,]+)\]", program)
    ]
    assert (12, 40, 4) in shapes
    assert max(np.prod(shape) for shape in shapes) < 12 * 40 * problem.size / 4


def test_what_belongs_to_a_run_is_found_with_an_honest_error():
    runs, truths = zip(*(recording(index) for index in range(30)), strict=True)
    result = fit(OwnHeights(), runs, start={"decay": 1.5})
    assert result.status == "converged"
    shared = result.parameters["decay"]
    assert abs(shared.value - 0.7) < 3 * shared.standard_error
    assert list(result.free) == ["decay"]
    pulls = []
    for record, truth in zip(result.runs, truths, strict=True):
        own = record.parameters
        assert list(own) == ["height", "drift[0]", "drift[1]"]
        pulls += [
            (o.value - t) / o.standard_error for o, t in zip(own.values(), truth, strict=True)
        ]
    assert 0.75 < np.std(pulls) < 1.25
    assert result.gradient_check.relative_difference < 1e-6


def test_a_run_alone_may_be_all_that_is_fitted():
    run, truth = recording(3)
    model = dataclasses.replace(OwnHeights(), decay=0.7)
    result = fit(model, run, free=[])
    assert result.status == "converged"
    own = result.runs[0].parameters.values()
    for estimate, value in zip(own, truth, strict=True):
        assert abs(estimate.value - value) < 3.5 * estimate.standard_error


@pytest.mark.slow
def test_the_first_state_of_a_pendulum_is_found():
    """The noisy angles give an initial guess from the first row, without rates."""
    arm = pendulum(2, parameters={"joints.damping": 0.05})
    times = np.linspace(0.0, 2.0, 81)
    angle, rate = np.deg2rad([40.0, -25.0]), np.deg2rad([30.0, 80.0])
    about = {"arm": {"preset": "pendulum", "links": 2}}
    free = {**about, "initial": {"first_row": True, "free": True}}
    blank = {f"joint0{joint}_angle": np.zeros(81) for joint in (1, 2)}
    state = {**about, "initial": {"angle_deg": [40.0, -25.0], "rate_deg_per_s": [30.0, 80.0]}}
    plan = Run.from_arrays(times, blank, definition=state)
    model = ArmModel(arm)
    clean, _ = model.predict(model.prepare(plan), tuple(blank))
    random = np.random.default_rng(4)
    noisy = {name: value + 0.02 * random.normal(size=81) for name, value in clean.items()}
    run = Run.from_arrays(times, noisy, noise={"angle": 0.02}, definition=free)
    damping = [f"joints.damping[{joint}]" for joint in (0, 1)]
    start = dataclasses.replace(arm.joints, damping=jnp.full(2, 0.02))
    result = fit(ArmModel(dataclasses.replace(arm, joints=start)), run, free=damping)
    assert result.status == "converged"
    own = result.runs[0].parameters
    truth = dict(
        zip(
            ("initial.angle[0]", "initial.angle[1]", "initial.rate[0]", "initial.rate[1]"),
            (*angle, *rate),
            strict=True,
        )
    )
    assert set(own) == set(truth)
    for path, value in truth.items():
        assert 0 < own[path].standard_error < 0.05
        assert abs(own[path].value - value) < 3.5 * own[path].standard_error
