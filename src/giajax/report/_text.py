"""A result as text: the parameter table and what else a reader must know."""

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
"""How many are drawn: a picture takes a second, and twenty are too many to look at."""


def worth_drawing(result: FitResult) -> list[int]:
    """All runs, or of many those that are described worst, in their order."""
    worst = sorted(range(len(result.runs)), key=lambda index: -times_noise(result.runs[index]))
    return sorted(worst[:MOST_RUNS])


def times_noise(record: RunFit, names: Iterable[str] | None = None) -> float:
    """The largest RMSE over noise of some channels, or of all; infinite where one is not finite."""
    channels = [record.channels[name] for name in (record.channels if names is None else names)]
    ratios = [
        math.inf if c.rmse is None else c.rmse / c.compared_noise if c.compared_noise else 0.0
        for c in channels
    ]
    return max(ratios, default=0.0)


# Without one of two equal recordings errors are 1.4 times as large; more than this is worth a word.
_NOTABLE = 2.0

# A factor is shown up to here; beyond it hardly anything is known without the recording.
_LARGE = 1000.0


def source_lines(result: FitResult) -> list[str]:
    """A line for each recording that determines something which the others hardly do.

    Such as `bench: only source of information on alpha.offset`.
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
        said["factor on the errors without this recording:"] = mostly.get(recording)
        parts = [f"{words} {', '.join(paths)}" for words, paths in said.items() if paths]
        lines.append(f"{recording}: {'; '.join(parts)}")
    return lines


def _by_unit(run: RunFit | PredictionErrors | HeldOut) -> dict[str, list[str]]:
    """Names of the channels of each unit; the unit as it stands behind a number."""
    by_unit: dict[str, list[str]] = {}
    for name, channel in run.channels.items():
        by_unit.setdefault(_unit(channel.unit), []).append(name)
    return by_unit


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _held_out(record: HeldOut) -> list[str]:
    """How well what was held out of a run is predicted."""
    lines = []
    for unit, names in _by_unit(record).items():
        channels = [record.channels[name] for name in names]
        errors = _range([channel.rmse for channel in channels]) or "not known"
        if len(names) <= 4:
            each = [f"{n} {_range([record.channels[n].rmse]) or 'not known'}" for n in names]
            errors = ", ".join(each)
        sizes = _range([channel.size for channel in channels])
        allowed = f"; {sizes} times the error expected from noise and parameters" if sizes else ""
        counts = _counts(names, sum(channel.n for channel in channels))
        lines.append(f"{record.name}: RMSE {errors}{unit}{allowed}; {counts}")
    return lines


def _counts(names: Sequence[str], values: int) -> str:
    return f"{len(names)} channel{'s' * (len(names) > 1)}, {values} values"


def _range(values: Sequence[float | None], digits: int = 3) -> str:
    """The smallest and the largest of what is known and finite; empty where nothing is."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    if not known:
        return ""
    low, high = f"{min(known):.{digits}g}", f"{max(known):.{digits}g}"
    return low if low == high else f"{low} to {high}"


def _verdict(result: FitResult) -> list[str]:
    """Whether the model describes the data, and a line for each reason why it does not."""
    verdict = result.verdict
    if not verdict.reasons:
        return [verdict.status]
    first, *others = (reason.sentence for reason in verdict.reasons)
    return [f"{verdict.status}: {first}", *others]


def _noise(result: FitResult) -> list[str]:
    """What was taken for correlated noise, and what it does to the standard errors."""
    if result.noise is None or not result.noise.widening:
        return []
    channels = [pair for run in result.runs for pair in run.channels.items()]
    correlated = [(name, channel) for name, channel in channels if channel.correlated]
    span = _range([channel.correlation_time_s for _, channel in correlated], 2)
    names, every = (len({name for name, _ in pairs}) for pairs in (correlated, channels))
    sentence = f"correlated over {span} s in {names} of {every} channels"
    if trends := result.noise.trends:
        sentence += (
            f"; in {', '.join(trends[:4])}{', ...' * (len(trends) > 4)} over at least half of the "
            "record: the model lacks a trend, or the stated noise is too large; the standard "
            "errors are not reduced"
        )
    if factors := _range(list(result.noise.widening.values()), 2):
        sentence += (
            f"; the standard errors are {factors} times those of white noise of the same size"
        )
    return [sentence]


