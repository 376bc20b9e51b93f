"""Quantities derived from the parameters, with their standard errors.

A quantity may be determined although its parameters are not: if two parameters affect the data only
through their product, the product is determined. To first order, a quantity is determined if its
gradient has no component in the directions that leave every residual unchanged. Any generalised
inverse of J^T J then gives its variance (C. R. Rao, "Linear Statistical Inference", 2nd ed., 1973,
section 4a).
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models import AbstractModel, capabilities
from ..recordings import Channel, Run, parse_column
from ..runtime.arrays import Array, on_device
from ..runtime.parallel import Batch, run_on_all_cores, tangents_in_parts
from ..runtime.programs import program
from ..runtime.records import finite_or_none
from ..runtime.text import InputError
from ..schema import QUANTITIES, Declaration
from ..schema.parameters import declared, find, get, left_out, replace
from ._configuration import Tie, tied
from ._estimates import unit_and_bounds
from ._problem import Problem, batch_members, chunk_size, prepared_with, stacked
from ._records import Estimate
from ._statistics import Statistics
from ._uncertainty import COLLINEAR

# Placeholders in declarations for the units of the columns to which a model was fitted.
_WORDS = ("input", "output")


class _Unit(NamedTuple):
    """Factor that converts an SI value to a unit, and the name of the unit."""

    factor: float
    name: str


def in_column_units(estimates: Mapping[str, Estimate], model: AbstractModel) -> dict[str, Estimate]:
    """Convert estimates (SI) with errors and bounds to the units of the fitted columns.

    The conversion applies to units that consist of "input" and "output", such as those of a
    hysteresis operator, if the model knows its columns. All other estimates stay in SI units.
    """
    units = _recorded(_columns(model))
    return {path: _converted(estimate, units) for path, estimate in estimates.items()}


def column_factors(model: AbstractModel) -> dict[str, float]:
    """Return the factor by which `in_column_units` multiplies each parameter, by path."""
    units = _recorded(_columns(model))
    return {path: _unit(unit, units).factor for path, unit in _declared_units(model).items()}


def units_in_si(model: AbstractModel) -> dict[str, str]:
    """Return the SI unit of each parameter, by path, including parameters that the model omits.

    If the model knows its columns, a unit that consists of "input" and "output" is expressed in the
    SI units of these columns.
    """
    units = {word: _Unit(1.0, channel.si_unit) for word, channel in _columns(model).items()}
    return {path: _unit(unit, units).name for path, unit in _declared_units(model).items()}


def units_note(estimates: Mapping[str, Estimate], model: AbstractModel) -> str:
    """Return a sentence on the units if `in_column_units` changes numbers, otherwise ""."""
    columns = _columns(model)
    units = _recorded(columns)
    factors = {_unit(estimate.unit, units).factor for estimate in estimates.values()}
    if factors <= {1.0}:
        return ""
    names = " and ".join(channel.column for channel in columns.values())
    return f"those of {names}; result.json, --start and --fix use SI units"


def _columns(model: AbstractModel) -> dict[str, Channel]:
    facts = model.definition()
    named = {word: facts.get(f"{word}_column") for word in _WORDS}
    return {word: parse_column(column) for word, column in named.items() if column}


def _declared_units(model: AbstractModel) -> dict[str, str]:
    known = {**declared(model), **left_out(model)}
    return {path: parameter.declaration.unit for path, parameter in known.items()}


def _recorded(columns: Mapping[str, Channel]) -> dict[str, _Unit]:
    """Return the units in which the columns are recorded."""
    return {
        word: _Unit(
            float(channel.from_si(1.0)), QUANTITIES[channel.quantity].suffixes[channel.unit]
        )
        for word, channel in columns.items()
    }


def _converted(estimate: Estimate, units: Mapping[str, _Unit]) -> Estimate:
    factor, unit = _unit(estimate.unit, units)
    if unit == estimate.unit:
        return estimate

    def scaled(value: Any) -> Any:
        return None if value is None else (np.asarray(value, dtype=float) * factor).tolist()

    names = ("value", "standard_error", "lower", "upper")
    numbers = {name: scaled(getattr(estimate, name)) for name in names}
    return dataclasses.replace(estimate, unit=unit, **numbers)


def _unit(unit: str, units: Mapping[str, _Unit]) -> _Unit:
    """Return a unit with "input" and "output" replaced by the units of these columns."""
    above, _, below = unit.partition("/")
    words = {above, below} & set(_WORDS)
    if not words or not words <= set(units):
        return _Unit(1.0, unit)
    up = units.get(above, _Unit(1.0, "" if above == "1" else above))
    down = units.get(below, _Unit(1.0, below))
    factor = up.factor / down.factor
    if up.name == down.name:
        return _Unit(factor, "")
    if not down.name:
        return _Unit(factor, up.name)
    return _Unit(factor, f"{_bracketed(up.name) or 1}/{_bracketed(down.name)}")


def _bracketed(unit: str) -> str:
    return f"({unit})" if "/" in unit or " " in unit else unit


_Followers = dict[str, tuple[str, Tie]]

_ROUNDING = 1e-5  # part of a gradient in undetermined directions that is rounding


def derived_estimates(problem: Problem, statistics: Statistics) -> dict[str, Estimate]:
    """Return the estimates of the quantities that depend on the fitted parameters.

    Tied parameters are given by path, or by element if their elements differ. Derived quantities of
    the model are given by name, if they depend on a parameter to which a channel responds. If a
    parameter has a value for each group of runs, the mean of these values is used.
    """
    count = problem.shared
    model = problem.with_values(problem.means(statistics.values[:count]))
    units = {name: quantity.unit for name, quantity in capabilities.derived(model).items()}
    followers = _followers(model, problem.ties)
    if not units and not followers:
        return {}
    values = jnp.asarray(statistics.values[:count], dtype=jnp.result_type(float))
    at, slopes = _with_slopes(dataclasses.replace(problem, batches=()), followers, values)
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
            **unit_and_bounds(declaration),
            free=True,
            remark=said,
        )
    return estimates


def derived_quantities(problem: Problem, values: np.ndarray) -> Callable[[Array], dict[str, Array]]:
    """Return a function that computes the derived quantities from all shared values.

    The argument is the first `problem.shared` values, and the names are as in `derived_estimates`.
    Tied elements that are equal at `values` are one quantity. JAX can differentiate the function.
    """
    model = problem.with_values(problem.means(values[: problem.shared]))
    return functools.partial(_quantities, problem, _followers(model, problem.ties))


def _quantities(problem: Problem, followers: _Followers, values: Array) -> dict[str, Array]:
    model = problem.with_values(problem.means(values))
    tied = {path: get(model, part) for path, (part, _) in followers.items()}
    return {**tied, **{name: d.value for name, d in capabilities.derived(model).items()}}


@eqx.filter_jit  # one program instead of one for each operation
def _with_slopes(
    problem: Problem, followers: _Followers, values: Array
) -> tuple[dict[str, Array], dict[str, Array]]:
    of_values = functools.partial(_quantities, problem, followers)
    return of_values(values), jax.jacfwd(of_values)(values)


def derived_quantity(
    problem: Problem, values: np.ndarray, name: str
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """Return one derived quantity as a function of all free parameters, with its gradient.

    Raises:
        InputError: no derived quantity has this name.
    """
    shared, of_values = problem.shared, derived_quantities(problem, values)
    if name not in jax.eval_shape(of_values, jnp.asarray(values[:shared])):
        raise InputError(f"'{name}' is not derived from the free parameters of this fit")
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
    """Return the estimates of parameters, with the propagated errors of the tied ones."""
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
    """Return the column norms of R, and the directions without effect in normalised columns."""
    norms = np.linalg.norm(root, axis=0)
    if not len(norms):
        return norms, np.zeros((0, 0))
    _, singular, right = np.linalg.svd(np.linalg.qr(root / norms, mode="r"))
    return norms, right[singular < COLLINEAR * singular[0]]


def _followers(model: AbstractModel, ties: Sequence[Tie]) -> _Followers:
    """Return the path of a tied parameter or element and its tie, by the displayed name.

    Elements that are tied to the same value are displayed as one.
    """
    followers: _Followers = {}
    for tie in ties:
        same = len({float(get(model, part)) for part in tie.elements}) == 1
        shown = [(tie.path, tie.elements[0])] if same else [(p, p) for p in tie.elements]
        followers |= {name: (part, tie) for name, part in shown}
    return followers


# Responses of the predictions of a fitted model to any of its parameters, free or held.
#
# One compiled program computes the columns of all directions together. They do not include the loss
# and the noise of the fit, so the caller weights them. A direction changes a whole parameter by one
# unit, one of its elements, or all of its elements in proportion.


@dataclasses.dataclass(frozen=True)
class Direction:
    """Change of a parameter (its path) by a `step`, SI units, in the shape of the parameter."""

    path: str
    step: np.ndarray


@dataclasses.dataclass(frozen=True)
class Response:
    """Predictions of a model for one run, and their derivatives, in SI units.

    Attributes:
        channels: names in the order of the columns of the tables.
        predicted: predictions, shape (sample, channel).
        observed: recorded values, NaN where not measured, shape (sample, channel).
        columns: derivatives of the predictions along the directions, shape (sample, channel,
            direction).
        own: derivatives of the predictions with respect to the free parameters of this run alone,
            shape (sample, channel, own).
    """

    channels: tuple[str, ...]
    predicted: np.ndarray
    observed: np.ndarray
    columns: np.ndarray
    own: np.ndarray


def responses(
    model: AbstractModel,
    runs: Sequence[Run],
    directions: Sequence[Direction],
    own: Sequence[Mapping[str, float]] = (),
    *,
    values: Sequence[Mapping[str, float]] = (),
    ties: Sequence[Tie] = (),
) -> list[Response]:
    """Return the predictions and their derivatives at one point, for each run in order.

    Arguments:
        model: model at the point, with all parameters of the directions.
        runs: recorded runs.
        directions: directions of the derivatives. Without directions only predictions are computed,
            and also no derivatives with respect to the parameters of single runs.
        own: for each run, values of the free parameters of this run alone, by label. Missing values
            are as prepared.
        values: for each run, values of the model parameters that not all runs share, by path, with
            the same paths for all runs.
        ties: parameters that are computed from other parameters and change with them.

    Raises:
        InputError: the model cannot be evaluated at the point.
    """
    answers: dict[int, Response] = {}
    # The directions are sorted. Which parameters are fitted or held differs between fits, and the
    # same directions in another order would require another program.
    order = sorted(range(len(directions)), key=lambda index: _name(directions[index]))
    place = np.argsort(np.asarray(order, dtype=int))
    paths = tuple(directions[index].path for index in order)
    steps = tuple(jnp.asarray(directions[index].step, jnp.result_type(float)) for index in order)
    prepared = [prepared_with(model, run, own[i] if own else {}) for i, run in enumerate(runs)]
    for channels, sizes, members in batch_members(model, runs, prepared):
        inputs = stacked([prepared[i] for i in members])
        varied = tuple(values[0]) if values else ()
        changed = [[values[index][path] for path in varied] for index in members]
        rows = jnp.asarray(np.asarray(changed, dtype=float), jnp.result_type(float))
        lengths = np.asarray([len(runs[i].observations[channels[0]]) for i in members])
        shared = (model, paths, steps, channels, sizes, varied, tuple(ties))
        amounts = _amounts(paths, sizes)
        alone = len(members) == 1
        tangents = tangents_in_parts(amounts, 2 if alone and amounts >= _DEALT_OUT else 1)
        # Combine each run with each part of the tangents.
        parts = len(tangents)
        items = jax.tree.map(lambda leaf, n=parts: np.repeat(leaf, n, axis=0), (inputs, rows))
        items = (*items, np.tile(tangents, (len(members), 1, 1)))
        work = np.repeat(lengths, parts)
        batch = Batch(_respond, items, shared, work, chunk_size(len(work)))
        (answer,) = run_on_all_cores([batch])
        tables, blocks, successful = answer
        tables = tables[::parts]
        blocks = blocks.reshape(len(members), -1, *blocks.shape[2:])[:, :amounts]
        if not np.all(successful):
            first = jax.tree.map(lambda leaf: leaf[0], inputs)
            # The simulation may succeed, because derivatives may use different steps.
            ready = capabilities.for_derivatives(model, (*paths, *(path for path, _ in sizes)))
            why = capabilities.failure(ready, first)
            why = why or "one of its derivatives is not finite"
            raise InputError(f"the fitted model cannot be evaluated: {why}")
        for member, table, block in zip(members, tables, blocks, strict=True):
            observed = np.stack([runs[member].observations[c] for c in channels], axis=-1)
            count = len(observed)
            answers[member] = Response(
                channels=channels,
                predicted=table[:count],
                observed=observed,
                columns=np.moveaxis(block[place, :count], 0, -1),
                own=np.moveaxis(block[len(paths) :, :count], 0, -1),
            )
    return [answers[index] for index in range(len(runs))]


def _name(direction: Direction) -> tuple[str, tuple[float, ...]]:
    return direction.path, tuple(np.ravel(direction.step).tolist())


def _amounts(paths: tuple[str, ...], own: tuple[tuple[str, int], ...]) -> int:
    """Return the number of quantities with respect to which responses are differentiated."""
    return len(paths) + sum(size for _, size in own) if paths else 0


# From this number of amounts on, the derivatives of a single run are computed in two parts, one on
# each of two cores. The number does not depend on the machine, so programs and results are the same
# everywhere.
_DEALT_OUT = 16


@program
def _respond(
    prepared_runs: tuple[Any, Array, Array],
    model: AbstractModel,
    paths: tuple[str, ...],
    steps: tuple[Array, ...],
    channels: tuple[str, ...],
    own: tuple[tuple[str, int], ...],
    varied: tuple[str, ...],
    ties: tuple[Tie, ...],
) -> tuple[Array, Array, Array]:
    """Return tables (run, sample, channel), derivatives (run, tangent, sample, channel), status."""
    inputs, *others = prepared_runs
    count = _amounts(paths, own)
    differentiated = (*dict.fromkeys(paths), *(path for path, _ in own))
    ready = capabilities.for_derivatives(model, differentiated) if count else model

    def one(prepared: Any, row: Array, tangents: Array) -> tuple[Array, Array, Array]:
        there = replace(ready, {path: row[index] for index, path in enumerate(varied)})
        held = {path: get(there, path) for path in paths}

        def predicted(amounts: Array) -> tuple[Array, Array]:
            values = dict(held)
            for index, path in enumerate(paths):
                values[path] = values[path] + amounts[index] * steps[index]
            moved, start = prepared, len(paths)
            for path, size in own if count else ():
                value = get(prepared, path)
                change = amounts[start : start + size].reshape(value.shape)
                moved = replace(moved, {path: value + change})
                start += size
            table, successful = tied(replace(there, values), ties).predict(moved, channels)
            return jnp.stack([table[name] for name in channels], axis=-1), successful

        def push(tangent: Array) -> tuple[Array, Array, Array]:
            return jax.jvp(predicted, (still,), (tangent,), has_aux=True)

        if not count:
            table, successful = predicted(jnp.zeros(0))
            return table, jnp.zeros((0, *table.shape), table.dtype), successful
        still = jnp.zeros(count, jnp.result_type(float))
        table, block, successful = jax.vmap(push, out_axes=(None, 0, None))(tangents)
        return table, block, successful

    if jax.tree.leaves(inputs)[0].shape[0] == 1:
        result = one(*jax.tree.map(lambda leaf: leaf[0], (inputs, *others)))
        return jax.tree.map(lambda leaf: leaf[None], result)
    # The runs are evaluated one after the other, because each has its own steps. The program is
    # compiled once.
    return jax.lax.map(lambda each: one(*each), (inputs, *others))
