"""A result as text: the parameter table and what else a reader must know."""

import math
from collections.abc import Iterable, Sequence

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

RESULT = "result.json"
PAGE = "report.html"

# Written into each picture and page: how a later fit knows one of an earlier from a person's.
SIGNATURE = "giajax fit"

MOST_RUNS = 6
"""How many are drawn: a picture takes a second, and nobody looks at twenty of them."""


def worth_drawing(result: FitResult) -> list[int]:
    """All runs, or of many those that are described worst, in their order."""
    if len(result.runs) <= MOST_RUNS:
        return list(range(len(result.runs)))
    worst = sorted(range(len(result.runs)), key=lambda index: -times_noise(result.runs[index]))
    return sorted(worst[:MOST_RUNS])


def times_noise(record: RunFit, names: Iterable[str] | None = None) -> float:
    """The largest RMSE over noise of some channels, or of all; infinite where one is not finite."""
    channels = [record.channels[name] for name in (record.channels if names is None else names)]
    return max(
        (
            float("inf") if c.rmse is None else c.rmse / c.noise if c.noise else 0.0
            for c in channels
        ),
        default=0.0,
    )


# Without one of two equal recordings errors are 1.4 times as large; more than this is worth a word.
_NOTABLE = 2.0

# A factor is shown up to here; beyond it hardly anything is known without the recording.
_LARGE = 1000.0


