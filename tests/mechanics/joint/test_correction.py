"""Alpha and beta: the continuous reading, the printed reading, and the blend."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax.mechanics.joint import Alpha, Beta, Correction


def at(correction, degrees, inner):
    angle = jnp.deg2rad(jnp.asarray(degrees, dtype=float))
    return np.asarray(correction(angle, jnp.full(angle.shape, inner)))


def test_alpha_is_as_printed():
    correction = Correction()
    np.testing.assert_allclose(
        at(correction, [0, 20, 40, 50, 60], True),
        [0.03, 0.03, 0.03, 0.03 + 100 / 1600, 0.28],
        rtol=1e-12,
    )


def test_beta_is_continuous_with_the_magnitude_of_the_angle():
    np.testing.assert_allclose(
        at(Correction(), [0, -1, -2, -10, -20, -40, -60], False),
        [0.01, 0.005, 0, 0, 0, -0.075, -0.3],
        atol=1e-15,
    )
    fine = at(Correction(), np.linspace(-60, 0, 60_001), False)
    assert np.max(np.abs(np.diff(fine))) < 2e-5


def test_the_printed_beta_jumps_and_makes_the_muscle_push():
    printed = Correction(reading="printed")
    before, after = at(printed, [-2.0000001, -1.9999999], False)
    assert before == 0
    assert after == pytest.approx(0.02, rel=1e-6)
    before, after = at(printed, [-20.0000001, -19.9999999], False)
    assert before == pytest.approx(-0.3, rel=1e-6)
    assert after == 0
    # The balance torque is 0.3 + beta = -0.9 N m.
    assert 0.3 + at(printed, [-60.0], False)[0] == pytest.approx(-0.9, abs=1e-12)
    # At 0, both readings agree, and alpha is the same for both.
    assert at(printed, [0.0], False) == at(Correction(), [0.0], False)
    degrees = np.linspace(0, 60, 61)
    assert np.all(at(printed, degrees, True) == at(Correction(), degrees, True))


def test_none_is_zero():
    assert np.all(at(Correction(reading="none"), [0, 30, 60], True) == 0)


def test_a_blend_joins_values_and_slopes():
    width = np.deg2rad(3)
    blended = Correction(blend=width)
    plain = Correction()
    degrees = np.array([-60.0, -20, -3, 3, 20, 60])
    for degree in degrees:
        inner = degree > 0
        np.testing.assert_allclose(
            at(blended, [degree], inner), at(plain, [degree], inner), rtol=1e-12, atol=1e-15
        )
    fine = np.deg2rad(np.linspace(-4, 4, 8001))

    def value(angle):
        return blended(angle, angle >= 0)

    values, slopes = jax.vmap(jax.value_and_grad(value))(jnp.asarray(fine))
    assert np.max(np.abs(np.diff(values))) < 2e-5
    # The slope is continuous, too (the wedge of beta ends at 2 deg, inside the blend).
    assert np.max(np.abs(np.diff(slopes))) < 2e-3
    # Within the blend, the result does not depend on the side.
    assert at(blended, [0.0], True) == at(blended, [0.0], False)


def test_the_families_can_be_differentiated():
    def total(correction):
        inner = correction(jnp.deg2rad(jnp.linspace(0, 60, 13)), jnp.ones(13, bool))
        outer = correction(-jnp.deg2rad(jnp.linspace(0, 60, 61)), jnp.zeros(61, bool))
        return jnp.sum(inner**2) + jnp.sum(outer**2)

    slopes = jax.grad(total)(Correction())
    for path in ("alpha", "beta"):
        for name, slope in vars(getattr(slopes, path)).items():
            step = 1e-7
            ahead, behind = (
                total(giajax.replace(Correction(), {f"{path}.{name}": value}))
                for value in (
                    getattr(getattr(Correction(), path), name) + step,
                    getattr(getattr(Correction(), path), name) - step,
                )
            )
            assert float(slope) == pytest.approx(float((ahead - behind) / (2 * step)), rel=1e-5)
            assert slope != 0


def test_other_corrections_are_refused():
    with pytest.raises(giajax.InputError, match="continuous, printed, none"):
        Correction(reading="smooth")
    with pytest.raises(giajax.InputError, match="0 to 30 deg"):
        Correction(blend=1.0)


def test_the_defaults_are_the_papers():
    alpha, beta = Alpha(), Beta()
    assert float(alpha.offset) == 0.03
    assert float(jnp.rad2deg(alpha.threshold)) == pytest.approx(40)
    assert float(beta.offset) == 0.01
    per_degree = np.deg2rad(1.0) ** 2
    assert float(alpha.curvature) * per_degree == pytest.approx(1 / 1600)
    assert float(beta.curvature) * per_degree == pytest.approx(0.3 / 1600)
