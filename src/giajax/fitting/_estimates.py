"""Estimates of the parameters: values, standard errors, remarks and findings."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import erfc, stdtrit

from ..models import AbstractModel, parameter_values
from ..noise import PRIOR_LEVEL, Reason, robust_deviation
from ..recordings import Run, oddities
from ..runtime.records import finite_or_none
from ..runtime.text import format_estimate, one_of
from ..schema import Declaration
from ..schema.parameters import Parameter, declared
from ._checks import Curvature
from ._problem import predictions_by_run
from ._records import Estimate, OwnEstimate
from ._statistics import Statistics, combinations
from ._steps import FitState
from ._uncertainty import FAR_OFF, largest_correlations, times_white_noise
from ._weights import prior_of

# Findings on what the data of a fit cannot determine: a code, a sentence and advice.
#
# `docs/findings.md` has a section for each code.

_CORRELATED = 0.95  # correlations beyond this determine little more than a combination of the two
_MOST_PAIRS = 10  # many pairs usually have one cause, which the strongest pairs show
_BENT = 0.3  # largest relative effect of second derivatives on the cost within a standard error
_AGAINST = 3.0  # prior standard deviations by which the data may shift a parameter
# Shift of a parameter, in standard errors, that a prior in conflict with the data may cause.
_HELD_BACK = 0.5
_MOSTLY = 0.5  # a prior with a larger share of the information mainly determines the value
_GONE = 1e-2  # fraction of its default below which an essential parameter may be 0
_ONE_SIDED = 1.645  # normal quantile of a one-sided interval of 95 %

# Shorter records, in correlation times, make the estimated correlation and all errors uncertain.
_LONG_ENOUGH = 20.0


@dataclasses.dataclass(frozen=True)
class Finding:
    """Quantity that the data cannot determine, or a reason to doubt a standard error.

    Attributes:
        code: kind of the finding, the name of its section in `docs/findings.md`.
        paths: paths of the parameters concerned, with the runs if not all runs are concerned.
        sentence: description of the finding.
        advice: recommended action.
    """

    code: str
    paths: tuple[str, ...]
    sentence: str
    advice: str

    @property
    def page(self) -> str:
        """Section of the documentation that explains the finding."""
        return f"docs/findings.md#{self.code}"


def findings(
    state: FitState,
    statistics: Statistics,
    curvatures: Mapping[int, Curvature],
    correlation_times: Sequence[tuple[str, float]] = (),
) -> tuple[Finding, ...]:
    """Return the findings of a fit.

    Arguments:
        state: state at the end of the fit.
        statistics: statistics of the fit.
        curvatures: known curvatures, by the position of the parameter.
        correlation_times: name of each record, and its length divided by the correlation time of
            its noise.
    """
    return (
        *_outliers(state),
        *_without_response(state, statistics),
        *_together(state, statistics),
        *_correlated(state, statistics),
        # Without an optimum, neither finding describes the range that the data allow.
        *(_at_bounds(state, statistics) if _is_optimum(state) else ()),
        *_priors(state, statistics),
        *(_bent(statistics, curvatures) if _is_optimum(state) else ()),
        *_short(correlation_times),
    )


def _is_optimum(state: FitState) -> bool:
    return state.ending is not None and state.ending[0] == "converged"


_OUT = 12.0  # robust standard deviations beyond which a residual is not noise
_OUT_OF_NOISE = 3.0  # standard deviations of the noise that an outlier must also exceed
_MOST_OUT = 0.1  # fraction of the cells; if more of them are off, the model is the cause
_FEW_CELLS = 20


def _outliers(state: FitState) -> Iterator[Finding]:
    """Yield findings for outlier cells of a fit with the linear loss, by channel and row."""
    if not state.setup.loss.is_linear or not state.evaluated:
        return
    runs = state.setup.runs
    predictions = predictions_by_run(state.problem, state.inner.aux, runs)
    for number, (run, predicted) in enumerate(zip(runs, predictions, strict=True)):
        said = []
        for name, recorded in run.observations.items():
            rest = np.abs(predicted[name] - recorded)
            known, noise = rest[~np.isnan(rest)], state.noise.values[number][name].deviation
            if len(known) < _FEW_CELLS:
                continue
            # Outliers contribute to a noise that was estimated from the residuals.
            limit = max(_OUT * robust_deviation(known), _OUT_OF_NOISE * noise)
            out = np.flatnonzero(rest > limit)
            # An effect that the model omits makes consecutive rows deviate.
            scattered = np.count_nonzero(np.diff(out) == 1) <= len(out) / 2
            if 0 < len(out) <= _MOST_OUT * len(known) and scattered:
                more = f" and {len(out) - 5} more" if len(out) > 5 else ""
                if run.times is None or run.name == run.recording:
                    rows = ", ".join(run.naming.at(row).rpartition(" ")[2] for row in out[:5])
                    said.append(f"{name} in {run.naming.row} {rows}{more}")
                else:  # a window does not know the number of its first row
                    times = ", ".join(f"{time:.7g}" for time in run.times[out[:5]])
                    said.append(f"{name} at {times} s{more}")
        if said:
            yield Finding(
                "outliers",
                (),
                f"some residuals of {run.name} exceed {_OUT:g} times the typical residual: "
                f"{'; '.join(said[:5])}{'; ...' * (len(said) > 5)}",
                "empty these cells if the recorded values are wrong, or fit with --loss student_t, "
                "which is robust to outliers",
            )


def odd_recordings(runs: Iterable[Run]) -> tuple[Finding, ...]:
    """Return a finding for each oddity of each recording before a fit."""
    return tuple(
        Finding("odd_recording", (), f"{run.name}: {odd.sentence}", odd.remedy)
        for run in runs
        for odd in oddities(run)
    )


def _without_response(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    dead = np.setdiff1d(np.arange(state.problem.size), statistics.alive)
    labels = (statistics.labels[i] for i in dead)
    names = tuple(name for name in labels if name not in state.setup.nuisances)
    if names:
        yield Finding(
            "no_response",
            names,
            f"no channel responds to {', '.join(names)}",
            _unless_far_off(
                state, "hold it fixed, give it a prior, or record a motion that depends on it"
            ),
        )


def _unless_far_off(state: FitState, advice: str) -> str:
    """Return the advice if the model describes the data, otherwise the advice to check the data."""
    if times_white_noise(state) < FAR_OFF:
        return advice
    return "first find out why the model does not describe the data: run 'giajax check' on the data"


def _together(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    lower = np.asarray(state.problem.bijector.lower)
    shared = zip(state.setup.parameters, state.problem.positions, strict=True)
    held = {place: p.declaration.frozen for p, places in shared for place in places}
    usual = [held.get(index, False) for index in range(len(lower))]
    for members, known in combinations(statistics, (lower >= 0).tolist(), usual):
        names = tuple(statistics.labels[i] for i in members)
        said = f", but only {' and '.join(map(str, known))}" if known else ""
        yield Finding(
            "only_combinations",
            names,
            f"the data do not determine {', '.join(names)} separately{said}",
            f"give one of them ({one_of(names)}) a prior with a standard deviation, or hold it "
            "fixed" + (", which does not change the combinations" if known else ""),
        )


def _correlated(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    correlation, determined = statistics.correlation, statistics.determined
    pairs = [
        (abs(correlation[i, j]), i, j)
        for i in range(len(determined))
        for j in range(i)
        if determined[j] < state.problem.shared and abs(correlation[i, j]) > _CORRELATED
        if not {statistics.labels[determined[k]] for k in (i, j)} & set(state.setup.nuisances)
    ]
    if not pairs:
        return
    advice = _unless_far_off(
        state,
        "do not interpret one without the other; to separate them, give one of them a prior, or "
        "add a run in which they act at different times",
    )
    for _, i, j in sorted(pairs, reverse=True)[:_MOST_PAIRS]:
        names = (statistics.labels[determined[j]], statistics.labels[determined[i]])
        yield Finding(
            "correlated",
            names,
            f"{names[0]} and {names[1]} have a correlation of {correlation[i, j]:+.3f}, so a "
            "change of one is nearly compensated by a change of the other",
            advice,
        )


def _at_bounds(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    bijector = state.problem.bijector
    residual = np.asarray(state.inner.residual, dtype=float)
    gradient = state.natural_jacobian.transposed_times(residual)
    for index, side in statistics.bounds.items():
        bound = (bijector.lower if side == "lower" else bijector.upper)[index]
        error = statistics.standard_errors[index]
        # The cost, divided by the noise variance, rises from the bound as g t + t^2 / (2 s^2).
        push = abs(float(gradient[index])) / statistics.scale * error
        reach = error * (np.hypot(push, _ONE_SIDED) - push)
        most = (
            f"at most {bound + reach:.3g}" if side == "lower" else f"at least {bound - reach:.3g}"
        )
        name = statistics.labels[index]
        yield Finding(
            "at_a_bound",
            (name,),
            f"{name} is at its {side} bound {bound:g}, and its value is {most} (one-sided, 95 %)",
            "use the one-sided interval instead of the standard error, and check the bound and the "
            "rest of the model",
        )


def _priors(state: FitState, statistics: Statistics) -> Iterator[Finding]:
    priors = state.problem.priors
    rows = (
        np.asarray(state.inner.residual, dtype=float)[-len(priors.columns) :]
        if len(priors.columns)
        else ()
    )
    for index, row in zip(priors.columns, rows, strict=True):
        name = statistics.labels[index]
        if abs(row) > _AGAINST:
            yield Finding(
                "against_its_prior",
                (name,),
                f"the data shift {name} by {abs(row):.2g} standard deviations of its prior",
                "check the prior and the rest of the model",
            )
        elif name in state.setup.nuisances:
            continue
        elif statistics.prior_shares.get(index, 0.0) > _MOSTLY:
            share = statistics.prior_shares[index]
            yield Finding(
                "mostly_its_prior",
                (name,),
                f"{share:.0%} of the information on {name} comes from its prior",
                "its value mainly reflects the prior, not the data",
            )


def beyond_usual(state: FitState, statistics: Statistics) -> Reason | None:
    """Return the nuisance parameter that is significantly far from its usual value, if any.

    It must also change a fitted parameter noticeably. The difference between its estimate and the
    centre of its prior has the variance of the prior minus the variance of the estimate. Without
    the prior, it would be further away, and so would the parameters that are correlated with it.
    """
    priors, found = state.problem.priors, []
    nuisances = state.setup.nuisances
    rows = np.asarray(state.inner.residual, dtype=float)
    for index, row in zip(priors.columns, rows[len(rows) - len(priors.columns) :], strict=True):
        name, share = statistics.labels[index], statistics.prior_shares.get(index, 1.0)
        if name not in nuisances or index not in statistics.determined or share > 1 - 1e-6:
            continue
        chance = len(nuisances) * float(erfc(abs(row) / np.sqrt(2 * (1 - share))))
        place = statistics.determined.index(index)
        further = abs(row) * np.sqrt(share) / (1 - share)
        moved = further * np.abs(statistics.correlation[place])
        for other, at in enumerate(statistics.determined):
            if statistics.labels[at] in nuisances:
                moved[other] = 0.0
        most = int(np.argmax(moved))
        if chance < PRIOR_LEVEL and moved[most] > _HELD_BACK:
            error = statistics.standard_errors[index]
            value, deviation = format_estimate(float(statistics.values[index]), error)
            path = statistics.labels[statistics.determined[most]]
            free = [parameter.path for parameter in state.setup.parameters]
            asked = [each for each in free if each not in nuisances]
            command = " ".join(f"--free {each}" for each in [*asked, name])
            how = "" if "[" in name else f", or fit it without a prior with {command}"
            sentence = (
                f"{name} is {value} +- {deviation}, which is {abs(row):.2g} standard deviations "
                f"from its usual value, and this deviation changes {path} by {moved[most]:.2g} "
                "times its standard error: check for other causes with the same effect on the "
                f"data, or give the known value of {name} in [uncertainty]{how}"
            )
            found.append(Reason("prior", sentence, min(chance, 1.0), float(moved[most])))
    return min(found, key=lambda reason: reason.p_value, default=None)


def vanished(state: FitState, statistics: Statistics) -> Reason | None:
    """Return a reason for doubt if an essential parameter is 0 within its standard error.

    No residual shows this error. The test requires that a command varies, because a joint that
    never moves does not reveal its stiffness. The parameter must also be far below its usual size,
    which excludes parameters that the data do not determine.
    """
    runs = state.setup.runs
    commands = (
        (run, name) for run in runs for name in run.values if run.part_of(name) == "command"
    )
    if not any(np.ptp(run.values[name]) > 0 for run, name in commands):
        return None
    for parameter, places in zip(state.setup.parameters, state.problem.positions, strict=True):
        declaration = parameter.declaration
        for index in places if declaration.essential else ():
            value = float(statistics.values[index])
            error = 3 * statistics.standard_errors.get(index, 0.0)
            if value <= error and value + error < _GONE * declaration.default:
                sentence = (
                    f"{statistics.labels[index]} is {value:.1g} {declaration.unit}, which is 0 to "
                    "within its standard error: according to the data, these joints do not follow "
                    "their commands. Check their drives, and fix the parameter at its known value"
                )
                return Reason("vanished", sentence, 1.0, 1.0)
    return None


def _bent(statistics: Statistics, curvatures: Mapping[int, Curvature]) -> Iterator[Finding]:
    for index, bent in curvatures.items():
        name = statistics.labels[index]
        if max(abs(bent.left_out), abs(bent.skew)) > _BENT:
            yield Finding(
                "curved",
                (name,),
                f"the standard error of {name} is not reliable: within one standard error, the "
                f"second derivatives change the cost by {bent.left_out:+.0%}, and the costs on "
                f"the two sides differ by {bent.skew:+.0%}",
                "compute its interval with 'giajax profile', or record more data",
            )


def _short(correlation_times: Sequence[tuple[str, float]]) -> Iterator[Finding]:
    for name, count in correlation_times:
        if count < _LONG_ENOUGH:
            yield Finding(
                "short_record",
                (),
                f"the recording '{name}' lasts only {count:.2g} correlation times of its noise",
                f"record at least {_LONG_ENOUGH:g} correlation times, or give the correlated "
                "noise in [noise] (such as position_correlated_m and position_correlation_s), "
                "which cannot be estimated from a shorter recording",
            )


_NOISE_ALONE = 0.95  # largest fraction of the error due to noise for which the rest is reported
_NEARLY_THE_SAME = 0.98  # smallest correlation between parameters that is worth a remark


_LEVEL = 0.95

_NORMAL = 1e9  # degrees of freedom from which Student's t equals the normal distribution


def estimates(state: FitState, statistics: Statistics, model: AbstractModel) -> dict[str, Estimate]:
    """Return the estimates by path: first the free parameters, then those that the fit held."""
    free = {
        parameter.path: _free(state, statistics, parameter, places)
        for parameter, places in zip(state.setup.parameters, state.problem.positions, strict=True)
    }
    return {**free, **_held(model, tuple(free))}


def _free(
    state: FitState, statistics: Statistics, parameter: Parameter, places: tuple[int, ...]
) -> Estimate:
    """Return the estimate of a parameter, or the mean of the values of the groups of runs."""
    index, declaration = places[0], parameter.declaration
    common = {**unit_and_bounds(declaration), "free": True}
    if len(places) > 1:
        runs = "run" if len(places) == len(state.setup.runs) else "group of runs"
        error = None
        if set(places) <= set(statistics.determined):
            weights = np.isin(statistics.alive, places) / len(places)
            error = finite_or_none(float(np.sqrt(weights @ statistics.covariance @ weights)))
        return Estimate(
            value=float(np.mean(statistics.values[list(places)])),
            standard_error=error,
            remark=f"mean of {len(places)} values, one for each {runs} (listed in result.json)",
            **common,
        )
    value = float(statistics.values[index])
    error = finite_or_none(statistics.standard_errors.get(index))
    interval = None
    if error is not None:
        # A bound limits the interval, which is then one-sided.
        reach = student_reach(statistics.degrees_of_freedom[index]) * error
        interval = max(value - reach, declaration.lower), min(value + reach, declaration.upper)
    return Estimate(
        value=value,
        standard_error=error,
        remark=_remark(state, statistics, index, error),
        interval=interval,
        freedom=finite_or_none(statistics.degrees_of_freedom.get(index)),
        sandwich_error=finite_or_none(statistics.sandwich.get(index)),
        prior_share=finite_or_none(statistics.prior_shares.get(index)),
        sources=statistics.sources.get(index, {}),
        noise_error=finite_or_none(statistics.noise_errors.get(index)),
        **common,
    )


def student_reach(freedom: float, level: float = _LEVEL) -> float:
    """Return the half-width of a Student's t interval, in standard errors."""
    return float(stdtrit(min(freedom, _NORMAL), (1 + level) / 2))


