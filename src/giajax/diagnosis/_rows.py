"""Tests of parameters and of choices of a model, as rows of the table."""

from collections.abc import Sequence

import numpy as np

from ..fitting import Suspect
from ._candidates import Candidate, Inquiry
from ._projection import Projected
from ._score import IMITATED, Score, alike, score

# A change by so many times its own size that would still not show makes a parameter not testable.
_NOT_SHOWN = 3.0
_ALIKE = 0.99


def parameter_rows(rest: Projected, asked: Inquiry) -> list[Suspect]:
    candidates = asked.candidates
    notes = [_why_not(rest, index, one) for index, one in enumerate(candidates)]
    members: dict[str, list[int]] = {}
    for index, (one, note) in enumerate(zip(candidates, notes, strict=True)):
        if not note:
            members.setdefault(one.path, []).append(index)
            if one.group:
                members.setdefault(one.group, []).append(index)
    members = {
        path: several
        for path, several in members.items()
        if len(several) > 1 or candidates[several[0]].path == path
    }
    rows = [_not_testable(one, note) for one, note in zip(candidates, notes, strict=True) if note]
    for path, indices in members.items():
        among = [candidates[index] for index in indices]
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
    return rows


def _row(path: str, among: Sequence[Candidate], found: Score, others: tuple[str, ...]) -> Suspect:
    value = [one.value for one in among]
    estimate = [one.value + float(step) for one, step in zip(among, found.step, strict=True)]
    error = [float(number) for number in found.error]
    group = len(among) > 1
    note = ""
    if not group and (value[0] <= among[0].lower or value[0] >= among[0].upper):
        note = "held at its bound: tested towards the inside"
        if found.drop == 0:
            note += ", and the data lead outwards"
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


def _why_not(rest: Projected, index: int, one: Candidate) -> str:
    """Why a candidate is not testable; empty where it is."""
    norm, left = float(rest.norms[index]), float(rest.perpendicular[index])
    if not np.isfinite(norm):
        return "its derivative is not finite here"
    if norm * one.size < 1e-6:
        return "no channel responds to it"
    if left < IMITATED * norm:
        return "what was fitted imitates it: only a ratio shows"
    if left * one.size * _NOT_SHOWN < 1:
        return f"the data would not show a change by {_NOT_SHOWN:g} times its size"
    return ""


def _not_testable(one: Candidate, note: str) -> Suspect:
    return Suspect(
        one.path, one.kind, one.unit, one.value, None, None, None, 1, None, False, (), note
    )


def impossible_row(path: str, reason: str) -> Suspect:
    return Suspect(path, "parameter", "", None, None, None, None, 1, None, False, (), reason)


def switch_row(rest: Projected, index: int, name: str) -> Suspect:
    norm, left = float(rest.norms[index]), float(rest.perpendicular[index])
    if norm < 1 or left < max(1.0, IMITATED * norm):
        note = "what was fitted imitates it" if norm >= 1 else "it changes no prediction"
        return Suspect(name, "switch", "", 0.0, None, None, None, 1, None, False, (), note)
    found = score(rest, [index], [0.0], [1.0])
    return Suspect(
        path=name,
        kind="switch",
        unit="",
        value=0.0,
        estimate=float(found.step[0]),
        estimate_error=float(found.error[0]),
        chi_square_drop=found.drop,
        degrees_of_freedom=1,
        p_value=found.p_value,
        testable=True,
    )
