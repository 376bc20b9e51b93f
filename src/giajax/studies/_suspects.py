"""Suspects: tests of all fixed parameters, disabled choices and omitted parts of a fitted model."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import pdtrc

from ..fitting import (
    FitResult,
    Response,
    Suspect,
    SuspectKind,
    matching_runs,
)
from ..models import AbstractModel, capabilities
from ..noise import SUSPECT_LEVEL, Reason, Verdict, robust_deviation
from ..recordings import Run
from ..runtime.parallel import Tell, all_in_threads
from ..runtime.records import json_text
from ..runtime.text import InputError, format_estimate
from ..schema.parameters import declared, get
from ._candidates import Candidate, Inquiry, inquiry, is_disturbed, not_neutral
from ._columns import chi_square_of, mistaken_rows, points_row
from ._score import (
    IMITATED,
    Coordinates,
    Projected,
    Score,
    alike,
    among_memory,
    as_begun,
    basis_of,
    cell_factors,
    drop_beyond,
    projected,
    responses_of,
    scatter,
    score,
    slopes_of,
    tables,
    weighted_rest,
)

UNEXPLAINED = "unexplained"
"""Code of the reason for a verdict if no suspect explains the residuals."""

# Ratio of the residuals to the noise that a verdict accepts.
_EXPLAINED = 1.1
# Fraction of the excess of chi-square over the noise that is attributed to second-order effects.
_SECOND_ORDER = 0.1

LEVEL = 0.05
"""Significance level of corrected p-values."""


def promising(rows: Sequence[Suspect]) -> tuple[Suspect, ...]:
    """Return the best testable row of each quantity, in the order of `rows`.

    The elements of a vector and the whole vector are one quantity. A quantity that the data can
    hardly distinguish from an earlier one is listed in `alike` of the earlier row and has no row of
    its own.
    """
    best: dict[str, Suspect] = {}
    covered: set[str] = set()
    for row in rows:
        name = row.path.partition("[")[0]
        if row.testable and name not in best and name not in covered:
            best[name] = row
            covered |= {path.partition("[")[0] for path in row.alike}
    return tuple(best.values())


def significant(rows: Sequence[Suspect]) -> tuple[Suspect, ...]:
    """Return the promising rows of a table that are statistically significant."""
    return tuple(row for row in promising(rows) if (row.p_value or 0.0) < LEVEL)


@dataclasses.dataclass(frozen=True)
class Suspects:
    """Effects that would lower chi-square, the most important first.

    Attributes:
        rows: all tests; testable ones first, in order of decreasing drop of chi-square.
        chi_square: sum of squared residuals of the fit, divided by the variance of the white noise;
            at the initial guess if the model cannot be evaluated at the end of the fit.
        values: number of measured values.
        parameters: number of fitted parameters.
        asked: number of tests for which the p-values are corrected.
        left_over: ratio of the residuals to the white noise if the best suspects are included, to
            first order.
    """

    rows: tuple[Suspect, ...]
    chi_square: float
    values: int
    parameters: int
    asked: int
    left_over: float = 1.0

    @property
    def promising(self) -> tuple[Suspect, ...]:
        """Best testable row of each quantity, the most promising first."""
        return promising(self.rows)

    @property
    def significant(self) -> tuple[Suspect, ...]:
        """Promising rows that are statistically significant."""
        return significant(self.rows)

    @property
    def untestable(self) -> tuple[Suspect, ...]:
        """Rows that the data cannot test."""
        return tuple(row for row in self.rows if not row.testable)

    def of(self, path: str) -> Suspect:
        """Return the row of a path.

        Raises:
            KeyError: there is no such row.
        """
        return {row.path: row for row in reversed(self.rows)}[path]

    def judge(self, result: FitResult) -> Verdict:
        """Return the verdict on the tested fit, with the first suspect that makes it doubtful.

        Such a suspect is significant and shifts a fitted parameter by more than one standard error.
        An inadequate model remains inadequate. If no suspect explains the misfit, the verdict says
        so.
        """
        verdict = result.verdict.without("suspect").without(UNEXPLAINED)
        if verdict.status == "inadequate":
            # The tests refer to another point.
            if self.rows and all(row.begun for row in self.rows):
                return verdict
            before = self.chi_square / max(self.values - self.parameters, 1) - 1
            # Residuals that remain after a large first-order step are not considered.
            if self.left_over < _EXPLAINED or self.left_over**2 - 1 < _SECOND_ORDER * before:
                return verdict
            sentence = (
                "no fixed or omitted parameter explains the misfit: with the best suspects the "
                f"residuals are still {self.left_over:.3g} times the white noise (see "
                "left_over.png)"
            )
            # This reason is always the last one.
            reason = Reason(UNEXPLAINED, sentence, 0.0, self.left_over)
            return dataclasses.replace(verdict, reasons=(*verdict.reasons, reason))
        for row in self.promising:
            asked = ((path, by) for path, by in row.moves.items() if path in result.asked)
            path, by = max(asked, key=lambda each: abs(each[1]), default=("", 0.0))
            if (row.p_value or 0.0) < SUSPECT_LEVEL and abs(by) > 1:
                return verdict.doubted(
                    Reason("suspect", _doubt(row, path, by, result), row.p_value or 0.0, abs(by))
                )
        return verdict

    def to_json(self) -> str:
        """Return a JSON object with the attributes."""
        return json_text(self)


def _doubt(row: Suspect, path: str, by: float, result: FitResult) -> str:
    """Describe a suspect, its estimate, the shift that it causes, and the remedy."""
    if row.kind == "switch":
        return (
            f"the choice '{row.path}' lowers chi-square by {row.chi_square_drop:.3g} and changes "
            f"{path} by {by:+.2g} times its standard error: use it (run 'giajax suspects' to list "
            "all choices)"
        )
    values, errors = (
        np.atleast_1d(np.array(row.estimate)),
        np.atleast_1d(np.array(row.estimate_error)),
    )
    pairs = [format_estimate(*each) for each in zip(values.tolist(), errors.tolist(), strict=True)]
    shown = ", ".join(f"{value} +- {error}" for value, error in pairs)
    unit = f" {row.unit}" if row.unit else ""
    others = ", ".join(dict.fromkeys([*row.alike, *row.together]))
    also = f" (or {others}, which the data can hardly distinguish from it)" if others else ""
    plain = isinstance(row.value, float) and row.kind != "factor"
    held = f"fixed at {row.value:.4g}{unit}" if plain else "held"
    times = "a factor of " if row.kind == "factor" else ""
    free = " ".join(f"--free {each}" for each in [*result.asked, row.path])
    return (
        f"{row.path}{also} is {held}, and the residuals suggest {times}{shown}{unit}, which shifts "
        f"{path} by {by:+.2g} times its standard error: fit it too, with {free}"
    )


# A parameter is not testable if a change by this multiple of its magnitude would not be detectable.
_NOT_SHOWN = 3.0
_ALIKE = 0.99


def parameter_rows(
    rest: Projected, asked: Inquiry, scattering: Sequence[str] = ()
) -> tuple[list[Suspect], dict[str, list[int]]]:
    """Return a row for each fixed parameter, and the candidates of each testable one.

    A parameter whose elements may scatter has a single row, for their standard deviation.
    """
    candidates = asked.candidates
    notes = [_why_not(rest, index, one) for index, one in enumerate(candidates)]
    members: dict[str, list[int]] = {}
    for index, (one, note) in enumerate(zip(candidates, notes, strict=True)):
        if not note:
            members.setdefault(one.path, []).append(index)
            if one.group:
                members.setdefault(one.group, []).append(index)
    # A group with a single element is replaced by the row of that element.
    members = {p: of for p, of in members.items() if len(of) > 1 or candidates[of[0]].path == p}
    alone = {one.path for one in candidates if one.group in scattering}
    # An element without effect of an array that is tested as a whole has no row.
    whole = {one.path for one in candidates}
    hidden = {path for path in whole if "[" in path and path.partition("[")[0] in whole}
    members = {path: of for path, of in members.items() if path not in alone}
    rows = [
        _untestable(one.path, one.kind, note, one.unit, one.value)
        for one, note in zip(candidates, notes, strict=True)
        if note and one.path not in alone | hidden
    ]
    for path, indices in members.items():
        among = [candidates[index] for index in indices]
        if path in scattering:
            note = "standard deviation of its elements"
            rows.append(_amount_row(path, "scatter", scatter(rest, indices), note))
            continue
        found = score(
            rest,
            indices,
            [min(one.lower - one.value, 0.0) for one in among],
            [max(one.upper - one.value, 0.0) for one in among],
        )
        others = tuple(
            name
            for name, other in members.items()
            if not set(indices) & set(other)
            and len(other) == len(indices)
            and alike(rest, indices, other) > _ALIKE
        )
        rows.append(_row(path, among, found, others))
    return rows, members


def _row(path: str, among: Sequence[Candidate], found: Score, others: tuple[str, ...]) -> Suspect:
    value = [one.value for one in among]
    estimate = [one.value + float(step) for one, step in zip(among, found.step, strict=True)]
    error = found.error.tolist()
    group, note = len(among) > 1, ""
    if not group and not among[0].lower < value[0] < among[0].upper:
        note = "fixed at its bound: tested only towards the interior"
        if found.drop == 0:
            note += ", and the data suggest a value beyond the bound"
    return Suspect(
        path=path,
        kind="group" if group else among[0].kind,
        unit=among[0].unit,
        value=value if group else value[0],
        estimate=estimate if group else estimate[0],
        estimate_error=error if group else error[0],
        chi_square_drop=found.drop,
        degrees_of_freedom=len(among),
        p_value=found.p_value,
        testable=True,
        alike=others,
        note=note,
    )


def _amount_row(path: str, kind: SuspectKind, found: Score, note: str = "") -> Suspect:
    """Return the row of an effect that is absent from the fit, with its estimated amount."""
    return Suspect(
        path=path,
        kind=kind,
        unit="",
        value=0.0,
        estimate=float(found.step[0]),
        estimate_error=float(found.error[0]),
        chi_square_drop=found.drop,
        degrees_of_freedom=1,
        p_value=found.p_value,
        testable=True,
        note=note,
    )


def _why_not(rest: Projected, index: int, one: Candidate) -> str:
    """Return the reason why a candidate is not testable; empty if it is."""
    norm, left = float(rest.norms[index]), float(rest.perpendicular[index])
    if not np.isfinite(norm):
        return "its derivative is not finite at this value"
    if norm * one.size < 1e-6:
        return "no channel responds to it"
    if left < IMITATED * norm:
        return "the fitted parameters have the same effect: only a ratio is identifiable"
    if left * one.size * _NOT_SHOWN < 1:
        return f"the data are insensitive even to a change of {_NOT_SHOWN:g} times its magnitude"
    return ""


def _untestable(
    path: str, kind: SuspectKind, note: str, unit: str = "", value: float | None = None
) -> Suspect:
    return Suspect(path, kind, unit, value, None, None, None, 1, None, False, (), note)


def switch_row(rest: Projected, index: int, name: str) -> Suspect:
    norm, left = float(rest.norms[index]), float(rest.perpendicular[index])
    if norm < 1 or left < max(1.0, IMITATED * norm):
        note = (
            "the fitted parameters have the same effect"
            if norm >= 1
            else "it does not change any prediction"
        )
        return _untestable(name, "switch", note, value=0.0)
    return _amount_row(name, "switch", score(rest, [index], [0.0], [1.0]))


# Difference of an outlier from its neighbours, in robust standard deviations.
_SPIKE = 5.0
# Minimum number of outliers, and minimum fraction of all cells.
_FEWEST, _SHARE = 3, 0.002
# Probability that a cell of normal noise is marked, if its standard deviation is known to 10 %.
_BY_CHANCE = 1e-5


def outlying(at: Sequence[Response]) -> list[np.ndarray]:
    """Return which cells, (sample, channel), are outliers relative to both neighbours.

    No cell is marked if there are too few outliers.
    """
    found = []
    for response in at:
        found.append(np.zeros(response.observed.shape, dtype=bool))
        for column, mark in zip(
            (response.observed - response.predicted).T, found[-1].T, strict=True
        ):
            places = np.flatnonzero(~np.isnan(column))
            if len(places) < 5:
                continue
            known = column[places]
            spike = known[1:-1] - (known[:-2] + known[2:]) / 2
            usual = robust_deviation(spike)
            # The neighbours of an outlier differ by half as much in the opposite direction. The
            # neighbours of a peak of an oscillation differ by the same amount, and those in a bend
            # in the same direction.
            around = np.stack([spike[:-2], spike[2:]]) + spike[1:-1] / 2
            alone = np.all(np.abs(around) < 0.3 * np.abs(spike[1:-1]) + usual, axis=0)
            mark[places[2:-2]] = alone & (np.abs(spike[1:-1]) > _SPIKE * usual)
    cells = sum(int(np.sum(~np.isnan(response.observed))) for response in at)
    enough = sum(int(np.sum(each)) for each in found) >= max(_FEWEST, _SHARE * cells)
    return [each & enough for each in found]


def outliers_row(
    result: FitResult, at: Sequence[Response], factors: Sequence[np.ndarray], rest: Projected
) -> list[Suspect]:
    """Return a row if there are outliers although the loss of the fit is linear."""
    if not result.loss.is_linear or not all(rest.timed):
        return []
    weighted = (weighted_rest(one, one.predicted, by) for one, by in zip(at, factors, strict=True))
    pairs = zip(weighted, outlying(at), strict=True)
    away = np.concatenate([residuals[found] for residuals, found in pairs])
    if not len(away):
        return []
    share, by_chance = len(away) / rest.values, pdtrc(len(away) - 1, _BY_CHANCE * rest.values)
    sizes = np.array([share]), np.array([share / np.sqrt(len(away))])
    found = Score(*sizes, float(np.sum(away**2)), float(by_chance))
    note = "fraction of cells that deviate from both neighbours: fit with --loss student_t"
    row = _amount_row("outliers", "outliers", found, note)
    return [dataclasses.replace(row, degrees_of_freedom=len(away))]


def suspects(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    each: Sequence[str] = (),
    parameters_alone: bool = False,
) -> Suspects:
    """Return the effects that the residuals of a fit suggest.

    At the end of a fit, every fixed parameter, disabled choice and omitted part is tested: by how
    much chi-square would decrease if it were free, and which value one step leads to. Nothing is
    fitted.

    - **Parameters**, including those of omitted parts, by a score test with additional columns of
      the Jacobian; vectors also as a whole. A parameter at a bound is tested only towards the
      interior.
    - **Choices of the model**, for example where drag acts, by a blend from 0 to 1 between the
      predictions of the two choices.
    - **Axes of recorded positions**, in each of their 48 orders and signs, without a fit. They are
      tested at the end of the fit and at its initial guess, because a fit to wrong axes may have
      distorted its model to match them.
    - **Names and units of columns**, in the same way: numbers of links, mm or degrees instead of
      other units, and signs and joints of commands.
    - **Points** that are exchanged, show another point or stand still in some of the rows, in the
      same way.
    - **Outliers**: cells that differ from both of their neighbours.

    A fit that did not converge, or whose parameters are far from their prior values, may have moved
    to where an effect has no influence or the model cannot be evaluated. If no suspect explains
    most of its residuals, all tests are repeated at the initial guess, and the table whose most
    significant row has the smaller p-value is returned (`Suspect.begun`).

    A missing effect is not noise. Therefore the table is sorted by the drop of chi-square (minus
    the drop by as many random columns for residuals of this size), computed with the white noise
    that the runs state or, if none is stated, with an estimate from the second differences of the
    residuals. The p-values are based on the noise after the step, which may be larger and
    correlated in time (AR(1) in the samples of each channel). They are corrected for the number of
    tests by Holm's method.

    Arguments:
        result, runs: result of `giajax.fit` or `giajax.load_result`, and the fitted runs in the
            same order.
        each: paths of arrays, such as `encoder.offset`, whose elements are tested one by one and
            jointly; by default all elements change in proportion.
        parameters_alone: omit choices and axes, each of which requires the compilation of a
            program.

    Raises:
        InputError: the runs do not match the result; a path in `each` is not an array; or the
            model cannot be evaluated.

    Example:
        >>> result = giajax.load_result("giajax-out/base_step")  # doctest: +SKIP
        >>> giajax.suspects(result, runs).promising[0].path  # doctest: +SKIP
        'camera.delay'
    """
    runs = matching_runs(result.runs, runs)
    asked = functools.partial(_asked, runs=runs, each=each, parameters_alone=parameters_alone)
    begun = as_begun(result) if _is_astray(result) else None
    if begun is None:
        return asked(result)
    at_end: Suspects | None = None
    failure: InputError | None = None
    try:
        at_end = asked(result)
    except InputError as error:
        failure = error
    if at_end is not None and at_end.left_over < _STILL_WILD:
        return at_end
    try:
        at_start = asked(begun)
    except InputError as error:
        if at_end is None:
            raise failure or error from None
        return at_end
    if at_end is not None and _TABLES * _least_p_value(at_start) >= _least_p_value(at_end):
        return at_end
    # The p-values are corrected for the selection of the better of two tables.
    rows = [
        dataclasses.replace(
            row,
            begun=True,
            moves={},
            p_value=None if row.p_value is None else min(_TABLES * row.p_value, 1.0),
        )
        for row in at_start.rows
    ]
    whole = at_start if at_end is None else at_end
    return dataclasses.replace(whole, rows=tuple(rows), asked=_TABLES * at_start.asked)


# Ratio of the residuals to the noise, with the best suspects, from which the initial guess is
# tested.
_STILL_WILD = 3.0
_TABLES = 2


def _least_p_value(found: Suspects) -> float:
    return min((row.p_value or 0.0 for row in found.significant), default=1.0)


def _is_astray(result: FitResult) -> bool:
    """Return whether a fit may have ended where a missing effect has no influence."""
    verdict = result.verdict
    far = result.status != "converged" or "prior" in {reason.code for reason in verdict.reasons}
    return far and verdict.status == "inadequate"


def _asked(
    result: FitResult, runs: Sequence[Run], each: Sequence[str], parameters_alone: bool
) -> Suspects:
    free = {path.partition("[")[0] for path in result.free}
    scattering = [] if parameters_alone else list(capabilities.scattering(result.model))
    scattering = [path for path in scattering if path not in {*each, *free}]
    single = [] if parameters_alone else capabilities.one_by_one(result.model)
    beside = [path for path in single if path not in {*each, *free}]
    of_this_fit = result.model, list(result.free), [*each, *scattering], result.config.get("ties")
    asked = inquiry(*of_this_fit, beside=beside)
    at = linearised(result, runs, asked)
    if is_disturbed(result, runs, at):
        asked = inquiry(*of_this_fit, not_neutral(result, runs), beside=beside)
        at = linearised(result, runs, asked)
    factors = cell_factors(result, runs, at)
    first, fitted = len(asked.candidates), len(result.free)
    switches = _switches(result, asked, runs, every=not parameters_alone)
    for changes in switches.values():
        at = [
            dataclasses.replace(one, columns=np.append(one.columns, change[..., None], axis=-1))
            for one, change in zip(at, changes, strict=True)
        ]
    of_fit = Coordinates.of(result)
    rest = projected(tables(at, runs, factors, of_fit), of_fit.known)
    cells = chi_square_of(at, [response.predicted for response in at], factors)
    chi_square = cells + of_fit.squares
    rows, members = parameter_rows(rest, asked, scattering)
    rows += [switch_row(rest, first + i, name) for i, name in enumerate(switches)]
    ways = 0
    if not parameters_alone:
        mistaken, ways = mistaken_rows(result, runs, at, factors, cells, rest)
        ways -= len(mistaken)
        rows += [*mistaken, *points_row(runs, at, factors, cells, rest)]
        rows += outliers_row(result, at, factors, rest)
    rows += [_untestable(path, "parameter", why) for path, why in asked.impossible.items()]
    rows, number = _corrected(rows, further=ways)
    # Decrease of chi-square by a column of random numbers for residuals of this size, as in BIC.
    price = np.log(rest.values) * max(1.0, chi_square / rest.values)

    def worth(row: Suspect) -> float:
        if not row.testable or row.chi_square_drop is None:
            return -np.inf
        return float(row.chi_square_drop - price * row.degrees_of_freedom)

    rows = sorted(rows, key=worth, reverse=True)
    # Indices among the columns, and the only permitted sign of a step, or 0. The key includes
    # whether it is a choice, because a choice may have the same name as a parameter.
    places: dict[tuple[str, bool], tuple[list[int], int]] = {}
    for path, of in members.items():
        begun = asked.candidates[of[0]]
        inward = int(begun.value <= begun.lower) - int(begun.value >= begun.upper)
        places[path, False] = [fitted + place for place in of], inward if len(of) == 1 else 0
    for place, name in enumerate(switches, start=fitted + first):
        places[name, True] = [place], 1
    rows = _among_memory(rows, places, result, runs, at, of_fit, number)
    tested = {key: [place - fitted for place in columns] for key, (columns, _) in places.items()}
    rows = _in_groups(rows, tested, rest, max(1.0, chi_square / rest.values))
    return Suspects(
        rows=tuple(_with_moves(rows, places, result, runs, at, of_fit)),
        chi_square=chi_square,
        values=rest.values,
        parameters=rest.parameters,
        asked=number,
        left_over=_left_over(rows, tested, rest, cells + of_fit.squares),
    )


def _left_over(
    rows: Sequence[Suspect],
    tested: Mapping[tuple[str, bool], list[int]],
    rest: Projected,
    chi_square: float,
) -> float:
    """Return the ratio of the residuals to the noise with all significant suspects."""
    shown = [row for row in promising(rows) if (row.p_value or 0.0) < LEVEL]
    keys = [(row.path, row.kind == "switch") for row in shown]
    given = [place for key in keys for place in tested.get(key, [])]
    basis = basis_of(rest.columns[:, given])
    left = float(np.sum((rest.residual - basis @ (basis.T @ rest.residual)) ** 2))
    whole = ("axes", "columns", "points")
    drops = [row.chi_square_drop or 0.0 for row in shown if row.kind in whole]
    left = min([left, *(chi_square - drop for drop in drops)])
    return float(np.sqrt(left / max(rest.values - rest.lost - basis.shape[1], 1.0)))


def _among_memory(
    rows: Sequence[Suspect],
    places: Mapping[tuple[str, bool], tuple[list[int], int]],
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    coordinates: Coordinates,
    number: int,
) -> list[Suspect]:
    """Increase the p-values of rows that correlated noise can also explain.

    Only promising and significant rows are tested, and the p-values are corrected for `number`
    tests. No row is tested if the loss reduces the weight of outliers.
    """
    shown = {id(row) for row in promising(rows)} if result.loss.is_linear else set()

    def confirmed(row: Suspect) -> Suspect:
        key = (row.path, row.kind == "switch")
        if id(row) not in shown or key not in places or (row.p_value or 0.0) >= LEVEL:
            return row
        columns, inward = places[key]
        of_runs = [response.columns[..., columns] for response in at]
        single = among_memory(result, runs, at, coordinates, of_runs, inward)
        p_value = max(row.p_value or 0.0, min(number * single, 1.0))
        return dataclasses.replace(row, p_value=p_value)

    return [confirmed(row) for row in rows]


# Decrease of chi-square by a suspect, beyond that by others, above which they do not explain it.
_APART = 6.0
_MEMBERS = 3  # members of a group in addition to the first
_MOST = 24  # maximum number of suspects that are compared


def _in_groups(
    rows: Sequence[Suspect],
    tested: Mapping[tuple[str, bool], list[int]],
    rest: Projected,
    scale: float,
) -> list[Suspect]:
    """Group the rows that the data cannot distinguish.

    The most promising significant row leads a group of the rows that explain it: a single other
    row, or as few rows as necessary. Rows that the leading row explains are marked as explained by
    it.
    """
    enough = _APART * scale
    key = {id(row): (row.path, row.kind == "switch") for row in rows}
    left = [
        row
        for row in promising(rows)
        if (row.chi_square_drop or 0.0) > enough and key[id(row)] in tested
    ][:_MOST]
    told: dict[int, Suspect] = {}

    def beyond(row: Suspect, others: Sequence[Suspect]) -> float:
        given = [place for other in others for place in tested[key[id(other)]]]
        # The expected decrease by chance of the same number of columns is subtracted.
        chance = scale * (len(tested[key[id(row)]]) - 1)
        return drop_beyond(rest, tested[key[id(row)]], given) - chance

    while left:
        first, *left = left
        if (first.p_value or 0.0) >= LEVEL:
            continue
        members = [other for other in left if beyond(first, [other]) < enough]
        if not members:
            while len(members) < min(_MEMBERS, len(left)) and beyond(first, members) >= enough:
                others = [other for other in left if other not in members]
                members.append(min(others, key=lambda other: beyond(first, [*members, other])))
            if members and beyond(first, members) >= enough:
                members = []
        told[id(first)] = dataclasses.replace(
            first, together=tuple(other.path for other in members[:_MEMBERS])
        )
        explained = [o for o in left if o in members or beyond(o, [first]) < enough]
        for other in explained:
            told[id(other)] = dataclasses.replace(other, explained_by=first.path)
        left = [other for other in left if other not in explained]
    return [told.get(id(row), row) for row in rows]


def _with_moves(
    rows: Sequence[Suspect],
    places: Mapping[tuple[str, bool], tuple[list[int], int]],
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    coordinates: Coordinates,
) -> list[Suspect]:
    """Add the shifts of the fitted parameters that the steps of significant rows cause."""
    shown = {id(row) for row in rows if (row.p_value or 0.0) < LEVEL and row.testable}
    # A standard deviation has no direction.
    directed = [row for row in rows if id(row) in shown and row.kind != "scatter"]
    keys = {id(row): (row.path, row.kind == "switch") for row in directed}
    columns = sorted({place for key in keys.values() for place in places.get(key, ([], 0))[0]})
    if not columns:
        return list(rows)
    slopes = slopes_of(result, runs, at, columns, coordinates)
    errors = np.asarray([one.standard_error or np.nan for one in result.free.values()])

    def moved(row: Suspect) -> Suspect:
        key = keys.get(id(row))
        if key is None or key not in places:
            return row
        step = np.ravel(np.subtract(np.array(row.estimate), np.array(row.value)))
        shift = slopes[:, [columns.index(place) for place in places[key][0]]] @ step / errors
        known = dict(zip(result.free, shift.tolist(), strict=True))
        return dataclasses.replace(row, moves={p: by for p, by in known.items() if by == by})

    return [moved(row) for row in rows]


# The columns of a test need fewer digits than its residuals and take much longer. They are computed
# at this tolerance of the integrator, or at a coarser one if it is sufficient for the fit.
_COLUMNS = 1e-6


def linearised(result: FitResult, runs: Sequence[Run], asked: Inquiry) -> list[Response]:
    """Return the responses of each run at the end of the fit; fitted parameters come first."""
    directions = [*asked.free, *(candidate.direction for candidate in asked.candidates)]
    known, coarser = capabilities.integration(asked.model), None
    if known is not None and known.tolerance is not None and known.tolerance < _COLUMNS:
        coarser = capabilities.refined(asked.model, _COLUMNS / known.tolerance)
    if coarser is None:
        return responses_of(result, runs, asked.model, directions)
    columns = responses_of(result, runs, coarser, directions)
    exact = responses_of(result, runs, asked.model)
    return [
        dataclasses.replace(one, predicted=of.predicted)
        for one, of in zip(columns, exact, strict=True)
    ]


def _switches(
    result: FitResult, asked: Inquiry, runs: Sequence[Run], *, every: bool
) -> dict[str, list[np.ndarray]]:
    """Return, by the name of each choice of the model, the change of the predictions of each run.

    Without `every`, only the choices are included that explain why a nuisance parameter differs
    from its usual value.
    """
    if not (every or result.nuisances):
        return {}
    free = {direction.path for direction in asked.free}
    asked_of: dict[str, AbstractModel] = {
        name: variant
        for name, variant in capabilities.variants(result.model).items()
        if free <= set(declared(variant)) and (every or _explains(result, variant))
    }
    if not asked_of:
        return {}

    def predicted(name: str | None, _: Tell) -> list[Response]:
        model = result.model if name is None else asked_of[name]
        # Use the same steps of the integrator as for the columns.
        paths = [one.direction.path for one in asked.candidates]
        stepped = capabilities.for_derivatives(model, paths)
        try:
            found = responses_of(result, runs, stepped, variant=name)
        except InputError:
            if name is None:
                raise
            found = []  # This choice cannot be evaluated with these values.
        return found

    # Each choice requires its own program. Programs are compiled in parallel.
    jobs = [functools.partial(predicted, name) for name in (None, *asked_of)]
    base, *others = all_in_threads(jobs)
    return {
        name: [one.predicted - of.predicted for one, of in zip(other, base, strict=True)]
        for name, other in zip(asked_of, others, strict=True)
        if other
    }


# Difference, in standard errors, above which a change of a nuisance parameter is significant.
_SURELY = 3.0


def _explains(result: FitResult, variant: AbstractModel) -> bool:
    """Return whether a variant of the model changes a nuisance parameter significantly."""
    for path in result.nuisances:
        estimate, other = result.free[path], float(get(variant, path))
        apart = abs(float(estimate.value) - other)
        if apart and apart > _SURELY * (estimate.standard_error or np.inf):
            return True
    return False


def _corrected(rows: Sequence[Suspect], further: int) -> tuple[list[Suspect], int]:
    """Return rows with p-values corrected by Holm's method, and the number of tests.

    In addition to the tests with a row there were `further` ones, and only the best of these has a
    row.
    """
    single = {index: row.p_value for index, row in enumerate(rows) if row.p_value is not None}
    number, corrected, highest = len(single) + further, list(rows), 0.0
    for rank, index in enumerate(sorted(single, key=lambda index: single[index])):
        highest = max(highest, min(1.0, single[index] * (number - rank)))
        corrected[index] = dataclasses.replace(rows[index], p_value=highest)
    return corrected, number