_MANY = 8  # more lines of residuals than this are summed up
_LABEL = 20  # width of the labels of a summary


def parameter_table(result: FitResult, width: int | None = None) -> str:
    """The free and the fixed parameters: value, standard error, unit, bounds and remark.

    Where the remarks do not fit into `width` columns, each goes below its row. Without a width
    nothing is wrapped: a row is a line, for grep and awk.
    """
    return estimate_table(in_column_units(result.shown, result.model), width)


def summary(result: FitResult, width: int | None = None) -> str:
    """How the fit ended, how well it describes the data, and what its values rest on.

    Without a width, the columns that there are, nothing is wrapped.
    """
    rows = summary_rows(result)
    lines = (wrapped(text, width, name.ljust(_LABEL), " " * _LABEL) for name, text in rows)
    return "\n".join(line for each in lines for line in each)


def summary_rows(result: FitResult) -> list[tuple[str, str]]:
    """The summary as pairs of a label (which may be empty) and a sentence."""
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
    """How many starts ended where the result is, which other optima there are, and what failed."""
    if not result.starts:
        return []
    best = misfit(result)
    values = sum(channel.n for run in result.runs for channel in run.channels.values())
    ends = [start.misfit for start in result.starts if start.misfit is not None]
    near = sum(end - best < SAME_END * values for end in ends)
    text = f"{near} of {len(result.starts)} ended at this optimum"
    worse = sorted((end - best) / values for end in ends if end - best >= SAME_END * values)
    if worse:
        text += f"; the others are worse by {worse[0]:.2g} to {worse[-1]:.2g} in log-likelihood "
        text += "per value"
    lines = [text]
    others = [optimum for optimum in distinct_optima(result) if not optimum.is_result]
    for optimum in others[:_MANY]:
        where = ", ".join(f"{path} {value:.4g}" for path, value in optimum.values.items())
        who = "1 start" if optimum.reached == 1 else f"{optimum.reached} starts"
        lines.append(
            f"another optimum was reached from {who}, worse by {optimum.worse:.3g}: {where} (SI)"
        )
    return lines + [
        f"{count} did not converge: {why}" for why, count in lost_starts(result).items()
    ]


def _of_runs(runs: Sequence[_Run], of_one: Callable[[_Run], list[str]], what: str) -> list[str]:
    """Lines of each run; of many, one line a channel: smallest, median and largest RMSE."""
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
    """RMSE of the prediction of a run that was not fitted."""
    lines = []
    for unit, names in _by_unit(run).items():
        shown = ", ".join(f"{name} {_rmse(run.channels[name].rmse)}" for name in names)
        lines.append(f"{run.name}: RMSE {shown}{unit}")
    return lines


def _rmse(value: float | None) -> str:
    return format_number(value, ".3g", "not finite")


_WEIGHTED = 1.1  # times the white noise in the weights of a fit: worth a word


def _residuals(run: RunFit) -> list[str]:
    """One line for a few channels, one line per unit for many."""
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
            against += f" from sample to sample, up to {weights:.3g} times as large in the weights"
        counts = _counts(names, sum(channels[name].n for name in names))
        lines.append(f"{run.name}: RMSE {shown}{unit}; noise {against}; {counts}")
    return lines


def strongest_correlation(result: FitResult) -> tuple[float, str, str] | None:
    """The largest correlation, and the parameters that it is between; None where there is none."""
    paths = result.correlation.parameters
    pairs = [
        (abs(correlation), correlation, paths[j], paths[i])
        for i, row in enumerate(result.correlation.matrix)
        for j, correlation in enumerate(row[:i])
        if correlation is not None
    ]
    return max(pairs)[1:] if pairs else None


def correlation_text(value: float) -> str:
    """A correlation with three digits where two would round to one, which none here is."""
    return "?" if math.isnan(value) else f"{value:.{3 if abs(value) >= 0.995 else 2}f}"


# A fit with derivatives wrong by this much may stop anywhere. In 64-bit a good one has 1e-5.
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
