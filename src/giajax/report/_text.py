"""A result as text: the table of parameters and a summary."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np

from ..fitting import (
    FitResult,
    HeldOut,
    PredictionErrors,
    RunFit,
    estimate_table,
    in_column_units,
    units_note,
)
from ..models import capabilities
from ..runtime.text import format_number, wrapped
from ..studies import SAME_END, distinct_optima, lost_starts, misfit

_Run = TypeVar("_Run", RunFit, PredictionErrors, HeldOut)

RESULT = "result.json"
PAGE = "report.html"

MOST_RUNS = 6
"""Maximum number of runs that are drawn. Each picture takes about a second."""


def worth_drawing(result: FitResult) -> list[int]:
    """Return the numbers of all runs or, with many, of those with the largest residuals."""
    worst = sorted(range(len(result.runs)), key=lambda index: -times_noise(result.runs[index]))
    return sorted(worst[:MOST_RUNS])


def times_noise(record: RunFit, names: Iterable[str] | None = None) -> float:
    """Return the largest RMSE / noise of some or all channels; infinite if one is not finite."""
    channels = [record.channels[name] for name in (record.channels if names is None else names)]
    ratios = [
        math.inf if c.rmse is None else c.rmse / c.compared_noise if c.compared_noise else 0.0
        for c in channels
    ]
    return max(ratios, default=0.0)


# Without one of two equal recordings, errors are 1.4 times as large. A larger factor is reported.
_NOTABLE = 2.0

# A larger factor is not shown: the recording is then practically the only source.
_LARGE = 1000.0


def source_lines(result: FitResult) -> list[str]:
    """Return a line for each recording that determines a parameter almost alone.

    An example is `bench: only source of information on alpha.offset`.
    """
    alone: dict[str, list[str]] = {}
    mostly: dict[str, list[str]] = {}
    for path, estimate in result.free.items():
        for recording, factor in estimate.sources.items():
            if factor is None:
                alone.setdefault(recording, []).append(path)
            elif factor > _NOTABLE:
                times = f"over {_LARGE:.0f}" if factor > _LARGE else f"{factor:.2g}"
                mostly.setdefault(recording, []).append(f"{path} ({times})")
    lines = []
    for recording in dict.fromkeys([*alone, *mostly]):
        said = {"only source of information on": alone.get(recording)}
        said["factor by which errors increase without this recording:"] = mostly.get(recording)
        parts = [f"{words} {', '.join(paths)}" for words, paths in said.items() if paths]
        lines.append(f"{recording}: {'; '.join(parts)}")
    return lines


def _by_unit(run: RunFit | PredictionErrors | HeldOut) -> dict[str, list[str]]:
    """Return the names of the channels of each unit, in the form that follows a number."""
    by_unit: dict[str, list[str]] = {}
    for name, channel in run.channels.items():
        by_unit.setdefault(_unit(channel.unit), []).append(name)
    return by_unit


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _held_out(record: HeldOut) -> list[str]:
    """Return lines on the prediction errors of the held-out part of a run."""
    lines = []
    for unit, names in _by_unit(record).items():
        channels = [record.channels[name] for name in names]
        errors = _range([channel.rmse for channel in channels]) or "not known"
        if len(names) <= 4:
            each = [f"{n} {_range([record.channels[n].rmse]) or 'not known'}" for n in names]
            errors = ", ".join(each)
        sizes = _range([channel.size for channel in channels])
        expected = "the error expected from noise and parameter uncertainty"
        allowed = f"; {sizes} times {expected}" if sizes else ""
        counts = _counts(names, sum(channel.n for channel in channels))
        lines.append(f"{record.name}: RMSE {errors}{unit}{allowed}; {counts}")
    return lines


def _counts(names: Sequence[str], values: int) -> str:
    return f"{len(names)} channel{'s' * (len(names) > 1)}, {values} values"


def _range(values: Sequence[float | None], digits: int = 3) -> str:
    """Return the range of the known finite values as text; empty if there are none."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    if not known:
        return ""
    low, high = f"{min(known):.{digits}g}", f"{max(known):.{digits}g}"
    return low if low == high else f"{low} to {high}"


def _verdict(result: FitResult) -> list[str]:
    """Return the verdict on the model, and a line for each reason why it is inadequate."""
    verdict = result.verdict
    if not verdict.reasons:
        return [verdict.status]
    first, *others = (reason.sentence for reason in verdict.reasons)
    return [f"{verdict.status}: {first}", *others]


