"""Derivatives of the statics against central differences, one-sided where the path changes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax.mechanics.joint import Correction, Joint, branch_angles, muscle_state

OUTPUTS = ("contraction", "force", "wire_tension", "push_x", "push_y")
# Angles at which the corrections have corners, deg; the branch points are added.
KINKS = [-20.0, -2.0, 0.0, 40.0]
STEP = 1e-6


@jax.jit
def outputs(joint, angle):
    state = muscle_state(joint, angle)
    return jnp.stack([getattr(state, name) for name in OUTPUTS])


@jax.jit
def by_angle(joint, angle):
    return jax.jacfwd(lambda a: outputs(joint, a))(angle)


@pytest.mark.slow
@pytest.mark.parametrize("reading", ["continuous", "none"])
def test_the_slope_by_the_angle(reading):
    joint = Joint(correction=Correction(reading=reading))
    kinks = np.deg2rad([*KINKS, *np.rad2deg(branch_angles(joint.geometry))])
    angles = np.deg2rad(np.linspace(-60, 60, 241))
    away = angles[np.min(np.abs(angles[:, None] - kinks), axis=1) > 2 * STEP]
    assert len(away) > 230
    slopes = jax.vmap(lambda a: by_angle(joint, a))(jnp.asarray(away))
    assert np.all(np.isfinite(slopes))
    ahead, behind = outputs(joint, away + STEP), outputs(joint, away - STEP)
    np.testing.assert_allclose(slopes.T, (ahead - behind) / (2 * STEP), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("kink", [*KINKS, "taut", "wrapped"])
def test_one_sided_slopes_at_the_branch_points_and_at_0(kink):
    joint = Joint()
    taut, wrapped = branch_angles(joint.geometry)
    at = {"taut": taut, "wrapped": wrapped}.get(kink)
    at = np.deg2rad(kink) if at is None else at
    assert np.all(np.isfinite(by_angle(joint, at)))
    for sign in (1, -1):
        # Second-order differences from points on one side only.
        start = at + sign * 1e-9
        values = [outputs(joint, start + sign * d * STEP) for d in range(3)]
        slope = sign * (-3 * values[0] + 4 * values[1] - values[2]) / (2 * STEP)
        np.testing.assert_allclose(by_angle(joint, start), slope, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_the_slope_by_every_parameter():
    joint = Joint()
    angles = np.deg2rad([-55.0, -30.0, -10.0, -3.0, -1.0, 1.0, 2.5, 8.0, 30.0, 55.0])
    paths = list(giajax.declared(joint))
    values = jnp.stack([giajax.get(joint, path) for path in paths])

    @jax.jit
    def at(values):
        return outputs(giajax.replace(joint, dict(zip(paths, values, strict=True))), angles)

    slopes, reverses = (np.asarray(jax.jit(mode(at))(values)) for mode in (jax.jacfwd, jax.jacrev))
    for index, path in enumerate(paths):
        slope, reverse = slopes[..., index], reverses[..., index]
        assert np.all(np.isfinite(slope)), path
        step = 1e-6
        ahead, behind = (at(values.at[index].add(sign * step)) for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-6, err_msg=path)
        np.testing.assert_allclose(slope, reverse, rtol=1e-10, atol=1e-12, err_msg=path)
        assert np.any(np.abs(slope) > 1e-3), path


def test_jit_vmap_and_a_batch_agree():
    joint = Joint()
    angles = jnp.deg2rad(jnp.linspace(-60, 60, 25))
    batch = muscle_state(joint, angles).force
    one_by_one = jax.vmap(lambda a: muscle_state(joint, a).force)(angles)
    compiled = jax.jit(lambda a: muscle_state(joint, a).force)(angles)
    np.testing.assert_allclose(batch, one_by_one, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(batch, compiled, rtol=1e-14, atol=1e-15)
