"""Where the values of the model's parameters stand in the free coordinate.

A parameter has one value for all runs, or one for each group of runs.
"""

import difflib
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from .._errors import InputError
from ..runs import Run

Groups = Mapping[str, Sequence[Sequence[int]]]
"""By path, the groups of runs (by position) that have a value of their own."""


class Named(Protocol):
    """A run, or what a result says of one."""

    @property
    def name(self) -> str:
        """Of the run."""

    @property
    def recording(self) -> str:
        """Name of the recording that it is, or is a window of."""


class Layout(NamedTuple):
    """Positions in the free coordinate, which begins with the parameters of the model.

    Attributes:
        places: by parameter, the positions of its values: one, or one for each group of runs.
        of_runs: by run, the position of the value of each parameter.
    """

    places: tuple[tuple[int, ...], ...]
    of_runs: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, paths: Sequence[str], groups: Groups, runs: int) -> "Layout":
        """The layout of the parameters of some runs.

        Arguments:
            paths: of the parameters, in their order.
            groups: of runs, each run in one; nothing for what all runs share.
            runs: how many there are.
        """
        places, first = [], 0
        of_runs = np.zeros((runs, len(paths)), dtype=int)
        for column, path in enumerate(paths):
            sharing = groups.get(path, [range(runs)])
            places.append(tuple(range(first, first + len(sharing))))
            for place, members in zip(places[-1], sharing, strict=True):
                of_runs[list(members), column] = place
            first += len(sharing)
        return cls(tuple(places), tuple(map(tuple, of_runs.tolist())))

    @property
    def size(self) -> int:
        """Number of values."""
        return sum(map(len, self.places))


def names_of(runs: Sequence[Run]) -> str:
    """Names of runs that share something, for a person; windows of one recording are one."""
    if len(runs) == 1:
        return f"'{runs[0].name}'"
    return ", ".join(dict.fromkeys(f"'{run.recording}'" for run in runs))


def sharing(
    runs: Sequence[Run], per_run: Sequence[str], groups: Mapping[str, Sequence[Sequence[str]]]
) -> dict[str, list[list[str]]]:
    """By path, names of the runs that share a value: each recording alone, or those of a group.

    Raises:
        InputError: a path is in both, or two recordings have one name.
    """
    recordings: dict[str, object] = {}
    for run in runs if per_run or groups else ():
        name, recording = run.recording, run.path or id(run)
        if recordings.setdefault(name, recording) != recording:
            raise InputError(
                f"two runs are called '{name}', so that nothing can be said of one of them: "
                "rename one"
            )
    alone = [[name] for name in dict.fromkeys(run.recording for run in runs)]
    for path in sorted(set(per_run) & set(groups)):
        raise InputError(f"'{path}' has a value for each run and groups of runs: give one of them")
    each = {path: [list(names) for names in sharing] for path, sharing in groups.items()}
    return {**dict.fromkeys(per_run, alone), **each}


def members(
    path: str, runs: Sequence[Named], groups: Sequence[Collection[str]]
) -> tuple[tuple[int, ...], ...]:
    """Positions of the runs in each group of a path, by their names or those of recordings.

    Raises:
        InputError: a name that no run has, or a run that is not in exactly one group.
    """
    known = {name for run in runs for name in (run.name, run.recording)}
    for name in (name for names in groups for name in names):
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            remedy = f"did you mean '{near[0]}'?" if near else "name runs as their files"
            raise InputError(f"the groups of '{path}' name '{name}', which is no run: {remedy}")
    positions = tuple(
        tuple(i for i, run in enumerate(runs) if {run.name, run.recording} & set(names))
        for names in groups
    )
    for index, run in enumerate(runs):
        count = sum(index in group for group in positions)
        if count != 1:
            where = "no group" if count == 0 else "several groups"
            raise InputError(f"run '{run.name}' is in {where} of '{path}': put it in one")
    return tuple(group for group in positions if group)
