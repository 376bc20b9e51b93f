"""A fit that goes well ends soon, and one that goes nowhere ends with the reason."""

import numpy as np
import pytest

from giajax.fitting import fit, set_up
from giajax.fitting._descend import descend
from giajax.fitting._transitions import begin
from giajax.runs import Run
from small_pendulum import Pendulum, start, swing
from toy_model import Decay, run

TIMES = np.linspace(0.0, 4.0, 60)


def recording(values):
    """Values that no exponential makes."""
    return Run.from_arrays(
        TIMES, {"tip_z": values}, noise={"position": 0.01}, definition={"free_motion": True}
    )


def end_of(recorded, **asked):
    """How a fit of the toy model ends, by its loop alone."""
    return descend(begin(set_up(Decay(), recorded, noise_model="white", **asked)), 50, None)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_a_parameter_whose_optimum_is_zero_ends_on_its_bound(loss):
    falling = recording(-0.5 * np.exp(-0.7 * TIMES) + 0.3)
    state = end_of(falling, free=["amplitude", "offset"], loss=loss, fix={"decay": 0.7})
    assert state.ending[::2] == ("converged", "optimum")
    assert state.parameters()["amplitude"] == 0
    assert state.trials <= 30


def test_a_fit_from_far_off_takes_few_steps_with_a_robust_loss_too():
    for loss in ("linear", "huber", "soft_l1"):
        state = end_of(run(), start={"amplitude": 0.2, "decay": 4.0, "offset": 1.0}, loss=loss)
        assert state.ending[::2] == ("converged", "optimum")
        assert state.trials <= 15, loss


def test_data_that_the_model_cannot_make_end_the_fit_with_that_reason():
    walk = np.cumsum(np.random.default_rng(1).normal(scale=0.3, size=60))
    state = end_of(recording(walk), free=["amplitude"], fix={"offset": -20.0, "decay": 0.01})
    assert state.trials <= 20
    # What is free can be at its optimum: then the verdict says that the model is inadequate.
    assert state.ending[2] in ("cannot_fit", "optimum")


def test_a_wall_is_named():
    """Beyond a decay of 8 the model fails, and the data ask for more."""
    fast = recording(2 * np.exp(-30 * TIMES))
    result = fit(Decay(), fast, free=["decay"], start={"decay": 7.9}, fix={"offset": 0.0})
    assert result.status == "not_converged"
    assert result.reason in ("wall", "crawl")
    assert result.iterations <= 30


def test_steps_that_are_used_up_are_a_reason():
    result = fit(Decay(), run(), max_iterations=1, check=False)
    assert (result.status, result.reason) == ("not_converged", "iterations")


@pytest.mark.slow
def test_a_pendulum_with_friction_air_and_no_damping_is_fitted_from_every_side():
    """Three corners of the sixteen; as many iterations with a robust loss."""
    runs = swing()
    for loss in ("linear", "huber"):
        costs = []
        for corner in ((1, 1, 1, 1), (-1, 1, -1, -1), (1, -1, -1, 1)):
            setup = set_up(Pendulum(), runs, start=start(corner), loss=loss, noise_model="white")
            state = descend(begin(setup), 50, None)
            assert state.ending[::2] == ("converged", "optimum")
            assert state.trials <= 25
            assert state.parameters()["damping"] == 0
            costs.append(state.cost)
        np.testing.assert_allclose(costs, costs[0], rtol=1e-5)
