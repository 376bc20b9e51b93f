"""Square-root Kalman filter and smoother: normal distributions by a root of their covariance.

A root L has L L^T = P. Sums of covariances are stacked roots, made triangular again by QR, so that
no covariance is ever formed, is always symmetric and stays positive definite in rounding.

- Prediction and measurement: Kaminski, Bryson and Schmidt, Discrete square root filtering: a survey
  of current techniques, IEEE Trans. Automatic Control 16 (1971) 727.
- Considered parameters, which are uncertain and not estimated: Schmidt, Application of state-space
  methods to navigation problems, Advances in Control Systems 3 (1966) 293.
- Smoother: Rauch, Tung and Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA
  Journal 3 (1965) 1445; in square-root form Park and Kailath, IEEE Trans. Automatic Control 41
  (1996) 727, as a sum of three roots here.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Bool, Float


class Gaussian(NamedTuple):
    """A normal distribution.

    Attributes:
        mean: shape (state,).
        root: lower triangular, of which root root^T is the covariance, shape (state, state).
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
    """Lower triangular root of a sum of covariances, by their roots side by side."""
    upper = jnp.linalg.qr(jnp.concatenate(roots, axis=1).T, mode="r")
    # As many rows as states, also where the roots have fewer columns.
    missing = upper.shape[1] - upper.shape[0]
    return jnp.pad(upper, ((0, max(missing, 0)), (0, 0))).T


def moved(
    before: Gaussian,
    mean: Float[Array, " state"],
    slope: Float[Array, "state state"],
    noise: Float[Array, "state noise"],
) -> Gaussian:
    """The distribution after a motion.

    Arguments:
        before: it.
        mean: where its mean moves to.
        slope: derivatives of that by the mean before.
        noise: root of the covariance that the motion adds.
    """
    return Gaussian(mean, root_of_sum(slope @ before.root, noise))


class Innovation(NamedTuple):
    """What measurements were beside what was expected.

    Attributes:
        off: measured minus expected, 0 of what was not measured, shape (channel,).
        deviations: expected of that, shape (channel,).
        nis: square of all that was measured, over what is expected; outliers count.
        whitened: what was used, as numbers that are independent and of deviation 1; 0 of the rest.
        log_likelihood: of what was used.
    """

    off: Float[Array, " channel"]
    deviations: Float[Array, " channel"]
    nis: Float[Array, ""]
    whitened: Float[Array, " channel"]
    log_likelihood: Float[Array, ""]


class Correction(NamedTuple):
    """How measurements change a state.

    Attributes:
        gain: of the state by what is off, shape (state, channel).
        factor: lower triangular root of what is expected of that, shape (channel, channel).
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
    """The distribution after measurements whose noise is independent.

    Arguments:
        before: the distribution.
        off: measured minus expected values.
        slope: derivatives of the expected values by the state.
        noise: standard deviations.
        there: what was measured; what was not may be anything, NaN as well.
        used: what of that counts for the state; the innovation is of all that is there.
        estimated: states that a measurement changes; the others are considered.
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
    # Joseph's form, which is right for every gain.
    root = root_of_sum(before.root - gain @ seen, gain * noise[None])
    whitened = jax.scipy.linalg.solve_triangular(factor, known, lower=True)
    size = jnp.sum(jnp.log(jnp.abs(jnp.diag(factor))))
    count = jnp.sum(used, dtype=off.dtype)
    likelihood = -0.5 * (jnp.sum(whitened**2) + count * math.log(2 * math.pi)) - size
    innovation = Innovation(jnp.where(there, off, 0), deviations, nis, whitened, likelihood)
    return Gaussian(before.mean + gain @ known, root), innovation, Correction(gain, factor)


def _expected(root: Array, slope: Array, noise: Array, these: Array) -> tuple[Array, Array, Array]:
    """Root of what the state adds to these channels, their noise, and a root of their sum."""
    seen = jnp.where(these[:, None], slope, 0) @ root
    noise = jnp.where(these, noise, 1)
    return seen, noise, root_of_sum(seen, jnp.diag(noise))


# Of a state that is certain, so that its covariance has an inverse: over its deviation, and least.
_FLOOR, _LEAST = 1e-10, 1e-14


def smoothed(
    before: Gaussian,
    mean: Float[Array, " state"],
    slope: Float[Array, "state state"],
    noise: Float[Array, "state noise"],
    after: Gaussian,
) -> Gaussian:
    """What is known of a state once everything after it is known, too.

    Arguments:
        before: by all that was measured until then.
        mean, slope, noise: of the motion from then on, as of `moved`.
        after: the state after that motion, by everything.
    """
    through = slope @ before.root
    size = jnp.sqrt(jnp.sum(through**2, axis=1) + jnp.sum(noise**2, axis=1))
    expected = root_of_sum(through, noise, jnp.diag(_FLOOR * size + _LEAST))
    across = jax.scipy.linalg.solve_triangular(expected, through, lower=True)
    gain = before.root @ jax.scipy.linalg.solve_triangular(expected.T, across, lower=False).T
    left = before.root - gain @ through
    root = root_of_sum(left, gain @ noise, gain @ after.root)
    return Gaussian(before.mean + gain @ (after.mean - mean), root)