def _noise(result: FitResult) -> list[str]:
    """Return a line on the correlated noise and its effect on the standard errors."""
    if result.noise is None or not result.noise.widening:
        return []
    channels = [pair for run in result.runs for pair in run.channels.items()]
    correlated = [(name, channel) for name, channel in channels if channel.correlated]
    span = _range([channel.correlation_time_s for _, channel in correlated], 2)
    names, every = (len({name for name, _ in pairs}) for pairs in (correlated, channels))
    sentence = f"correlated over {span} s in {names} of {every} channels"
    if trends := result.noise.trends:
        sentence += (
            f"; the correlation of {', '.join(trends[:4])}{', ...' * (len(trends) > 4)} extends "
            "over at least half of the recording: the model lacks a trend, or the stated noise is "
            "too large; the standard errors are not reduced by this correlation"
        )
    if factors := _range(list(result.noise.widening.values()), 2):
        sentence += (
            f"; the standard errors are {factors} times the standard errors for white noise of "
            "the same size"
        )
    return [sentence]


_MANY = 8  # more lines on residuals are summarised
_LABEL = 20  # width of the labels of a summary


def parameter_table(result: FitResult, width: int | None = None) -> str:
    """Return the free and held parameters: value, standard error, unit, bounds and remark.

    If the remarks do not fit into `width` columns, each is below its row. Without a width nothing
    is wrapped, so each row is one line for grep and awk.
    """
    return estimate_table(in_column_units(result.shown, result.model), width)


def summary(result: FitResult, width: int | None = None) -> str:
    """Return how the fit ended, how well it describes the data, and its conditions.

    Without a width, which is the number of columns, nothing is wrapped.
    """
    rows = summary_rows(result)
    lines = (wrapped(text, width, name.ljust(_LABEL), " " * _LABEL) for name, text in rows)
    return "\n".join(line for each in lines for line in each)


def summary_rows(result: FitResult) -> list[tuple[str, str]]:
    """Return the summary as pairs of a label (which may be empty) and a sentence."""
    rows = [("status", result.headline)]

    def add(label: str, texts: Iterable[str]) -> None:
        for index, text in enumerate(texts):
            rows.append(("" if index else label, text))

    add("units", [note] if (note := units_note(result.shown, result.model)) else [])
    add("verdict", _verdict(result))
    add("noise", _noise(result))
    for label, number in (("cost", result.cost), ("reduced chi-square", result.reduced_chi_square)):
        add(label, [format_number(number, missing="not finite")])
    add("starts", _starts(result))
    add("residuals", _of_runs(result.runs, _residuals, "residuals of"))
    own = list(filter(None, (run.parameters.keys() - result.free for run in result.runs)))
    if own:
        text = f"{sum(map(len, own))} values of {len(own)} individual runs were also fitted"
        add("initial states", [f"{text}; result.json lists them"])
    add("validation", _of_runs(result.validation, _errors, "prediction of"))
    add("held out", _of_runs(result.held_out, _held_out, "prediction of"))
    add("determined by", source_lines(result))
    if strongest := strongest_correlation(result):
        correlation, one, other = strongest
        add("correlation", [f"strongest: {correlation:+.3f}, between {one} and {other}"])
    add("findings", [f"{f.sentence}: {f.advice} ({f.page})" for f in result.findings])
    add("gradient check", [_gradient(result)])
    add("solver tolerance", [_tolerance(result)])
    add("conditions", result.conditions)
    took, compiling = (
        format_number(s, ".2g") for s in (result.seconds.run, result.seconds.compile)
    )
    add("time", [f"{took} s to run, and {compiling} s to compile or load"])
    return rows


def _starts(result: FitResult) -> list[str]:
    """Return lines on the initial guesses: those that reached the result, others, and failures."""
    if not result.starts:
        return []
    best = misfit(result)
    values = sum(channel.n for run in result.runs for channel in run.channels.values())
    ends = [start.misfit for start in result.starts if start.misfit is not None]
    near = sum(end - best < SAME_END * values for end in ends)
    text = f"{near} of {len(result.starts)} ended at this optimum"
    worse = sorted((end - best) / values for end in ends if end - best >= SAME_END * values)
    if worse:
        text += (
            f"; the log-likelihood per value of the other starts is lower by {worse[0]:.2g} to "
            f"{worse[-1]:.2g}"
        )
    lines = [text]
    others = [optimum for optimum in distinct_optima(result) if not optimum.is_result]
    for optimum in others[:_MANY]:
        where = ", ".join(f"{path} {value:.4g}" for path, value in optimum.values.items())
        who = "1 start" if optimum.reached == 1 else f"{optimum.reached} starts"
        lines.append(
            f"{who} reached another optimum, whose log-likelihood is lower by "
            f"{optimum.worse:.3g}: {where} (SI units)"
        )
    return lines + [
        f"{count} did not converge: {why}" for why, count in lost_starts(result).items()
    ]


