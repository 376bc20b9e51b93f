"""Bending of inflated tubes: compared with numerically integrated sections and measurements."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from giajax.mechanics.wrinkling import (
    Neck,
    Tube,
    curvature,
    energy,
    moment,
    neck_energy,
    neck_moment,
    stiff_share,
)

RADIUS, FILM = 0.08, 1e4
TUBE = Tube(jnp.asarray(RADIUS), jnp.asarray(FILM))
FORCE = 69e3 * np.pi * RADIUS**2
FIRST = FORCE / (2 * np.pi * FILM * RADIUS**2)
"""Curvature at which the first wrinkle appears."""

NECK = Neck(radius=0.05, length=0.06)
SHUT = 0.06 / (2 * 0.05)
"""Angle at which the compressed side of the neck has no volume."""
WRINKLED = 0.06 * (1e3 * np.pi * 0.05**2 - 3.0) / (2 * np.pi * FILM * 0.05**2)
"""Angle at which the neck wrinkles under 3 N."""


def bent(k, force=FORCE, tube=TUBE):
    return moment(tube, jnp.asarray(k, float), jnp.asarray(force, float))


def resisted(angle, compression=3.0, neck=NECK):
    return neck_moment(neck, jnp.asarray(angle, float), jnp.asarray(compression, float))


def stored(angle, compression=3.0):
    return neck_energy(NECK, jnp.asarray(angle, float), jnp.asarray(compression, float))


def test_the_first_wrinkle_of_a_known_tube():
    """160 mm, 69 kPa: p pi r^3 / 2, in N m."""
    assert float(bent(FIRST)) == pytest.approx(55.49, abs=0.005)
    within, beyond = (float(bent(FIRST * x)) / FIRST / x for x in (0.999, 1.01))
    assert within == pytest.approx(FILM * np.pi * RADIUS**3, rel=1e-12)
    assert beyond < within * (1 - 1e-5)


@pytest.mark.parametrize("times", [0.4, 1.0001, 1.5, 10.0, 1e3])
def test_a_section_is_that_which_is_integrated_point_by_point(times):
    k = times * FIRST
    around = np.linspace(0, np.pi, 200_001)

    def borne(strain):
        """Force per metre of film, at angles from the stretched side on."""
        return FILM * np.maximum(strain + k * RADIUS * np.cos(around), 0)

    def total(strain):
        return 2 * RADIUS * np.trapezoid(borne(strain), around)

    strain = brentq(lambda e: total(e) - FORCE, -k * RADIUS, FORCE, xtol=1e-15, rtol=1e-14)
    expected = 2 * RADIUS**2 * np.trapezoid(borne(strain) * np.cos(around), around)
    assert float(bent(k)) == pytest.approx(expected, rel=1e-6)


def test_a_tube_that_collapses_bears_n_r():
    """1 - M / (N r) is d^2 / 10 for a small tight half-angle d, with d^3 = 3 N / 2 E t r^2 k."""
    k = FIRST * np.array([1e4, 1e5, 1e6])
    half = np.cbrt(3 * FORCE / (2 * FILM * RADIUS**2 * k))
    assert_allclose(1 - bent(k) / (FORCE * RADIUS), half**2 / 10, rtol=2e-3)
    assert np.all(
        np.isinf(curvature(TUBE, jnp.asarray([1.01, 1.5]) * FORCE * RADIUS, jnp.asarray(FORCE)))
    )
    # Without a tensile force, film carries no load.
    assert float(bent(1.0, 0.0)) == float(bent(1.0, -1.0)) == 0


def test_the_curvature_is_the_inverse_of_the_moment():
    k = FIRST * np.array([-40.0, -0.5, 0.0, 0.99, 1.01, 3.0, 300.0])
    assert_allclose(curvature(TUBE, bent(k), jnp.asarray(FORCE)), k, rtol=1e-10)
    assert_allclose(stiff_share(jnp.asarray([0.0, 0.5, 1.0, 3.0])), [1, 1, 0, 0])


def test_energy_of_a_tube_is_the_integral_of_its_moment():
    ends = FIRST * np.array([0.5, 1.5, 30.0])
    for end in ends:
        work = quad(lambda k: float(bent(k)), 0, end, points=[FIRST], epsrel=1e-11, limit=200)[0]
        assert float(energy(TUBE, jnp.asarray(end), jnp.asarray(FORCE))) == pytest.approx(
            work, 1e-9
        )


def test_a_closed_loop_of_bend_and_compression_conserves_energy():
    """Work of moment and compression around a rectangle that crosses both limits of the neck."""
    near, far, little, much = 0.5 * WRINKLED, 1.2 * SHUT, 2.0, 4.0
    shortening = jax.jit(jax.grad(stored, argnums=1))
    moment_at = jax.jit(resisted)
    wrinkles = [WRINKLED * x for x in (0.5, 1, 1.5, 3)]

    def along(function, start, end, corners=()):
        # Split at corners, so that no interval of the rule contains one.
        ends = [start, *sorted(x for x in corners if start < x < end), end]
        pieces = itertools.pairwise(ends)
        return sum(
            quad(function, a, b, epsabs=1e-13, epsrel=1e-12, limit=400)[0] for a, b in pieces
        )

    def bending(compression):
        first = 0.06 * (1e3 * np.pi * 0.05**2 - compression) / (2 * np.pi * FILM * 0.05**2)
        corners = [first, SHUT, *wrinkles]
        return along(lambda a: float(moment_at(a, compression)), near, far, corners)

    def pressing(angle):
        limit = 1e3 * np.pi * 0.05**2 - 2 * np.pi * FILM * 0.05**2 * angle / 0.06
        return along(lambda f: float(shortening(angle, f)), little, much, [limit])

    out, back = bending(little), bending(much)
    loop = out + pressing(far) - back - pressing(near)
    assert out - back > 0.02  # J; the balanced amount is not zero
    assert abs(loop) < 1e-8 * out


@pytest.mark.parametrize("angle", [0.0, 0.7 * WRINKLED, 4 * WRINKLED, 0.3, 0.99 * SHUT, 1.4 * SHUT])
def test_slopes_of_a_neck_by_everything(angle):
    """Compiled forward- and reverse-mode derivatives, compared with central differences."""
    given = [0.05, FILM, 0.06, 1e3, angle, 3.0]

    def both(x):
        neck = Neck(x[0], x[2], x[1], x[3])
        return jnp.stack([neck_moment(neck, x[4], x[5]), neck_energy(neck, x[4], x[5])])

    at = jnp.asarray(given)
    forward, backward = jax.jit(jax.jacfwd(both))(at), jax.jit(jax.jacrev(both))(at)
    steps = np.diag([1e-7, 1e-2, 1e-7, 1e-3, 1e-8, 1e-5])
    differences = [(both(at + step) - both(at - step)) / (2 * step.sum()) for step in steps]
    assert_allclose(forward, np.transpose(differences), rtol=1e-5, atol=2e-7)
    assert_allclose(backward, forward, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("limit", [0.0, WRINKLED, SHUT])
@pytest.mark.parametrize("side", [-1, 1])
def test_slopes_are_continuous_through_each_limit(limit, side):
    slope = jax.jit(jax.grad(resisted))
    at = limit + side * 1e-9
    one_sided = side * (resisted(at + side * 1e-8) - resisted(at)) / 1e-8
    assert float(slope(at)) == pytest.approx(float(one_sided), rel=2e-2, abs=2e-3)
    assert float(slope(at)) == pytest.approx(float(slope(limit)), rel=2e-2, abs=2e-3)
    assert np.isfinite(jax.grad(slope)(jnp.asarray(limit)))


def test_a_folding_neck_is_a_wedge_without_gas():
    """For stiff film: p times the volume change due to bending, minus the work of the muscles."""
    stiff = Neck(radius=0.05, length=0.06, film_stiffness=1e9)
    for angle in (0.4, 0.8, 1.2):
        depth = np.linspace(0, 0.1, 400_001)
        width = 2 * np.sqrt(np.maximum(0.05**2 - (0.05 - depth) ** 2, 0))
        is_open = depth < 0.06 / angle
        lost = np.trapezoid(np.where(is_open, depth * width, 0), depth)
        given = float(resisted(angle, neck=stiff))
        assert given == pytest.approx(1e3 * lost - 3.0 * 0.05, abs=1e-4)
        assert float(resisted(-angle, neck=stiff)) == -given


BREUKELS = (6582.82, -272.43, 40852.38, 14.31, 271865251.42, 215.93, 14021.79, -589.05)
COLLAPSE = (322.55, 0.0239, 5.3833, 0.0461)


def measured(deflection, radius, bar):
    """Return the tip force (N) of an inflated cantilever of 1 m by Breukels' fit of measurements.

    J. Breukels, An engineering methodology for kite design, TU Delft, 2011: tubes of kite fabric.
    The numbers are those of the programs ASKITE and kite_fem.
    """
    a, b, c, d, e, f, g, h = BREUKELS
    plateau = (a * radius + b) * bar**2 + c * radius**3 + d
    slope = (e * radius**5 + f) * bar + g * radius + h
    return plateau * (1 - np.exp(-slope / plateau * deflection))


@pytest.mark.parametrize("bar", [0.3, 0.4, 0.5])
def test_a_cantilever_follows_measured_loads(bar):
    """From a tenth of the deflection at collapse up to it; the fabric's E t is fitted."""
    radius = 0.065
    e, f, g, h = COLLAPSE
    collapse = (e * radius**4 + f) * bar + g * radius**2 + h
    deflections = np.linspace(0.1, 1.0, 10) * collapse
    loads = measured(deflections, radius, bar)
    along = np.linspace(0, 1, 401)
    weights = along * np.gradient(along)
    weights[-1] /= 2
    force = jnp.asarray(bar * 1e5 * np.pi * radius**2)
    ends = np.linspace(0, 0.9999, 400) * float(force) * radius

    @jax.jit
    def deflection(stiffness):
        tube = Tube(jnp.asarray(radius), stiffness)
        k = curvature(tube, jnp.asarray(np.outer(ends, along)), force)
        return jnp.asarray(weights) @ k.T

    def off(logarithm):
        curve = np.asarray(deflection(jnp.exp(logarithm)))
        return np.max(np.abs(np.interp(deflections, curve, ends) / loads - 1))

    fitted = minimize_scalar(off, bounds=np.log([5e4, 1e6]), method="bounded")
    assert 1.4e5 < np.exp(fitted.x) < 2.2e5
    assert fitted.fun < 0.1
    # The load at collapse, which does not depend on E t, agrees with the measurement to 20 %.
    assert loads[-1] / (float(force) * radius) == pytest.approx(0.87, abs=0.08)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_near_collapse_and_without_a_force_nothing_is_lost(dtype):
    """1 - M / (N r) is d^2 / 10 for the tight angle d, and M / (E t r^3 k) approaches 2 d^3 / 3."""
    loads = jnp.asarray(1 - np.logspace(-16, -0.31, 300), dtype)
    shares = np.asarray(stiff_share(loads))
    assert np.all(np.isfinite(shares) & (shares >= 0))
    assert np.all(np.diff(shares) >= -1e-6)
    angle = dtype(0.05)
    near = stiff_share(jnp.asarray(1 - angle**2 / 10, dtype))
    assert_allclose(np.pi * near, 2 * angle**3 / 3, rtol=2e-3)
    tube = Tube(jnp.asarray(0.1, dtype), jnp.asarray(1e4, dtype))
    force = jnp.asarray(20.0, dtype)
    far = moment(tube, jnp.asarray(1e7, dtype), force)
    assert_allclose(far, 2.0, rtol=1e-3)
    crushed = jnp.asarray(-1.0, dtype)
    assert np.isinf(curvature(tube, jnp.asarray(0.1, dtype), crushed))
    assert curvature(tube, jnp.asarray(0.0, dtype), crushed) == 0
    assert jax.grad(lambda bend: moment(tube, bend, crushed))(jnp.asarray(0.0, dtype)) == 0
