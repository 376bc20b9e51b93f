"""Comparison of several results: their parameters, and which of them fits the data best."""

import dataclasses
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..fitting import Estimate, FitResult, RunFit, in_column_units
from ._starts import misfit


def obstacles(results: Sequence[FitResult], names: Sequence[str]) -> list[str]:
    """Return sentences on why likelihoods of results cannot be compared with the first result's."""
    said, first = [], results[0]
    assumed = [_assumed(result) for result in results]
    for result, name, others in zip(results[1:], names[1:], assumed[1:], strict=True):
        if not all(run.sha256 for run in (*first.runs, *result.runs)):
            said.append(
                f"{names[0]} or {name} was fitted to a run without a file, so it is unknown "
                "whether their data are the same: chi-square and BIC cannot be compared"
            )
        elif _data(first) != _data(result):
            said.append(
                f"{names[0]} and {name} were fitted to different data: chi-square and BIC cannot "
                "be compared, but parameters can"
            )
        elif differing := [what for what, mine in assumed[0].items() if others[what] != mine]:
            said.append(
                f"{names[0]} and {name} differ in the assumed {' and '.join(differing)}: "
                "chi-square, BIC and standard errors cannot be compared"
            )
    for result, name in zip(results, names, strict=True):
        if result.status != "converged":
            said.append(f"{name} has not converged: its estimates are not at an optimum")
    return said


def _data(result: FitResult) -> list[Any]:
    """Return the fitted data: files, windows, channels and the number of values of each channel."""
    return sorted(
        (*_place(run, about), sorted((name, c.n) for name, c in run.channels.items()))
        for run, about in _described(result)
    )


def _described(result: FitResult) -> list[tuple[RunFit, dict[str, Any]]]:
    """Return the runs with their entries in the configuration; an entry may be empty."""
    said = [*result.config.get("runs", []), *({} for _ in result.runs)]
    return list(zip(result.runs, said, strict=False))


def _place(run: RunFit, about: dict[str, Any]) -> tuple[str, float]:
    """Return the file and window of a run, by which runs are sorted before a comparison."""
    return str(run.sha256), about.get("from_s") or 0.0


def _assumed(result: FitResult) -> dict[str, str]:
    """Return the assumptions, as text, that must agree if likelihoods are compared."""
    config = result.config
    ordered = sorted(_described(result), key=lambda described: _place(*described))
    stated = [about.get("noise") for _, about in ordered]
    assumed = {
        "noise": [stated, config.get("noise_model"), config.get("noise_per_run")],
        "loss": config.get("loss"),
        "prior": config.get("priors") or None,
    }
    return {what: json.dumps(value, sort_keys=True) for what, value in assumed.items()}


@dataclasses.dataclass(frozen=True)
class ContrastRow:
    """One parameter in several results, in the units of their columns.

    Attributes:
        path: path of the parameter.
        unit: unit of the parameter; empty if it has none.
        estimates: estimate in each result; None if its model does not have the parameter, or has it
            in another unit.
        differences: difference of each result from the first, divided by the combined standard
            error, as if the noise of both were independent; None unless both results determine the
            parameter.
    """

    path: str
    unit: str
    estimates: tuple[Estimate | None, ...]
    differences: tuple[float | None, ...]


@dataclasses.dataclass(frozen=True)
class ContrastColumn:
    """Summary of one result.

    Attributes:
        name: name of the result.
        model: kind of the model.
        status: how the fit ended.
        verdict: whether the model describes the data.
        values: number of fitted values.
        parameters: number of fitted parameters, including those of single runs.
        reduced_chi_square: reduced chi-square of the fit.
        bic: Schwarz's (Bayesian) information criterion minus the smallest among the results, from
            minus twice the log-likelihood; None if the likelihoods cannot be compared.
        held_out: largest ratio of held-out error to expected error (`size`) among the held-out
            channels; None without any.
    """

    name: str
    model: str
    status: str
    verdict: str
    values: int
    parameters: int
    reduced_chi_square: float | None
    bic: float | None
    held_out: float | None


@dataclasses.dataclass(frozen=True)
class Contrast:
    """Comparison of several results.

    Attributes:
        columns: summaries of the results.
        rows: parameters that were fitted in at least one result.
        notes: sentences on why results cannot be compared, and on how to read the differences.
    """

    columns: tuple[ContrastColumn, ...]
    rows: tuple[ContrastRow, ...]
    notes: tuple[str, ...]


def contrast(results: Sequence[FitResult], names: Sequence[str]) -> Contrast:
    """Compare at least two results without fitting or predicting anything.

    Differences are relative to the first result. BIC is given only if the fits have the same
    values, noise and loss.

    Example:
        >>> found = contrast([load_result("a"), load_result("b")], ["a", "b"])  # doctest: +SKIP
    """
    tables = [
        in_column_units({**result.parameters, **result.shown}, result.model) for result in results
    ]
    paths = dict.fromkeys(path for result in results for path in result.shown)
    notes = obstacles(results, names)
    sizes = [(_values(result), _parameters(result)) for result in results]
    by_likelihood = [
        math.nan if notes else 2 * misfit(result) + parameters * math.log(max(values, 1))
        for result, (values, parameters) in zip(results, sizes, strict=True)
    ]
    least = min(by_likelihood)
    columns = tuple(
        ContrastColumn(
            name=name,
            model=result.model.kind,
            status=result.status,
            verdict=result.verdict.status,
            values=values,
            parameters=parameters,
            reduced_chi_square=result.reduced_chi_square,
            bic=bic - least if math.isfinite(bic) and math.isfinite(least) else None,
            held_out=_held_out(result),
        )
        for name, result, (values, parameters), bic in zip(
            names, results, sizes, by_likelihood, strict=True
        )
    )
    shared = {sha for run in results[0].runs if (sha := run.sha256)}
    if any(shared & {run.sha256 for run in result.runs} for result in results[1:]):
        notes.append(
            "results from the same recording share its noise, so a difference between them is more "
            "significant than the number of standard errors suggests"
        )
    return Contrast(columns, tuple(_row(path, tables) for path in paths), tuple(notes))


def _row(path: str, tables: Sequence[dict[str, Estimate]]) -> ContrastRow:
    found = [table.get(path) for table in tables]
    unit = next(one.unit for one in found if one is not None)
    first, *rest = (one if one is not None and one.unit == unit else None for one in found)
    differences = (None, *(_difference(first, one) for one in rest))
    return ContrastRow(path, unit, (first, *rest), differences)


def _difference(first: Estimate | None, other: Estimate | None) -> float | None:
    if first is None or other is None or not (first.standard_error and other.standard_error):
        return None
    return float((other.value - first.value) / np.hypot(first.standard_error, other.standard_error))


def _values(result: FitResult) -> int:
    return sum(channel.n for run in result.runs for channel in run.channels.values())


def _parameters(result: FitResult) -> int:
    own = [(path, one) for run in result.runs for path, one in run.parameters.items()]
    # A group of runs shares one value, which is stored with each of its runs. A fitted initial
    # state belongs to one run.
    shared = {(path, one) for path, one in own if path in result.free}
    states = [path for path, _ in own if path not in result.free]
    return len(result.free.keys() - {path for path, _ in shared}) + len(shared) + len(states)


def _held_out(result: FitResult) -> float | None:
    sizes = [channel.size for record in result.held_out for channel in record.channels.values()]
    return max((size for size in sizes if size is not None), default=None)
