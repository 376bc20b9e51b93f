"""Names of the free coordinates of a fit."""

from collections.abc import Sequence

from ..runs import Run
from ._layout import names_of
from ._problem import Problem


def coordinate_paths(problem: Problem) -> list[str]:
    """Path of the parameter at each position of the free coordinate."""
    names = [""] * problem.size
    for path, places in zip(problem.paths, problem.positions, strict=True):
        for place in places:
            names[place] = path
    for group in problem.groups:
        for columns in group.own_columns():
            for label, column in zip(group.own_labels(), columns.tolist(), strict=True):
                names[column] = label
    return names


def labels(problem: Problem, runs: Sequence[Run]) -> list[str]:
    """Names of all free coordinates, each with the runs that it belongs to, if that is not all.

    Arguments:
        problem: what is minimised.
        runs: what is fitted to.
    """
    sharing: dict[int, list[int]] = {}
    for group in problem.groups:
        for member, columns in zip(group.members, group.columns(), strict=True):
            for column in columns.tolist():
                sharing.setdefault(column, []).append(member)
    common = {places[0] for places in problem.positions if len(places) == 1}
    return [
        path if index in common else f"{path} of {names_of([runs[i] for i in sorted(who)])}"
        for index, path in enumerate(coordinate_paths(problem))
        for who in [sharing[index]]
    ]