def source_lines(result: FitResult) -> list[str]:
    """A line for each recording that determines something which the others hardly do.

    Arguments:
        result: of a fit of several recordings; of one there is nothing to say.

    Returns:
        Such as `bench: nothing else determines alpha.offset`.
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
        parts = []
        if recording in alone:
            parts.append(f"nothing else determines {', '.join(alone[recording])}")
        if recording in mostly:
            listed = ", ".join(mostly[recording])
            parts.append(f"without it errors are as many times as large: {listed}")
        lines.append(f"{recording}: {'; '.join(parts)}")
    return lines


def held_out_lines(result: FitResult) -> list[str]:
    """How well what was held out of each run is predicted."""
    return [line for record in result.held_out for line in _lines(record)]


def _by_unit(run: RunFit | PredictionErrors | HeldOut) -> dict[str, list[str]]:
    """Names of the channels of each unit; the unit as it stands behind a number."""
    by_unit: dict[str, list[str]] = {}
    for name, channel in run.channels.items():
        by_unit.setdefault(_unit(channel.unit), []).append(name)
    return by_unit


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _lines(record: HeldOut) -> list[str]:
    lines = []
    for unit, names in _by_unit(record).items():
        channels = [record.channels[name] for name in names]
        errors = _range([channel.rmse for channel in channels]) or "not known"
        if len(names) <= 4:
            each = [f"{n} {_range([record.channels[n].rmse]) or 'not known'}" for n in names]
            errors = ", ".join(each)
        sizes = _range([channel.size for channel in channels])
        values = sum(channel.n for channel in channels)
        lines.append(
            f"{record.name}: RMSE {errors}{unit}"
            + (f"; {sizes} times what noise and the parameters allow" if sizes else "")
            + f"; {len(names)} channel{'s' * (len(names) > 1)}, {values} values"
        )
    return lines


def _range(values: list[float | None]) -> str:
    """The smallest and the largest of what is known and finite; empty where nothing is."""
    known = sorted(value for value in values if value is not None and math.isfinite(value))
    if not known:
        return ""
    low, high = f"{known[0]:.3g}", f"{known[-1]:.3g}"
    return low if low == high else f"{low} to {high}"


def verdict_lines(result: FitResult) -> list[str]:
    """Whether the model describes the data, and a line for each reason why it does not."""
    verdict = result.verdict
    reasons = [reason.sentence for reason in verdict.reasons]
    if verdict.status != "inadequate":
        return [verdict.sentence]
    return [f"inadequate: {reasons[0]}", *reasons[1:]]


def noise_lines(result: FitResult) -> list[str]:
    """What was taken for correlated noise, and what it does to the standard errors."""
    if result.noise is None or not result.noise.widening:
        return []
    channels = [channel for run in result.runs for channel in run.channels.values()]
    times = [c.correlation_time_s for c in channels if c.correlated]
    names = {name for run in result.runs for name, c in run.channels.items() if c.correlated}
    shortest, longest = min(times), max(times)
    span = f"{shortest:.2g}" if shortest == longest else f"{shortest:.2g} to {longest:.2g}"
    factors = [factor for factor in result.noise.widening.values() if factor is not None]
    sentence = f"correlated over {span} s in {len(names)} of {_count(result)} channels"
    if factors:
        low, high = f"{min(factors):.2g}", f"{max(factors):.2g}"
        span = low if low == high else f"{low} to {high}"
        sentence += f"; the standard errors are {span} times those of white noise of the same size"
    return [sentence]


def _count(result: FitResult) -> int:
    return len({name for run in result.runs for name in run.channels})


# More lines of residuals than this are summed up.
_MANY = 8


def parameter_table(result: FitResult, width: int | None = None) -> str:
    """The free and the fixed parameters: value, standard error, unit, bounds and remark.

    Arguments:
        result: the result of a fit.
        width: columns that there are. Where the remarks do not fit, each goes below its row.
            Without a width nothing is wrapped: a row is a line, for grep and awk.

    Returns:
        The lines, without a newline at the end.
    """
    return estimate_table(in_column_units(result.shown, result.model), width)


def summary(result: FitResult, width: int | None = None) -> str:
    """How the fit ended, how well it describes the data, and what its values rest on.

    Arguments:
        result: the result of a fit.
        width: columns that there are; without one nothing is wrapped.

    Returns:
        The lines, without a newline at the end.
    """
    label = 20
    lines: list[str] = []
    for name, text in summary_rows(result):
        lines += wrapped(text, width, name.ljust(label), " " * label)
    return "\n".join(lines)


def summary_rows(result: FitResult) -> list[tuple[str, str]]:
    """The summary as pairs of a label (which may be empty) and a sentence."""
    rows = [("status", result.headline)]
    rows += _labelled("units", [note] if (note := units_note(result.shown, result.model)) else [])
    rows += _labelled("verdict", verdict_lines(result))
    rows += _labelled("noise", noise_lines(result))
    for label, number in (("cost", result.cost), ("reduced chi-square", result.reduced_chi_square)):
        rows.append((label, format_number(number, missing="not finite")))
    rows += _labelled("starts", _starts(result))
    residuals = [text for run in result.runs for text in _residuals(run)]
    if len(residuals) > _MANY:
        residuals = _over_runs(result.runs, "residuals of")
    rows += _labelled("residuals", residuals)
    own = list(filter(None, (run.parameters.keys() - result.free for run in result.runs)))
    if own:
        text = f"{sum(map(len, own))} values of {len(own)} runs alone were fitted, too"
        rows.append(("initial states", f"{text}; result.json has them"))
    validation = [text for run in result.validation for text in _errors(run)]
    if len(validation) > _MANY:
        validation = _over_runs(result.validation, "prediction of")
    rows += _labelled("validation", validation)
    held_out = held_out_lines(result)
    if len(held_out) > _MANY:
        held_out = _over_runs(result.held_out, "prediction of")
    rows += _labelled("held out", held_out)
    rows += _labelled("determined by", source_lines(result))
    if strongest := _strongest_correlation(result):
        rows.append(("correlation", strongest))
    rows += _labelled("findings", [f"{f.sentence}: {f.advice} ({f.page})" for f in result.findings])
    rows.append(("gradient check", _gradient(result)))
    rows.append(("solver tolerance", _tolerance(result)))
    for index, condition in enumerate(result.conditions):
        rows.append(("conditions" if index == 0 else "", condition))
    seconds = result.seconds
    rows.append(("time", f"{seconds.run:.2g} s, and {seconds.compile:.2g} s to compile or load"))
    return rows


def _labelled(label: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    return [(label if index == 0 else "", text) for index, text in enumerate(texts)]


def _starts(result: FitResult) -> list[str]:
    """How many starts ended where the result is, which other optima there are, and what failed."""
    if not result.starts:
        return []
    best = misfit(result)
    values = sum(channel.n for run in result.runs for channel in run.channels.values())
    ends = [start.misfit for start in result.starts if start.misfit is not None]
    near = sum(end - best < SAME_END * values for end in ends)
    text = f"{near} of {len(result.starts)} ended here"
    worse = sorted((end - best) / values for end in ends if end - best >= SAME_END * values)
    if worse:
        text += f"; the others are worse by {worse[0]:.2g} to {worse[-1]:.2g} in log-likelihood "
        text += "per value"
    lines = [text]
    others = [optimum for optimum in distinct_optima(result) if not optimum.is_result]
    for optimum in others[:_MANY]:
        where = ", ".join(f"{path} {value:.4g}" for path, value in optimum.values.items())
        who = "1 start" if optimum.reached == 1 else f"{optimum.reached} starts"
        lines.append(f"another optimum, by {who}, worse by {optimum.worse:.3g}: {where} (SI)")
    return lines + [
        f"{count} did not converge: {why}" for why, count in lost_starts(result).items()
    ]


def _over_runs(runs: Sequence[RunFit | PredictionErrors | HeldOut], what: str) -> list[str]:
    """One line a channel for many runs: smallest, median and largest RMSE."""
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


def _residuals(run: RunFit) -> list[str]:
    """One line for a few channels, one line per unit for many."""
    channels = run.channels
    lines = []
    for unit, names in _by_unit(run).items():
        known = {name: rmse for name in names if (rmse := channels[name].rmse) is not None}
        values = sum(channels[name].n for name in names)
        noise = sorted({channels[name].noise for name in names})
        if len(names) <= 4:
            shown = ", ".join(f"{name} {_rmse(known.get(name))}" for name in names)
        elif known:
            worst = max(known, key=lambda name: known[name])
            best = min(known, key=lambda name: known[name])
            shown = f"{_rmse(known[best])} ({best}) to {_rmse(known[worst])} ({worst})"
        else:
            shown = "not finite"
        against = f"{noise[0]:.3g}" + (f" to {noise[-1]:.3g}" if noise[-1] > noise[0] else "")
        lines.append(
            f"{run.name}: RMSE {shown}{unit}; noise {against}; "
            f"{len(names)} channel{'s' * (len(names) > 1)}, {values} values"
        )
    return lines


def _strongest_correlation(result: FitResult) -> str:
    paths = result.correlation.parameters
    pairs = [
        (abs(correlation), correlation, paths[j], paths[i])
        for i, row in enumerate(result.correlation.matrix)
        for j, correlation in enumerate(row[:i])
        if correlation is not None
    ]
    if not pairs:
        return ""
    _, correlation, one, other = max(pairs)
    return f"at most {correlation:+.3f}, between {one} and {other}"


# A fit with derivatives wrong by this much may stop anywhere. In 64-bit a good one has 1e-5.
WRONG_DERIVATIVES = 1e-2


def _gradient(result: FitResult) -> str:
    check = result.gradient_check
    if check is None:
        return "not done"
    relative = check.relative_difference
    if relative > WRONG_DERIVATIVES:
        text = f"derivatives DISAGREE with differences, by {relative:.1e} (relative)"
    else:
        text = f"derivatives agree with differences to {relative:.1e} (relative)"
    return text + (f", without {', '.join(check.left_out)}" if check.left_out else "")


def _tolerance(result: FitResult) -> str:
    effect, integration = result.tolerance_effect, result.integration
    which = ""
    if integration is not None:
        chosen = ", chosen by what it moves" if integration.chosen else ""
        which = f"{integration.tolerance:.0e} of {integration.solver}{chosen}; "
    if capabilities.refined(result.model, 1.0) is None:
        return f"{which}not checked: the {result.model.kind} model cannot be refined"
    if effect is None or effect.largest_in_standard_errors is None:
        return f"{which}effect not known"
    finer = {0.5: "half", 0.1: "a tenth"}.get(effect.factor, "a hundredth")
    largest = effect.largest_in_standard_errors
    return f"{which}{finer} of it moves no parameter by more than {largest:.1e} standard errors"
