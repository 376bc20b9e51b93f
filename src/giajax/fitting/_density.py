"""Probability density of the parameters that corresponds to a least-squares fit.

Its gradient is J^T r with the Jacobian of the fit, so no reverse pass through an integrator is
needed.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..runtime.arrays import Array, Float, Scalar, on_device
from ..runtime.text import InputError
from ._coordinates import Bijector, Unbounded
from ._linearise import linearise
from ._losses import untransformed
from ._optimum import Optimum
from ._problem import Problem
from ._statistics import Statistics, weighted_residuals
from ._uncertainty import inverse_gram

_MOSTLY = 0.5  # a prior with a larger share of the information has set the standard error


def check_proper(statistics: Statistics, lower: np.ndarray, upper: np.ndarray) -> None:
    """Refuse a density whose integral is infinite.

    Raises:
        InputError: a parameter is limited neither by the data nor by bounds. The message names it.
    """
    open_ended = ~(np.isfinite(lower) & np.isfinite(upper))
    loose = [
        statistics.labels[index]
        for index in statistics.alive.tolist()
        if open_ended[index] and not np.isfinite(statistics.standard_errors.get(index, np.inf))
    ]
    if loose:
        raise InputError(
            "the posterior is improper, because neither the data nor two bounds limit "
            f"{' and '.join(loose)}: fix each unlimited parameter, or give it a prior or two "
            "bounds, and fit again"
        )


def cost_scale(optimum: Optimum) -> float:
    """Return the divisor of the cost for which its curvature gives the reported standard errors.

    For the linear loss it is the scale of the covariance, including the errors of estimated noise.
    For a robust loss it is the ratio of the sandwich covariance to the inverse curvature. It is the
    geometric mean over the parameters that are not mostly determined by a prior.
    """
    problem, statistics = optimum.state.problem, optimum.statistics
    jacobian = optimum.state.natural_jacobian
    weights = None
    if not problem.loss.is_linear:
        residuals, _ = weighted_residuals(optimum.state)
        _, _, curvature, slope = problem.loss.scores(residuals)
        data = np.arange(len(residuals)) < len(residuals) - len(problem.priors.columns)
        root = np.sqrt(np.maximum(curvature, 0.0))
        weights = np.where(data, untransformed(root, slope), 1.0)
    alive = statistics.alive
    with np.errstate(all="ignore"):
        known = np.diag(inverse_gram(jacobian.reduced(weights)[:, alive]))
        ratios = np.diag(statistics.covariance) / known
    rows = [
        row
        for row, index in enumerate(alive.tolist())
        if index in statistics.standard_errors
        and statistics.prior_shares.get(index, 0.0) < _MOSTLY
        and np.isfinite(ratios[row])
        and ratios[row] > 0
    ]
    return float(np.exp(np.mean(np.log(ratios[rows])))) if rows else statistics.scale


Row = Float[Array, " drawn"]


class Density(eqx.Module):
    """Density over the free parameters, uniform in the parameters themselves without a prior.

    A prior with a factor is log-normal, and its stated value is its median.

    The density of the sampler's coordinate is approximately standard normal. The covariance at the
    optimum maps this coordinate to one without bounds (`Unbounded`), which is mapped to the
    parameters.

    Attributes:
        problem: problem of the fit, whose coordinate is the parameters themselves.
        held: values of all free parameters at the end of the fit. Parameters to which no channel
            responds stay there.
        bounds: bounds of the parameters that are drawn.
        centre: coordinate without bounds at the optimum, shape (drawn,).
        spread: matrix root of the covariance at the optimum, shape (drawn, drawn).
        places: positions of the drawn parameters among all free parameters.
        scale: divisor of the cost of the measured values. The cost of priors is not divided.
    """

    problem: Problem
    held: Float[Array, " parameter"]
    bounds: Unbounded
    centre: Row
    spread: Float[Array, "drawn drawn"]
    scale: Scalar
    places: tuple[int, ...] = eqx.field(static=True)

    def values(self, z: Row) -> Float[Array, " parameter"]:
        """Return all free parameters at a coordinate of the sampler, SI units."""
        drawn = self.bounds.forward(self.centre + self.spread @ z)[0]
        return self.held.at[np.asarray(self.places)].set(drawn)

    def at(self, z: Row) -> tuple[Scalar, Row]:
        """Return the negative log density of z, up to a constant, and its gradient.

        The result is infinite, with a gradient of zero, where the model cannot be evaluated.
        """
        values = self.values(z)
        row, _, factor, projected, prediction = linearise(values, self.problem)
        known, slopes = self.problem.priors.rows(values, self.problem.bijector)
        columns = np.asarray(self.problem.priors.columns, dtype=int)
        by_priors = jnp.zeros_like(values).at[columns].add(slopes * known)
        energy, gradient = self.energy(
            z, row @ row / 2, factor.T @ projected, known @ known / 2, by_priors
        )
        sound = prediction.successful & jnp.isfinite(energy)
        sound = sound & jnp.all(jnp.isfinite(gradient))
        return jnp.where(sound, energy, jnp.inf), jnp.where(sound, gradient, 0)

    def energy(
        self, z: Row, cost: Any, by_values: Array, prior_cost: Any, by_priors: Array
    ) -> tuple[Scalar, Row]:
        """Return the result of `at` from the costs and their gradients.

        Arguments:
            z: coordinate of the sampler.
            cost: cost of the measured values and the priors.
            by_values: gradient of the cost with respect to all free parameters.
            prior_cost: cost of the priors.
            by_priors: gradient of the cost of the priors.
        """
        _, slope, change, _ = self.bounds.forward(self.centre + self.spread @ z)
        energy = (cost - prior_cost) / self.scale + prior_cost - jnp.sum(slope)
        gradient = (by_values - by_priors) / self.scale + by_priors
        # A normal density of log(p) is a density of p after multiplication by the derivative 1 / p.
        priors, values = self.problem.priors, self.values(z)
        columns = np.asarray(priors.columns, dtype=int)[np.asarray(priors.logarithmic, dtype=bool)]
        energy = energy + jnp.sum(jnp.log(values[columns]))
        gradient = gradient.at[columns].add(1 / values[columns])[np.asarray(self.places)]
        return energy, self.spread.T @ (gradient * jnp.exp(slope) - change)

    def potential(self) -> Callable[[Row], Scalar]:
        """Return the negative log density as a function that JAX can differentiate once."""

        @jax.custom_vjp
        def energy(z: Row) -> Scalar:
            return self.at(z)[0]

        energy.defvjp(self.at, lambda gradient, cotangent: (cotangent * gradient,))
        return energy


def density_of(optimum: Optimum) -> Density:
    """Return the density around an optimum, with the noise of the fit.

    Its negative logarithm is the cost, divided by `cost_scale` so that its curvature gives the
    standard errors, plus the cost of the priors. A prior of the logarithm of a parameter also
    contributes that logarithm. A robust loss is used as a density up to a constant.

    Raises:
        InputError: a parameter is limited neither by the data nor by bounds.
    """
    state, statistics = optimum.state, optimum.statistics
    lower, upper = optimum.bounds
    check_proper(statistics, lower, upper)
    places, size = statistics.alive, state.problem.size
    lower, upper = lower[places], upper[places]
    ranges = np.where(np.isfinite(lower) & np.isfinite(upper), upper - lower, 1.0)
    errors = [
        statistics.standard_errors.get(index, width)
        for index, width in zip(places.tolist(), ranges.tolist(), strict=True)
    ]
    bounds = Unbounded.of(lower, upper, np.asarray(errors))
    scale = cost_scale(optimum)
    dtype = jnp.result_type(float)
    centre = on_device(bounds.inverse(optimum.values[places]), dtype)
    _, slope, _, second = (np.asarray(each) for each in bounds.forward(centre))
    rows = len(state.inner.residual)
    data = np.arange(rows) < rows - len(state.problem.priors.columns)
    root = state.natural_jacobian.reduced(np.where(data, 1 / np.sqrt(scale), 1.0))
    # The derivative of the map contributes curvature near a bound.
    whole = np.concatenate([root[:, places] * np.exp(slope), np.diag(np.sqrt(-second))])
    natural = Bijector.of([-np.inf] * size, [np.inf] * size, [0.0] * size)
    return Density(
        problem=dataclasses.replace(state.problem, bijector=natural),
        held=on_device(optimum.values, dtype),
        bounds=bounds,
        centre=centre,
        spread=on_device(np.linalg.inv(np.linalg.qr(whole, mode="r")), dtype),
        scale=on_device(scale, dtype),
        places=tuple(places.tolist()),
    )


def energy_at(density: Density, optimum: Optimum, z: np.ndarray) -> tuple[float, np.ndarray]:
    """Evaluate `Density.at` with the programs of the fit, which are already compiled."""
    values = np.asarray(density.values(on_device(z, density.centre.dtype)), dtype=float)
    point = optimum.at(values)
    if not np.isfinite(point.cost):
        return float("inf"), np.zeros_like(z)
    count = len(density.problem.priors.columns)
    known = point.residual[len(point.residual) - count :]
    by_priors = np.zeros_like(values)
    if count:
        columns = list(density.problem.priors.columns)
        np.add.at(by_priors, columns, np.diag(point.jacobian.blocks[-1]) * known)
    energy, gradient = density.energy(
        on_device(z, density.centre.dtype),
        point.cost,
        on_device(point.jacobian.transposed_times(point.residual), density.centre.dtype),
        float(known @ known) / 2,
        on_device(by_priors, density.centre.dtype),
    )
    return float(energy), np.asarray(gradient)
