"""Square-root Kalman filter and smoother.

A normal distribution is represented by its mean and a square root L of its covariance, L L^T = P.
A sum of covariances is computed by QR decomposition of the stacked roots. Covariances are never
formed, and remain symmetric and positive definite despite rounding errors.

- Prediction and measurement: Kaminski, Bryson and Schmidt, Discrete square root filtering: a survey
  of current techniques, IEEE Trans. Automatic Control 16 (1971) 727.
- Consider parameters, which are uncertain and not estimated: Schmidt, Application of state-space
  methods to navigation problems, Advances in Control Systems 3 (1966) 293.
- Smoother: Rauch, Tung and Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA
  Journal 3 (1965) 1445; in square-root form by Park and Kailath, IEEE Trans. Automatic Control 41
  (1996) 727, and here as a sum of three roots.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Bool, Float


class Gaussian(NamedTuple):
    """Normal distribution.

    Attributes:
        mean: mean, shape (state,).
        root: lower triangular square root of the covariance root root^T, shape (state, state).
    """

    mean: Float[Array, " state"]
    root: Float[Array, "state state"]

    @property
    def covariance(self) -> Float[Array, "state state"]:
        """Covariance."""
        return self.root @ self.root.T

    @property
    def deviations(self) -> Float[Array, " state"]:
        """Standard deviations."""
        return jnp.sqrt(jnp.sum(self.root**2, axis=-1))


def root_of_sum(*roots: Float[Array, "state _"]) -> Float[Array, "state state"]:
    """Return the lower triangular root of a sum of covariances, given their roots."""
    upper = jnp.linalg.qr(jnp.concatenate(roots, axis=1).T, mode="r")
    # Pad to one row per state, because the roots may have fewer columns.
    missing = upper.shape[1] - upper.shape[0]
    return jnp.pad(upper, ((0, max(missing, 0)), (0, 0))).T


def moved(
    before: Gaussian,
    mean: Float[Array, " state"],
    slope: Float[Array, "state state"],
    noise: Float[Array, "state noise"],
) -> Gaussian:
    """Return the distribution after a motion.

    Arguments:
        before: distribution before the motion.
        mean: mean after the motion.
        slope: derivatives of the mean after the motion with respect to the mean before.
        noise: square root of the covariance that the motion adds.
    """
    return Gaussian(mean, root_of_sum(slope @ before.root, noise))


class Innovation(NamedTuple):
    """Innovation of the measurements of one time.

    Attributes:
        off: measured minus predicted values, shape (channel,); 0 if not measured.
        deviations: predicted standard deviations of `off`, shape (channel,).
        nis: normalised innovation squared of all measurements, including outliers.
        whitened: whitened innovations of the used measurements, with standard deviation 1; 0 for
            all others.
        log_likelihood: log-likelihood of the used measurements.
    """

    off: Float[Array, " channel"]
    deviations: Float[Array, " channel"]
    nis: Float[Array, ""]
    whitened: Float[Array, " channel"]
    log_likelihood: Float[Array, ""]


class Correction(NamedTuple):
    """Correction of a state by measurements.

    Attributes:
        gain: gain from the innovation to the state, shape (state, channel).
        factor: lower triangular square root of the covariance of the innovation, shape
            (channel, channel).
    """

    gain: Float[Array, "state channel"]
    factor: Float[Array, "channel channel"]


def measured(
    before: Gaussian,
    off: Float[Array, " channel"],
    slope: Float[Array, "channel state"],
    noise: Float[Array, " channel"],
    *,
    there: Bool[Array, " channel"],
    used: Bool[Array, " channel"],
    estimated: Bool[Array, " state"],
) -> tuple[Gaussian, Innovation, Correction]:
    """Return the distribution after measurements with independent noise.

    Arguments:
        before: distribution before the measurements.
        off: measured minus predicted values.
        slope: derivatives of the predicted values with respect to the state.
        noise: standard deviations of the noise.
        there: whether each channel was measured; values of other channels are ignored, and can be
            NaN.
        used: whether each measurement is used for the state; the innovation includes all
            measurements.
        estimated: whether each state is estimated; the other states are consider parameters.

    Returns:
        The distribution, the innovation and the correction.
    """
    used = used & there
    known = jnp.where(there, off, 0)
    _, _, factor = _expected(before.root, slope, noise, there)
    deviations = jnp.sqrt(jnp.sum(factor**2, axis=1))
    nis = jnp.sum(jax.scipy.linalg.solve_triangular(factor, known, lower=True) ** 2)
    known = jnp.where(used, off, 0)
    seen, noise, factor = _expected(before.root, slope, noise, used)
    across = jax.scipy.linalg.solve_triangular(factor, seen, lower=True)
    gain = jax.scipy.linalg.solve_triangular(factor.T, across, lower=False).T
    gain = jnp.where(estimated[:, None], before.root @ gain, 0)
    # The Joseph form is valid for every gain.
    root = root_of_sum(before.root - gain @ seen, gain * noise[None])
    whitened = jax.scipy.linalg.solve_triangular(factor, known, lower=True)
    size = jnp.sum(jnp.log(jnp.abs(jnp.diag(factor))))
    count = jnp.sum(used, dtype=off.dtype)
    likelihood = -0.5 * (jnp.sum(whitened**2) + count * math.log(2 * math.pi)) - size
    innovation = Innovation(jnp.where(there, off, 0), deviations, nis, whitened, likelihood)
    return Gaussian(before.mean + gain @ known, root), innovation, Correction(gain, factor)


def _expected(root: Array, slope: Array, noise: Array, these: Array) -> tuple[Array, Array, Array]:
    """Return the root of the state's contribution to channels, their noise, and the total root."""
    seen = jnp.where(these[:, None], slope, 0) @ root
    noise = jnp.where(these, noise, 1)
    return seen, noise, root_of_sum(seen, jnp.diag(noise))


# Smallest standard deviations, relative and absolute, that keep the covariance of a state without
# uncertainty invertible.
_FLOOR, _LEAST = 1e-10, 1e-14


def smoothed(
    before: Gaussian,
    mean: Float[Array, " state"],
    slope: Float[Array, "state state"],
    noise: Float[Array, "state noise"],
    after: Gaussian,
) -> Gaussian:
    """Return the smoothed distribution of a state.

    Arguments:
        before: filtered distribution of the state.
        mean, slope, noise: motion that follows, as in `moved`.
        after: smoothed distribution after this motion.
    """
    through = slope @ before.root
    size = jnp.sqrt(jnp.sum(through**2, axis=1) + jnp.sum(noise**2, axis=1))
    expected = root_of_sum(through, noise, jnp.diag(_FLOOR * size + _LEAST))
    across = jax.scipy.linalg.solve_triangular(expected, through, lower=True)
    gain = before.root @ jax.scipy.linalg.solve_triangular(expected.T, across, lower=False).T
    left = before.root - gain @ through
    root = root_of_sum(left, gain @ noise, gain @ after.root)
    return Gaussian(before.mean + gain @ (after.mean - mean), root)