def own_estimates(state: FitState, statistics: Statistics) -> list[dict[str, OwnEstimate]]:
    """Return the estimates for single runs or for their groups of runs, by path."""
    problem = state.problem
    varied = [index for index, places in enumerate(problem.positions) if len(places) > 1]
    estimates: list[dict[str, OwnEstimate]] = [{} for _ in state.setup.runs]
    for batch in problem.batches:
        names = [*(problem.paths[index] for index in varied), *batch.own_labels()]
        for member, columns in zip(batch.members, batch.columns(), strict=True):
            own = [*columns[varied], *columns[len(problem.paths) :]]
            for name, column in zip(names, map(int, own), strict=True):
                error = finite_or_none(statistics.standard_errors.get(column))
                value = float(statistics.values[column])
                said = _remark(state, statistics, column, error)
                estimates[member][name] = OwnEstimate(value, error, said)
    return estimates


def _remark(state: FitState, statistics: Statistics, index: int, error: float | None) -> str:
    """Return the remark on the value of a free parameter, which may be empty."""
    if statistics.labels[index] in state.setup.nuisances:
        prior = prior_of(state.setup.priors, statistics.labels[index])
        assert prior is not None
        spread = f"x/ {prior.factor:.3g}" if prior.factor else f"+- {prior.deviation:.2g}"
        return f"nuisance parameter with the prior {prior.value:.4g} {spread}"
    if not np.asarray(state.active)[index]:
        return "not determined: no channel responds to it, so it is kept at its initial value"
    for group in statistics.together:
        if index in group:
            others = ", ".join(statistics.labels[i] for i in group if i != index)
            return f"not determined individually: only a combination with {others} is determined"
    if error is None:
        return "not determined: no channel responds to it at its final value"
    if index in statistics.bounds and not _is_optimum(state):
        return f"at its {statistics.bounds[index]} bound when the fit ended, not at an optimum"
    if index in statistics.bounds:
        return (
            f"at its {statistics.bounds[index]} bound: the best value is the bound itself, and the "
            "standard error is the distance from the bound that is compatible with the data"
        )
    share = statistics.prior_shares.get(index, 0.0)
    if share > _MOSTLY:
        return f"its value comes mainly from its prior ({share:.0%} of the information)"
    if error > abs(statistics.values[index]):
        return "barely determined: the standard error exceeds the value"
    nuisances = [statistics.labels[i] in state.setup.nuisances for i in statistics.determined]
    # The prior knowledge of a nuisance parameter is already included in its error.
    asked = np.where(np.logical_or.outer(nuisances, nuisances), 0.0, statistics.correlation)
    partners = largest_correlations(asked, _NEARLY_THE_SAME)
    row = statistics.determined.index(index)
    if row in partners:
        partner, correlation = partners[row]
        other = statistics.labels[statistics.determined[partner]]
        return f"correlation {correlation:+.3f} with {other}"
    by_noise = statistics.noise_errors.get(index)
    if by_noise is not None and by_noise < _NOISE_ALONE * error:
        rest = np.sqrt(error**2 - by_noise**2)
        return f"error: {by_noise:.2g} from noise, {rest:.2g} from nuisance parameters"
    return ""


def _held(model: AbstractModel, free: tuple[str, ...]) -> dict[str, Estimate]:
    """Return the estimates of the declared parameters that were not free."""
    values = parameter_values(model)
    held: dict[str, Any] = {"standard_error": None, "free": False, "remark": "held"}
    return {
        path: Estimate(value=values[path], **unit_and_bounds(parameter.declaration), **held)
        for path, parameter in declared(model).items()
        if path not in free
    }


def unit_and_bounds(declaration: Declaration) -> dict[str, Any]:
    """Return the unit and the bounds that a declaration gives an estimate, as floats or None."""
    lower, upper = finite_or_none(declaration.lower), finite_or_none(declaration.upper)
    return {"unit": declaration.unit, "lower": lower, "upper": upper}
