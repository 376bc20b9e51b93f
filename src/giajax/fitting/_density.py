"""The density of the parameters that a fit's least squares stand for, with its gradient.

The gradient is J^T r of the fit's own Jacobian: no reverse pass goes through an integrator.
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

_MOSTLY = 0.5  # a prior that says more than this of a parameter has set its standard error


def check_proper(statistics: Statistics, lower: np.ndarray, upper: np.ndarray) -> None:
    """Refuse a density whose integral is infinite.

    Raises:
        InputError: naming what neither data nor bounds limit.
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
            f"{' and '.join(loose)}: fix it, or give it a prior or two bounds, and fit again"
        )


def cost_scale(optimum: Optimum) -> float:
    """What the cost is divided by, so that its curvature gives the reported standard errors.

    With the usual loss that is the scale on the covariance, and what the errors of estimated noise
    add to it; with a robust one the ratio of its sandwich to the inverse curvature. The geometric
    mean over the parameters that are not mostly known by a prior.
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
    """A density over free parameters, flat in the parameters themselves where there is no prior.

    A prior of a factor is log-normal, with its median where it is stated.

    The coordinate of a sampler, in which the density is about that of a standard normal variable,
    is mapped by the covariance at the optimum to one without bounds (`Unbounded`), and that to the
    parameters.

    Attributes:
        problem: of the fit, whose coordinate is the parameters themselves.
        held: values of all free parameters where the fit ended; those that no channel responds to
            stay there.
        bounds: of the parameters that are drawn.
        centre: of their coordinate without bounds, shape (drawn,).
        spread: a root of the covariance there, shape (drawn, drawn).
        places: of them among all free parameters.
        scale: what the cost of the measured values is divided by; that of priors is not.
    """

    problem: Problem
    held: Float[Array, " parameter"]
    bounds: Unbounded
    centre: Row
    spread: Float[Array, "drawn drawn"]
    scale: Scalar
    places: tuple[int, ...] = eqx.field(static=True)

    def values(self, z: Row) -> Float[Array, " parameter"]:
        """All free parameters at a coordinate of the sampler, SI."""
        drawn = self.bounds.forward(self.centre + self.spread @ z)[0]
        return self.held.at[np.asarray(self.places)].set(drawn)

    def at(self, z: Row) -> tuple[Scalar, Row]:
        """Minus the logarithm of the density of z, up to a constant, and its gradient.

        Infinite, with a gradient of zero, where the model cannot be evaluated.
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
        """What `at` is, of the cost, its gradient by all values, and those of the priors."""
        _, slope, change, _ = self.bounds.forward(self.centre + self.spread @ z)
        energy = (cost - prior_cost) / self.scale + prior_cost - jnp.sum(slope)
        gradient = (by_values - by_priors) / self.scale + by_priors
        # A normal density of the logarithm of p is one of p by its derivative, 1 / p.
        priors, values = self.problem.priors, self.values(z)
        columns = np.asarray(priors.columns, dtype=int)[np.asarray(priors.logarithmic, dtype=bool)]
        energy = energy + jnp.sum(jnp.log(values[columns]))
        gradient = gradient.at[columns].add(1 / values[columns])[np.asarray(self.places)]
        return energy, self.spread.T @ (gradient * jnp.exp(slope) - change)

    def potential(self) -> Callable[[Row], Scalar]:
        """Minus the logarithm of the density as a function that JAX can differentiate once."""

        @jax.custom_vjp
        def energy(z: Row) -> Scalar:
            return self.at(z)[0]

        energy.defvjp(self.at, lambda gradient, cotangent: (cotangent * gradient,))
        return energy


def density_of(optimum: Optimum) -> Density:
    """The density around an optimum, with the noise as it was fitted.

    Minus its logarithm is the cost in units of the noise, divided by what makes standard errors of
    the curvature (`cost_scale`), and that of the priors; where a prior is of the logarithm of a
    parameter, that logarithm too. A robust loss counts as a density up to a constant.

    Raises:
        InputError: nothing bounds a parameter that the data do not determine.
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
    # The derivative of the map has a curvature of its own, near a bound.
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
    """As `Density.at`, by the programs of the fit, which are compiled already."""
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
