"""Checks at the end of a fit: its derivatives, a finer tolerance, and how straight it all is."""

import dataclasses
from typing import NamedTuple

import numpy as np

from ._curvature import Curvature, curvatures
from ._records import GradientCheck, Shift, ToleranceEffect, finite_or_none
from ._state import FitState
from ._statistics import Statistics
from ._tolerance import finer_factor, residual_change
from ._transitions import evaluate, has_many_rows, residuals_at, tolerance_of

# Differences in the free coordinate, central where not said otherwise, at a tolerance where the
# steps of the integrator do not show: truncation and noise are then both near 1e-8.
_DIFFERENCE = 1e-4
_DIFFERENCE_32 = 3e-2
_FINER = 1e-3

# A response smaller than this part of that of all runs is rather noise.
_TOLD = 1e-3
_FINE = 1e-9


class Checks(NamedTuple):
    """All checks, None or nothing where one could not be done, and whether Ctrl-C came between."""

    gradient: GradientCheck | None
    tolerance: ToleranceEffect | None
    curvatures: dict[int, Curvature]
    interrupted: bool


def checks(state: FitState, statistics: Statistics) -> Checks:
    """The checks of a fit; it is done, and worth keeping, when Ctrl-C comes here."""
    gradient = tolerance = None
    bent: dict[int, Curvature] = {}
    try:
        gradient = gradient_check(state, statistics)
        tolerance = tolerance_effect(state, statistics)
        bent = curvatures(state, statistics)
    except KeyboardInterrupt:
        return Checks(gradient, tolerance, bent, interrupted=True)
    return Checks(gradient, tolerance, bent, interrupted=False)


def gradient_check(state: FitState, statistics: Statistics) -> GradientCheck | None:
    """The Jacobian against a difference at the optimum, at a finer tolerance.

    One direction in which every parameter has the same weight in the residual: a wrong column
    of any of them shows. Parameters at a bound take no part, because there is nothing beyond it
    to take a difference with, nor do those that nothing responds to where they ended. Of many runs
    with the same channels, whose derivatives are one program, a few are looked at. Of recordings
    with many rows the tolerance is that of the fit, and in 64 bit the difference is to one side:
    the steps of the integrator then show, by some 1e-4, but a wrong column still does, and the
    finer Jacobian would take as long as the fit.

    Arguments:
        state: the last one.
        statistics: of the fit.

    Returns:
        None where no parameter is left, or a simulation beside the optimum failed.
    """
    tolerance = tolerance_of(state)
    known_here = tolerance is not None and has_many_rows(state)
    centre, problem = np.asarray(state.coordinate), state.problem
    offset = _DIFFERENCE if centre.dtype == np.float64 else _DIFFERENCE_32
    if known_here:
        jacobian = state.jacobian()
    else:
        finer = _FINER if tolerance is None else min(_FINER, _FINE / tolerance)
        problem = dataclasses.replace(problem, model=problem.model.refined(finer))
        jacobian = state.jacobian(evaluate(state, centre, problem, sample=True))
    norms = jacobian.norms()
    takes_part = np.zeros(problem.size, bool)
    takes_part[statistics.alive] = True
    takes_part[list(statistics.bounds)] = False
    # Beyond a bound there is nothing to take a difference with.
    first, last = problem.bijector.ends()
    # Of few runs, one that hardly responds to a parameter says nothing of its derivative.
    told = norms > _TOLD * state.jacobian().norms()
    takes_part &= told & (centre - first > offset) & (np.asarray(last) - centre > offset)
    if not np.any(takes_part):
        return None
    weakest = np.min(norms[takes_part])
    # The strongest response gets the smallest offset; the weakest parameter moves by the step.
    direction = np.divide(weakest, norms, out=np.zeros_like(norms), where=takes_part)

    def at(shift: float) -> np.ndarray:
        return residuals_at(state, centre + shift * direction, problem, sample=not known_here)

    if known_here and centre.dtype == np.float64:
        by_difference = (at(offset) - np.asarray(state.inner.residual)) / offset
    else:
        by_difference = (at(offset) - at(-offset)) / (2 * offset)
    by_autodiff = jacobian.times(direction)
    relative = np.linalg.norm(by_autodiff - by_difference) / np.linalg.norm(by_autodiff)
    if not np.isfinite(relative):
        return None
    known = statistics.labels[: problem.shared]
    # The same program differentiates by the value that a parameter has in other runs.
    elsewhere = ~told
    elsewhere[list(statistics.bounds)] = False
    for places in map(list, problem.positions):
        takes_part[places] |= np.any(takes_part[places]) & elsewhere[places]
    return GradientCheck(
        relative_difference=float(relative),
        direction=dict(zip(known, direction.tolist(), strict=False)),
        step=offset,
        left_out=tuple(path for path, there in zip(known, takes_part, strict=False) if not there),
    )


def tolerance_effect(state: FitState, statistics: Statistics) -> ToleranceEffect | None:
    """How far the optimum moves, to first order, with a finer solver tolerance.

    A hundredth of it, or a tenth for recordings with many rows; of a model that has no tolerance,
    but steps of its own, half of those.

    Arguments:
        state: the last one.
        statistics: of the fit.

    Returns:
        None where no parameter is determined, or the finer simulation fails.
    """
    determined = list(statistics.determined)
    if not determined:
        return None
    change = residual_change(state)
    if not np.all(np.isfinite(change)):
        return None
    jacobian = state.natural_jacobian()
    gram = np.linalg.pinv(jacobian.reduced()[:, determined])
    shifts = -gram @ (gram.T @ jacobian.transposed_times(change)[determined])
    by_parameter = {}
    largest = 0.0
    for index, shift in zip(determined, shifts.tolist(), strict=True):
        error = statistics.standard_errors[index]
        relative = abs(shift) / error if error else np.inf
        largest = max(largest, relative)
        by_parameter[statistics.labels[index]] = Shift(
            finite_or_none(shift), finite_or_none(relative)
        )
    return ToleranceEffect(finer_factor(state), finite_or_none(largest), by_parameter)
