"""Bouc-Wen model: compared with scipy and a closed form, and invariances."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad, solve_ivp

from giajax import InputError
from giajax.mechanics.hysteresis import BoucWen, BoucWenOscillator, bouc_wen_after, bouc_wen_rate


def operator(**changed):
    values = {"elastic": 0.2, "alpha": 1.3, "beta": 2.0, "gamma": 0.9, "delta": -0.4, "nu": 1.6}
    return BoucWen(**{**values, **changed})


def path(turns, samples):
    pieces = [np.linspace(a, b, samples) for a, b in itertools.pairwise(turns)]
    return np.concatenate([[turns[0]], *(piece[1:] for piece in pieces)])


TURNS = [0.0, 1.5, -1.0, 0.6, -0.2, 1.2]


def test_the_operator_against_scipy():
    it = operator()
    z, expected = np.zeros(1), [0.0]
    arguments = [float(getattr(it, name)) for name in ("alpha", "beta", "gamma", "delta", "nu")]

    def rate(_, z, velocity):
        alpha, beta, gamma, delta, nu = arguments
        return alpha * velocity - beta * (
            gamma * abs(velocity) * abs(z) ** (nu - 1) * z + delta * velocity * abs(z) ** nu
        )

    for a, b in itertools.pairwise(TURNS):
        z = solve_ivp(rate, (0, 1), z, args=(b - a,), rtol=1e-10, atol=1e-12).y[:, -1]
        expected.append(0.2 * b + z[0])
    found = it.history(jnp.asarray(path(TURNS, 101)))[0][::100]
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_it_does_not_depend_on_the_sampling():
    it = operator()
    coarse = it.history(jnp.asarray(path(TURNS, 51)))[0][::50]
    fine = it.history(jnp.asarray(path(TURNS, 401)))[0][::400]
    np.testing.assert_allclose(coarse, fine, atol=1e-6)


def test_the_closed_form_of_the_virgin_curve():
    """For nu = 1 and increasing input, dz/du = alpha - beta (gamma + delta) z."""
    it = operator(nu=1.0, elastic=0.0)
    u = jnp.linspace(0.0, 2.0, 201)
    rate = 2.0 * (0.9 - 0.4)
    expected = 1.3 / rate * (1 - np.exp(-rate * np.asarray(u)))
    np.testing.assert_allclose(it.history(u)[0], expected, atol=1e-9)


def test_only_the_products_count():
    u = jnp.asarray(path(TURNS, 31))
    other = operator(beta=4.0, gamma=0.45, delta=-0.2)
    np.testing.assert_allclose(operator().history(u)[0], other.history(u)[0], rtol=1e-12)


def test_the_rate_at_rest_has_derivatives():
    arguments = (0.5, 0.0, 1.3, 2.0, 0.9, -0.4)
    # For nu = 1, the rate has a corner at z = 0, so any slope between its two sides is valid.
    sides = [-2.0 * (0.9 + sign * 0.4) * 0.5 for sign in (1, -1)]
    for nu, (low, high) in ((1.0, sides), (1.5, (0.0, 0.0)), (2.0, (0.0, 0.0))):
        values = [jnp.asarray(a) for a in (*arguments, nu)]
        slopes = jax.grad(bouc_wen_rate, argnums=tuple(range(7)))(*values)
        assert all(bool(jnp.isfinite(slope)) for slope in slopes)
        assert low - 1e-12 <= float(slopes[1]) <= high + 1e-12


def test_derivatives_against_differences():
    u = jnp.asarray(path(TURNS, 21))
    leaves, tree = jax.tree.flatten(operator())

    @jax.jit
    def value(leaves):
        return jnp.sum(jnp.sin(2 * jax.tree.unflatten(tree, leaves).history(u)[0]))

    gradient = jax.jit(jax.grad(value))(leaves)
    for k, slope in enumerate(gradient):
        ahead, behind = (
            value([*leaves[:k], leaves[k] + sign * 1e-6, *leaves[k + 1 :]]) for sign in (1, -1)
        )
        assert float(slope) == pytest.approx(float(ahead - behind) / 2e-6, rel=1e-6, abs=1e-7)
        assert abs(float(slope)) > 1e-3


def halves(force, times):
    """Return rows of forces at half steps, as the oscillator requires."""
    fractions = np.arange(1, 33) / 32
    before = np.concatenate([[times[0]], times[:-1]])
    at = before[:, None] + fractions[None] * (times - before)[:, None]
    return jnp.asarray(force(at)), jnp.asarray(np.diff(times, prepend=times[0]))


def push(t):
    return 60.0 * np.sin(2 * np.pi * (20 + 30 * t) * t) * np.minimum(8 * t, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("nu", [1.0, 1.7])
def test_the_oscillator_against_scipy(nu):
    it = BoucWenOscillator(nu=nu, beta=1e3 if nu == 1 else 30.0)
    times = np.linspace(0.0, 0.5, 376)
    found = it.motion(*halves(push, times))

    def rate(t, state):
        y, v, z = state
        dz = 5e4 * v - float(it.beta) * (
            0.8 * abs(v) * abs(z) ** (nu - 1) * z - 1.1 * v * abs(z) ** nu
        )
        return [v, (push(t) - 10 * v - 5e4 * y - z) / 2, dz]

    expected = solve_ivp(
        rate,
        (0, 0.5),
        np.zeros(3),
        t_eval=times,
        method="DOP853",
        rtol=1e-10,
        atol=1e-12,
        max_step=1e-4,
    ).y.T
    size = np.max(np.abs(expected), axis=0)
    assert size[0] > 3e-4
    assert np.max(np.abs(found - expected) / size) < 2e-3
    finer = it.refined(0.1).motion(*halves(push, times))
    assert np.max(np.abs(finer - expected) / size) < 2e-4


def test_without_hysteresis_it_is_a_linear_oscillator():
    it = BoucWenOscillator(alpha=0.0)
    times = np.linspace(0.0, 0.4, 301)
    found = it.motion(*halves(lambda t: np.full_like(t, 25.0), times))[:, 0]
    rate, frequency = 10 / 4, np.sqrt(5e4 / 2 - (10 / 4) ** 2)
    shape = np.cos(frequency * times) + rate / frequency * np.sin(frequency * times)
    np.testing.assert_allclose(found, 25 / 5e4 * (1 - np.exp(-rate * times) * shape), atol=1e-9)


def test_it_loses_the_energy_of_its_loops():
    """The work is stored, damped or dissipated in the loop, and no energy is created."""
    it = BoucWenOscillator(damping=0.0)
    times = np.linspace(0.0, 1.0, 8001)
    free = it.motion(*halves(lambda t: np.where(t < 0.05, 80.0, 0.0), times))
    y, v, z = np.asarray(free).T
    energy = v**2 + 2.5e4 * y**2
    lost = np.concatenate([[0.0], np.cumsum((z[1:] + z[:-1]) / 2 * np.diff(y))])
    after = times > 0.06
    drift = np.ptp((energy + lost)[after])
    assert drift < 1e-3 * energy[after][0]
    assert lost[-1] > lost[after][0]


def test_bad_numbers_of_steps_are_refused():
    with pytest.raises(InputError, match="at least 1"):
        BoucWen(substeps=0)
    with pytest.raises(InputError, match="choose 1, 2, 4, 8 or 16"):
        BoucWenOscillator(steps=3)


@pytest.mark.parametrize("nu", [1.0, 1.3, 2.0, 6.0])
@pytest.mark.parametrize("delta", [0.0, 0.5, -0.6])
def test_z_after_a_way_is_that_of_its_equation(nu, delta):
    rng = np.random.default_rng(round(10 * nu))
    starts = rng.uniform(-1, 1, 6)
    ways = rng.choice([-1, 1], 6) * rng.exponential(2.0, 6)

    def equation(_, z, sign):
        return sign - (1 - delta) * abs(z) ** (nu - 1) * z - delta * sign * abs(z) ** nu

    expected = [
        solve_ivp(equation, (0, abs(w)), [z], args=(np.sign(w),), rtol=1e-10, atol=1e-12).y[0, -1]
        for z, w in zip(starts, ways, strict=True)
    ]
    legs = np.stack([0.3 * ways, 0.7 * ways])
    given = [jnp.asarray(each) for each in (legs, starts, nu, delta)]
    dahl = nu == 1 and delta == 0
    assert_allclose(bouc_wen_after(*given), expected, rtol=0, atol=1e-9 if dahl else 5e-5)

    # This includes nu and delta, which are absent from the closed form of the value.
    for index, step in enumerate([1e-6, 1e-6, 1e-5, 1e-6]):

        def by(x, index=index):
            return bouc_wen_after(*given[:index], x, *given[index + 1 :])

        one = jnp.ones_like(given[index])
        far, near = by(given[index] + 2 * step * one), by(given[index] + step * one)
        slope = (far - near) / step
        assert_allclose(jax.jvp(by, (given[index],), (one,))[1], slope, rtol=0, atol=2e-4)


@pytest.mark.parametrize(
    ("by", "source"),
    [("nu", lambda y: -y * np.log(abs(y)) if y else 0.0), ("delta", lambda y: min(2 * y, 0.0))],
    ids=["nu", "delta"],
)
@pytest.mark.parametrize("way", [-3.0, -0.8, -1e-3, 1e-3, 0.8, 3.0, 40.0])
def test_derivatives_of_dahls_model_by_its_shape_are_integrals_along_the_way(by, source, way):
    """d' = -d + source(y) along the motion, with y = 1 - (1 - y0) e^-x, integrated by scipy."""
    starts, size, sign = np.array([-0.99, -0.4, 0.0, 0.3, 0.999]), abs(way), np.sign(way)
    expected = []
    for begin in sign * starts:
        zero = np.log1p(-min(begin, 0.0))  # position at which y is 0
        parts = [0.0, *([zero] if 0 < zero < size else []), size]

        def grown(x, begin=begin):
            return np.exp(x - size) * source(1 - (1 - begin) * np.exp(-x))

        pieces = (quad(grown, a, b, epsabs=1e-13, limit=200) for a, b in itertools.pairwise(parts))
        expected.append(sign * sum(piece[0] for piece in pieces))
    at = {"nu": jnp.ones(()), "delta": jnp.zeros(())}

    def after(value):
        shape = {**at, by: value}
        way_of_all = jnp.full((1, 5), way)
        return bouc_wen_after(way_of_all, jnp.asarray(starts), shape["nu"], shape["delta"])

    slope = jax.jvp(after, (at[by],), (jnp.ones(()),))[1]
    assert_allclose(slope, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("nu", [1.0, 1.4])
def test_second_derivatives_of_z_are_differences_of_first_ones(nu):
    """Derivatives by nu of those by z; for nu = 1, their formula differs from that of the value."""
    ways, z, delta = (
        jnp.asarray([[0.4, -0.7], [-0.3, 0.2]]),
        jnp.asarray([0.2, -0.5]),
        jnp.zeros(()),
    )

    def by_z(nu):
        return jax.jvp(lambda z: bouc_wen_after(ways, z, nu, delta), (z,), (jnp.ones_like(z),))[1]

    one, at, step = jnp.ones(()), jnp.asarray(nu), 1e-5
    slope = (by_z(at + 2 * step) - by_z(at + step)) / step
    assert np.all(np.abs(slope) > 1e-2)
    assert_allclose(jax.jvp(by_z, (at,), (one,))[1], slope, rtol=0, atol=5e-3)
    reverse = jax.jacrev(lambda nu: bouc_wen_after(ways, z, nu, delta))(at)
    forward = jax.jacfwd(lambda nu: bouc_wen_after(ways, z, nu, delta))(at)
    assert_allclose(reverse, forward, rtol=1e-10)


def test_nothing_moves_without_a_way():
    """At the start of a motion, each side has its own slope, and neither is NaN."""
    still, z = jnp.zeros(1), jnp.asarray([0.4])
    nu, delta = jnp.asarray(1.0), jnp.asarray(0.0)
    value, slope = jax.jvp(
        lambda way: bouc_wen_after(way[None], z, nu, delta), (still,), (still + 1,)
    )
    assert_allclose(value, z)
    assert_allclose(slope, 1 - z)