def _of_runs(runs: Sequence[_Run], of_one: Callable[[_Run], list[str]], what: str) -> list[str]:
    """Return the lines of each run; with many, a line per channel with the range of the RMSE."""
    each = [line for run in runs for line in of_one(run)]
    if len(each) <= _MANY:
        return each
    table: dict[tuple[str, str], list[float]] = {}
    for run in runs:
        for name, channel in run.channels.items():
            if channel.rmse is not None:
                table.setdefault((name, channel.unit), []).append(channel.rmse)
    lines = []
    for (name, unit), values in table.items():
        low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
        shown = f"{_rmse(low)} to {_rmse(high)}, median {_rmse(middle)}"
        lines.append(f"{what} {len(values)} runs: {name} RMSE {shown}{_unit(unit)}")
    return lines


def _errors(run: PredictionErrors) -> list[str]:
    """Return lines with the RMSE of the prediction of a run that was not fitted."""
    lines = []
    for unit, names in _by_unit(run).items():
        shown = ", ".join(f"{name} {_rmse(run.channels[name].rmse)}" for name in names)
        lines.append(f"{run.name}: RMSE {shown}{unit}")
    return lines


def _rmse(value: float | None) -> str:
    return format_number(value, ".3g", "not finite")


_WEIGHTED = 1.1  # a larger ratio of the noise in the weights to the white noise is reported


def _residuals(run: RunFit) -> list[str]:
    """Return lines on the residuals: for a few channels by channel, for many by unit."""
    channels = run.channels
    lines = []
    for unit, names in _by_unit(run).items():
        known = {name: rmse for name in names if (rmse := channels[name].rmse) is not None}
        noise = sorted({channels[name].compared_noise for name in names})
        weights = max(channels[name].noise / (channels[name].compared_noise or 1) for name in names)
        if len(names) <= 4:
            shown = ", ".join(f"{name} {_rmse(known.get(name))}" for name in names)
        elif known:
            worst = max(known, key=lambda name: known[name])
            best = min(known, key=lambda name: known[name])
            shown = f"{_rmse(known[best])} ({best}) to {_rmse(known[worst])} ({worst})"
        else:
            shown = "not finite"
        against = f"{noise[0]:.3g}" + (f" to {noise[-1]:.3g}" if noise[-1] > noise[0] else "")
        if weights > _WEIGHTED:
            against += (
                f" from sample to sample, and up to {weights:.3g} times this noise in the weights "
                "of the fit"
            )
        counts = _counts(names, sum(channels[name].n for name in names))
        lines.append(f"{run.name}: RMSE {shown}{unit}; noise {against}; {counts}")
    return lines


def strongest_correlation(result: FitResult) -> tuple[float, str, str] | None:
    """Return the largest correlation and its two parameters; None if there is none."""
    paths = result.correlation.parameters
    pairs = [
        (abs(correlation), correlation, paths[j], paths[i])
        for i, row in enumerate(result.correlation.matrix)
        for j, correlation in enumerate(row[:i])
        if correlation is not None
    ]
    return max(pairs)[1:] if pairs else None


def correlation_text(value: float) -> str:
    """Return a correlation with two digits, or with three if two would round to one."""
    return "?" if math.isnan(value) else f"{value:.{3 if abs(value) >= 0.995 else 2}f}"


# A fit whose derivatives have this relative error may stop anywhere. Usual errors in 64-bit
# arithmetic are 1e-5.
WRONG_DERIVATIVES = 1e-2


def _gradient(result: FitResult) -> str:
    check = result.gradient_check
    if check is None:
        return "not done"
    relative = check.relative_difference
    if relative > WRONG_DERIVATIVES:
        text = f"derivatives DISAGREE with finite differences, by {relative:.1e} (relative)"
    else:
        text = f"derivatives agree with finite differences to {relative:.1e} (relative)"
    return text + (f", without {', '.join(check.left_out)}" if check.left_out else "")


def _tolerance(result: FitResult) -> str:
    effect, integration = result.tolerance_effect, result.integration
    which = ""
    if integration is not None:
        chosen = ", chosen automatically" if integration.chosen else ""
        which = f"{integration.tolerance:.0e} of {integration.solver}{chosen}; "
    if capabilities.refined(result.model, 1.0) is None:
        return f"{which}not checked: the {result.model.kind} model cannot be refined"
    if effect is None or effect.largest_in_standard_errors is None:
        return f"{which}effect unknown"
    finer = {0.5: "half", 0.1: "a tenth"}.get(effect.factor, "a hundredth")
    largest = effect.largest_in_standard_errors
    return (
        f"{which}{finer} of this tolerance changes no parameter by more than {largest:.1e} "
        "standard errors"
    )
