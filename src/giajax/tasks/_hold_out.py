"""A fit of which something is held out: what it is fitted to, and what it is judged by."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import InputError
from ..fitting import Beginning, FitResult, Setup, not_judged, set_up, with_held_out
from ..models import AbstractModel, model_for
from ..runs import Definition, Parted, Run, hold_out

Groups = Mapping[str, Sequence[Sequence[str]]]


@dataclasses.dataclass(frozen=True)
class HoldOut:
    """What is held out of the runs of a fit.

    Attributes:
        parts: of each run.
        whole: the setup of the fit, were nothing held out.
    """

    parts: tuple[Parted, ...]
    whole: Setup

    def judge(self, result: FitResult) -> FitResult:
        """The result with how well it predicts what was held out."""
        return with_held_out(result, self.whole, self.parts)

    def left(self, result: FitResult) -> FitResult:
        """The result with what was held out, where nothing is known of how it is predicted."""
        return not_judged(result, self.parts)


def set_up_parts(
    definition: Definition, runs: Sequence[Run], begin: Beginning | None
) -> tuple[Setup, HoldOut | None]:
    """What a fit is asked, and what of its runs is held out.

    Arguments:
        definition: all settings.
        runs: those that it names.
        begin: where another fit ended; None for a start as the settings say.

    Returns:
        The setup of the fit, whose `config` says what is held out; and that, if it is anything.

    Raises:
        InputError: as `giajax.fit`, or a `hold_out` that names nothing, or everything.
    """
    settings = definition.fit
    names, groups = settings.hold_out or (), settings.groups or {}

    def set_up_for(model: AbstractModel, runs: Sequence[Run], groups: Groups) -> Setup:
        return set_up(
            model,
            runs,
            free=settings.free,
            start=settings.start,
            fix=settings.fix,
            loss=settings.loss or "linear",
            noise_model=settings.noise_model or "correlated",
            noise_per_run=bool(settings.noise_per_run),
            solver=settings.solver,
            tolerance=settings.tolerance,
            priors={path: entry.prior() for path, entry in settings.priors.items()},
            bounds=settings.bounds,
            ties=settings.ties,
            per_run=settings.per_run or (),
            groups=groups,
            begin=begin,
        )

    if not names:
        return set_up_for(model_for(runs), runs, groups), None
    parts = hold_out(runs, names)
    fitted = [part.fitted for part in parts if part.fitted is not None]
    for model in dict.fromkeys(run.model for run in runs):
        if fitted and not any(run.model == model for run in fitted):
            raise InputError(
                f"every run of the {model} model is held out, so that no model predicts them: "
                "hold out only some of them"
            )
    if len(fitted) < len(parts):
        model_for(runs)  # refuses runs whose sidecars contradict each other
    setup = set_up_for(model_for(fitted), fitted, _among(groups, fitted, runs))
    whole = set_up_for(setup.model, runs, groups)
    config: dict[str, list[dict[str, Any]]] = {"runs": [], "hold_out": []}
    records = iter(setup.config["runs"])
    for part, record in zip(parts, whole.config["runs"], strict=True):
        first = {} if part.held is None else _first_rows(part.held)
        if part.fitted is not None:
            partly = {name: row for name, row in first.items() if name in part.fitted.observations}
            config["runs"].append({**next(records), **({"held_from": partly} if partly else {})})
        if part.held is not None:
            channels = list(part.held.observations)
            config["hold_out"].append({**record, "channels": channels, "held_from": first})
    return dataclasses.replace(setup, config={**setup.config, **config}), HoldOut(parts, whole)


def _among(groups: Groups, runs: Sequence[Run], everything: Sequence[Run]) -> Groups:
    """The groups without the runs that are not among these."""

    def names_of(several: Sequence[Run]) -> set[str]:
        return {name for run in several for name in (run.name, run.recording)}

    gone = names_of(everything) - names_of(runs)
    kept = {
        path: [[name for name in names if name not in gone] for names in sharing]
        for path, sharing in groups.items()
    }
    return {path: [names for names in sharing if names] for path, sharing in kept.items()}


def _first_rows(held: Run) -> dict[str, int]:
    """By channel, the first sample that is held out."""
    return {name: int(np.argmax(~np.isnan(cells))) for name, cells in held.observations.items()}
