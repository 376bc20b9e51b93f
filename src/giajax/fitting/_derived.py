"""Quantities that follow from the parameters, with standard errors of their own.

A quantity may be determined where its parameters are not: of two parameters that count only as a
product, the product is. To first order it is when its gradient has no part in the directions
that leave every residual unchanged; then any generalised inverse of J^T J gives its variance
(C. R. Rao, "Linear Statistical Inference", 2nd ed., 1973, section 4a).
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._maths import on_device
from .._typing import Array
from ..models import AbstractModel
from ..parameters import Declaration, find, get
from ._identifiability import COLLINEAR
from ._problem import Problem
from ._records import Estimate, finite_or_none
from ._statistics import Statistics
from ._ties import Tie

# Part of a gradient in undetermined directions that is rounding of the Jacobian.
_ROUNDING = 1e-5


def derived_estimates(problem: Problem, statistics: Statistics) -> dict[str, Estimate]:
    """Estimates of what follows from the fitted parameters.

    Arguments:
        problem: what was minimised.
        statistics: of the fit.

    Returns:
        The tied parameters by path, element by element where these differ, and by name the
        derived quantities of the model that depend on a parameter which responds. Of what has a
        value for each group of runs, the mean counts.
    """
    count = problem.shared
    model = problem.with_values(problem.means(statistics.values[:count]))
    units = {name: quantity.unit for name, quantity in model.derived().items()}
    followers = _followers(model, problem.ties)
    if not units and not followers:
        return {}
    of_values = derived_quantities(problem, statistics.values)
    values = jnp.asarray(statistics.values[:count], dtype=jnp.result_type(float))
    at, slopes = of_values(values), jax.jacfwd(of_values)(values)
    norms, loose = _loose(statistics.root)
    alive = statistics.alive[statistics.alive < count]
    estimates = {}
    for name, value in at.items():
        slope = np.zeros(len(statistics.alive))
        slope[: len(alive)] = np.asarray(slopes[name], dtype=float)[alive]
        if not np.any(slope) and name in units:
            continue
        along = loose @ (slope / norms)
        determined = np.linalg.norm(along) <= _ROUNDING * np.linalg.norm(slope / norms)
        error = float(np.sqrt(slope @ statistics.covariance @ slope)) if determined else None
        others = ", ".join(statistics.labels[i] for i in statistics.alive[slope != 0])
        said = f"follows from {others}" if determined else f"not determined by {others}"
        declaration = Declaration(0.0, unit=units.get(name, ""), doc=name)
        if name in followers:
            part, tie = followers[name]
            declaration = find(model, part).declaration
            said = f"tied: {tie.expression.text}" + ("" if determined else f"; {said}")
        estimates[name] = Estimate(
            value=float(value),
            standard_error=finite_or_none(error if np.any(slope) else None),
            unit=declaration.unit,
            lower=finite_or_none(declaration.lower),
            upper=finite_or_none(declaration.upper),
            free=True,
            remark=said,
        )
    return estimates


def derived_quantities(problem: Problem, values: np.ndarray) -> Callable[[Array], dict[str, Array]]:
    """What follows from the parameters, by name as of `derived_estimates`, as a function of them.

    Arguments:
        problem: what was minimised.
        values: of all free parameters where the fit ended: tied elements that are equal there are
            one.

    Returns:
        A function of the first `problem.shared` values, which JAX differentiates.
    """
    model = problem.with_values(problem.means(values[: problem.shared]))
    followers = _followers(model, problem.ties)

    def quantities(values: Array) -> dict[str, Array]:
        model = problem.with_values(problem.means(values))
        tied = {path: get(model, part) for path, (part, _) in followers.items()}
        return {**tied, **{name: d.value for name, d in model.derived().items()}}

    return quantities


def derived_quantity(
    problem: Problem, values: np.ndarray, name: str
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """One of them as a function of all free parameters: its value and its gradient.

    Arguments:
        problem, values: as of `derived_quantities`.
        name: of the quantity.

    Raises:
        InputError: there is none of this name.
    """
    shared, of_values = problem.shared, derived_quantities(problem, values)
    if name not in jax.eval_shape(of_values, jnp.asarray(values[:shared])):
        raise InputError(f"'{name}' does not follow from what was free in this fit")
    compiled = jax.jit(jax.value_and_grad(lambda shared: of_values(shared)[name]))

    def quantity(values: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = compiled(on_device(values[:shared], jnp.result_type(float)))
        gradient = np.zeros(len(values))
        gradient[:shared] = slope
        return float(value), gradient

    return quantity


def with_tied(
    estimates: dict[str, Estimate], derived: Mapping[str, Estimate], ties: Sequence[Tie]
) -> dict[str, Estimate]:
    """The estimates of parameters, in which the tied ones have the errors that follow for them.

    Arguments:
        estimates: by path.
        derived: what follows from the free parameters, the tied ones among it.
        ties: of the fit.
    """
    tied = {tie.path: tie.expression.text for tie in ties if tie.path in estimates}
    remarked = {
        path: dataclasses.replace(estimates[path], remark=f"tied: {text}")
        for path, text in tied.items()
    }
    single = {
        path: dataclasses.replace(derived[path], free=False)
        for path in tied
        if path in derived and not isinstance(estimates[path].value, list)
    }
    return {**estimates, **remarked, **single}


def _loose(root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Norms of the columns of R, and the directions of the normalised ones that show nowhere."""
    norms = np.linalg.norm(root, axis=0)
    if not len(norms):
        return norms, np.zeros((0, 0))
    _, singular, right = np.linalg.svd(np.linalg.qr(root / norms, mode="r"))
    return norms, right[singular < COLLINEAR * singular[0]]


def _followers(model: AbstractModel, ties: Sequence[Tie]) -> dict[str, tuple[str, Tie]]:
    """By the name to show, the path of a tied parameter or element, and its tie.

    Elements that are tied to the same value are one.
    """
    followers: dict[str, tuple[str, Tie]] = {}
    for tie in ties:
        same = len({float(get(model, part)) for part in tie.elements}) == 1
        shown = [(tie.path, tie.elements[0])] if same else [(p, p) for p in tie.elements]
        followers |= {name: (part, tie) for name, part in shown}
    return followers
