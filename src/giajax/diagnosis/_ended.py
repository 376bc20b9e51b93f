"""A fit where it ended: what it could move, what follows from it, and what was known of it."""

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from ..fitting import (
    Direction,
    FitResult,
    Response,
    checked_priors,
    layout_of,
    prior_of,
    prior_row,
    resolved_ties,
    responses,
    tied,
)
from ..models import AbstractModel
from ..parameters import declared, get, replace
from ..runs import Run

Array = np.ndarray


def varied_values(result: FitResult) -> list[dict[str, float]]:
    """Of each run, the values of the model's parameters that not all runs share, by path."""
    known = declared(result.model)
    return [
        {
            path: estimate.value
            for path, estimate in record.parameters.items()
            if path in result.free and path.partition("[")[0] in known
        }
        for record in result.runs
    ]


def models_of_runs(result: FitResult) -> list[AbstractModel]:
    """The fitted model as it is for each run."""
    ties = resolved_ties(result.model, result.config.get("ties", {}))
    return [
        tied(replace(result.model, values), ties) if values else result.model
        for values in varied_values(result)
    ]


def responses_of(
    result: FitResult,
    runs: Sequence[Run],
    model: AbstractModel,
    directions: Sequence[Direction] = (),
    *,
    variant: str | None = None,
) -> list[Response]:
    """The responses of each run where a fit ended, what is tied moving with what it follows from.

    Arguments:
        result: of the fit.
        runs: that were fitted.
        model: the fitted one, with further parts or another choice.
        directions: what to differentiate by.
        variant: name of that choice; what not all runs share is as it is with it.

    Raises:
        InputError: the model cannot be evaluated there, or lacks what a tie follows from.
    """
    values = varied_values(result)
    if variant is not None and any(values):
        others = [of_run.variants()[variant] for of_run in models_of_runs(result)]
        values = [
            {path: float(get(other, path)) for path in of_run}
            for other, of_run in zip(others, values, strict=True)
        ]
    own = [
        {label: estimate.value for label, estimate in record.parameters.items()}
        for record in result.runs
    ]
    ties = resolved_ties(model, result.config.get("ties", {}))
    return responses(model, runs, directions, own, values=values, ties=ties)


@dataclasses.dataclass(frozen=True)
class Moved:
    """The coordinates of a fit: those that several runs share, and those of single runs.

    Attributes:
        places: of each run, where the value of each free parameter stands among what is shared;
            -1 where no other run has it.
        shared: the free parameter of each shared coordinate, by its position among all.
        known: rows of the residual that are priors of what is shared, and their derivatives by it,
            shape (prior, 1 + shared).
        known_of_runs: of each run, the same for what it has alone, shape (prior, 1 + own).
    """

    places: tuple[tuple[int, ...], ...]
    shared: tuple[int, ...]
    known: Array
    known_of_runs: tuple[Array, ...]

    @classmethod
    def of(cls, result: FitResult) -> Self:
        """The coordinates of a fit, and what was known of them before."""
        paths = list(result.free)
        layout = layout_of(result.runs, paths, result.config.get("groups", {}))
        alone = {
            place
            for place in range(layout.size)
            if len(result.runs) > 1 and sum(place in of_run for of_run in layout.of_runs) == 1
        }
        order = [place for place in range(layout.size) if place not in alone]
        position = {place: index for index, place in enumerate(order)}
        places = tuple(
            tuple(position.get(place, -1) for place in of_run) for of_run in layout.of_runs
        )
        owners = {place: index for index, of in enumerate(layout.places) for place in of}
        shared = tuple(owners[place] for place in order)
        varied = varied_values(result)
        priors = checked_priors(result.config.get("priors", {}))

        def rows(named: Sequence[tuple[str, float]]) -> Array:
            """Rows of the priors of some coordinates, by their paths and values."""
            known = []
            for column, (path, value) in enumerate(named):
                if (prior := prior_of(priors, path)) is not None:
                    row = np.zeros(1 + len(named))
                    row[0], row[1 + column] = prior_row(prior, value)
                    known.append(row)
            return np.stack(known) if known else np.zeros((0, 1 + len(named)))

        def value_at(place: int) -> float:
            path = paths[owners[place]]
            of_run = next(run for run, there in enumerate(layout.of_runs) if place in there)
            return varied[of_run].get(path, float(result.free[path].value))

        of_runs = []
        for record, of_run, values in zip(result.runs, places, varied, strict=True):
            mine = [(paths[i], values[paths[i]]) for i, place in enumerate(of_run) if place < 0]
            mine += [
                (label, estimate.value)
                for label, estimate in record.parameters.items()
                if label not in values
            ]
            of_runs.append(rows(mine))
        return cls(
            places=places,
            shared=shared,
            known=rows([(paths[owners[place]], value_at(place)) for place in order]),
            known_of_runs=tuple(of_runs),
        )

    def split(self, run: int, columns: Array, own: Array) -> tuple[Array, Array]:
        """Columns of the free parameters by the shared coordinates, and by those of a run.

        Arguments:
            run: its position.
            columns: by each free parameter, shape (sample, channel, parameter).
            own: by what is free in each run by its nature, shape (sample, channel, own).
        """
        places = np.asarray(self.places[run], dtype=int)
        shared = np.zeros((*columns.shape[:2], len(self.shared)))
        shared[..., places[places >= 0]] = columns[..., places >= 0]
        return shared, np.concatenate([columns[..., places < 0], own], axis=-1)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.shared) + sum(rows.shape[1] - 1 for rows in self.known_of_runs)

    @property
    def squares(self) -> float:
        """What the priors add to chi-square: each counts as a measurement."""
        rows = [self.known, *self.known_of_runs]
        return float(sum(np.sum(each[:, 0] ** 2) for each in rows))
