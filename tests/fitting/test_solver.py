"""The trust-region solver with optimistix's interface."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize

from giajax.fitting import Marquardt, boxed_step


def rosenbrock(y, args):
    return jnp.stack([10 * (y[1] - y[0] ** 2), 1 - y[0]]), None


def test_it_solves_through_optimistix():
    start = jnp.array([-1.2, 1.0])
    solution = optx.least_squares(rosenbrock, Marquardt(), start, max_steps=200, has_aux=True)
    np.testing.assert_allclose(solution.value, [1, 1], atol=1e-7)


def test_a_linear_problem_takes_its_optimum_from_numpy():
    rng = np.random.default_rng(1)
    matrix, vector = rng.normal(size=(30, 3)), rng.normal(size=30)

    def fn(y, args):
        return args[0] @ y - args[1], None

    args = (jnp.asarray(matrix), jnp.asarray(vector))
    solution = optx.least_squares(
        fn, Marquardt(distance=1e-8), jnp.zeros(3), args=args, has_aux=True
    )
    expected, *_ = np.linalg.lstsq(matrix, vector, rcond=None)
    np.testing.assert_allclose(solution.value, expected, rtol=1e-6)


def test_scaling_a_parameter_changes_nothing():
    """Marquardt's scaling makes the iterates covariant, unlike optimistix's own solver."""
    times = jnp.linspace(0.0, 3.0, 40)
    observed = 2 * jnp.exp(-0.5 * times) + 0.01 * jnp.sin(50 * times)

    def steps(unit):
        def fn(y, args):
            return y[0] * jnp.exp(-y[1] / unit * times) - observed, None

        solution = optx.least_squares(fn, Marquardt(), jnp.array([1.0, 1.5 * unit]), has_aux=True)
        return int(solution.stats["evaluations"]), solution.value[1] / unit

    (few, value), (same, scaled) = steps(1.0), steps(1e4)
    assert few == same <= 15
    np.testing.assert_allclose(value, scaled, rtol=1e-8)


def drive(fn, start, solver, steps=40):
    """Step as the host loop does, and return the history of (point, cost, accepted)."""
    shape, aux = jax.eval_shape(fn, start, None)
    state = solver.init(fn, start, None, {}, shape, aux, frozenset())
    point, history = start, []

    @jax.jit
    def once(point, state):
        point, state, _ = solver.step(fn, point, None, {}, state, frozenset())
        return point, state, solver.terminate(fn, point, None, {}, state, frozenset())[0]

    for _ in range(steps):
        point, state, done = once(point, state)
        history.append((np.asarray(point), float(state.cost), bool(state.accepted)))
        if done:
            break
    return history


def test_the_cost_never_rises():
    """In a difficult valley and a small trust region, bad steps must not be accepted."""

    def fn(y, args):
        return jnp.stack([30 * (y[1] - jnp.sin(4 * y[0])), y[0] - 2.5]), None

    history = drive(fn, jnp.array([-2.0, 1.5]), Marquardt(largest_step=0.3), steps=200)
    costs = [cost for _, cost, _ in history]
    assert all(after <= before for before, after in itertools.pairwise(costs))
    assert any(not accepted for *_, accepted in history)


def test_a_step_off_a_bent_valley_is_gone_on_from():
    """On a circle, the tangent step is rejected, and a correction returns to the valley floor."""

    def fn(y, args):
        return jnp.stack([10 * (jnp.hypot(*y) - 1), jnp.arctan2(y[1], y[0]) - 0.8]), None

    history = drive(fn, jnp.array([1.0, 0.0]), Marquardt())
    np.testing.assert_allclose(history[-1][0], [np.cos(0.8), np.sin(0.8)], atol=1e-6)
    # Nineteen iterations if steps are only shortened.
    assert len(history) <= 10
    refused = [place for place, (*_, accepted) in enumerate(history) if not accepted]
    after = history[refused[0] + 1]
    assert after[2]
    assert after[1] < history[refused[0]][1] / 2


def test_no_coordinate_leaves_the_box_of_a_step():
    history = drive(rosenbrock, jnp.array([-1.2, 1.0]), Marquardt(largest_step=0.1))
    points = np.stack([point for point, *_ in history])
    assert np.abs(np.diff(points, axis=0)).max() <= 0.1 + 1e-12


@pytest.mark.parametrize("broken", [jnp.nan, jnp.inf])
def test_a_trial_that_fails_is_a_rejected_step(broken):
    """A full step from here would lead to a point where the function is not finite."""

    def fn(y, args):
        value = jnp.where(y[0] > 1.5, broken, jnp.exp(y[0]) - 3)
        return jnp.stack([value]), None

    history = drive(fn, jnp.array([-1.0]), Marquardt())
    assert any(not accepted for *_, accepted in history)
    np.testing.assert_allclose(history[-1][0], [np.log(3)], atol=1e-6)


def test_a_wall_is_not_an_optimum():
    """If every trial towards the optimum fails, the solver must not report convergence."""

    def fn(y, args):
        return jnp.stack([jnp.where(y[0] > 1.0, jnp.nan, y[0] - 3.0), 0.1 * jnp.cos(y[0])]), None

    start = jnp.array([1.0])
    solution = optx.least_squares(fn, Marquardt(), start, has_aux=True, max_steps=100, throw=False)
    assert solution.result == optx.RESULTS.nonlinear_divergence


def test_what_is_not_active_stays():
    def fn(y, args):
        return jnp.stack([y[0] - 3, y[1] - 4, y[0] + y[1]]), None

    start = jnp.array([0.5, 0.25])
    options = {"active": jnp.array([True, False])}
    solver = Marquardt(distance=1e-9)
    solution = optx.least_squares(fn, solver, start, options=options, has_aux=True)
    assert solution.value[1] == 0.25
    np.testing.assert_allclose(solution.value[0], (3 - 0.25) / 2, atol=1e-6)


def test_an_optimum_on_a_bound_is_reached_and_left_again():
    """Of two correlated parameters, the first stays at its bound for a while and then leaves it."""
    start = jnp.array([0.3, 2.0])
    options = {"lower": jnp.zeros(2), "upper": jnp.full(2, jnp.inf)}

    def fn(y, args):
        return jnp.stack([y[0] + 0.9 * y[1] - args[0], y[0] - 0.5 * y[1] - args[1]]), None

    for target in (jnp.array([1.0, -2.0]), jnp.array([-3.0, 2.0]), jnp.array([2.0, 1.0])):
        solution = optx.least_squares(
            fn, Marquardt(distance=1e-9), start, args=target, options=options, has_aux=True
        )
        matrix = np.array([[1, 0.9], [1, -0.5]])
        expected = scipy.optimize.lsq_linear(matrix, np.asarray(target), (0, np.inf)).x
        np.testing.assert_allclose(solution.value, expected, atol=1e-6)
        assert np.all(np.asarray(solution.value) >= 0)


def test_a_step_in_a_box_is_that_of_a_quadratic_program():
    rng = np.random.default_rng(3)
    solve = jax.jit(boxed_step)
    for _ in range(20):
        matrix, vector = rng.normal(size=(6, 6)), rng.normal(size=6) * 3
        q, r = np.linalg.qr(matrix)
        sides = -jnp.ones(6), jnp.full(6, 0.4)
        ours = solve(
            jnp.asarray(r), jnp.asarray(q.T @ vector), jnp.full(6, 0.1), sides, jnp.ones(6, bool)
        )
        whole = np.concatenate([matrix, 0.1 * np.eye(6)])
        goal = np.concatenate([-vector, np.zeros(6)])
        best = scipy.optimize.lsq_linear(whole, goal, (-1, 0.4), method="bvls")
        reached = np.sum((whole @ np.asarray(ours) - goal) ** 2) / 2
        assert reached <= best.cost * (1 + 1e-9)
