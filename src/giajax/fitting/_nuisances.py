"""What is always uncertain of devices and constants: free in a fit, with a prior.

No test finds an omission that what is fitted imitates: a camera that is late by two standard errors
of its delay is not seen, and moves a drag coefficient that is correlated with it by ten.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..models import AbstractModel, capabilities
from ..recordings import FitSettings, PriorEntry, Run
from ..runtime.text import InputError
from ..schema.parameters import (
    Parameter,
    declared,
    default_free,
    elements,
    left_out,
    switched_on,
)


def with_nuisances(
    model: AbstractModel, runs: Sequence[Run], settings: FitSettings
) -> tuple[FitSettings, tuple[str, ...]]:
    """The settings with the priors and ties of what is uncertain, and the paths of that, to free.

    It is what `[uncertainty]` of the runs states, else what is usual of the model's devices
    (`giajax.models.capabilities.uncertain`). Of an array with one number the first element is free,
    and the others follow it. What the settings say anything of is theirs.

    Raises:
        InputError: `[uncertainty]` names what is not a parameter or has another number of values,
            or the runs contradict each other in it.
    """
    if not settings.nuisances:
        return settings, ()
    stated = _stated(runs)
    chosen = default_free(model, settings.start) if settings.free is None else settings.free
    said: list[Iterable[str]] = [chosen, settings.start, settings.fix, settings.priors]
    said += [settings.bounds, settings.ties, settings.per_run, settings.groups]
    said += [settings.uncertainty]
    theirs = {path.partition("[")[0] for each in said for path in each}
    priors: dict[str, PriorEntry] = {}
    ties: dict[str, str] = {}
    by_default = [run for run in runs if run.definition.uncertainty.defaults]
    for path, prior in capabilities.uncertain(model, by_default).items() if by_default else ():
        if path in theirs or any(path == each.partition("[")[0] for each in stated):
            continue
        there = switched_on(model, [path])
        first, *others = elements(there, path)
        priors[first.path] = PriorEntry.model_validate(prior.contents())
        value = float(first.value(there))
        ratios = {each.path: float(each.value(there)) / (value or 1.0) for each in others}
        ties |= _followers(path, first.path, {p: f"{r!r} * " * (r != 1) for p, r in ratios.items()})
    for path, deviations in stated.items():
        if path.partition("[")[0] not in theirs:
            _add(_neutrally(model, path), path, deviations, priors, ties)
    if not priors:
        return settings, ()
    changed = {"priors": {**settings.priors, **priors}, "ties": {**settings.ties, **ties}}
    return settings.model_copy(update=changed), tuple(priors)


def _followers(path: str, first: str, before: Mapping[str, str]) -> dict[str, str]:
    """Ties of the other elements of an array to the first, by what stands before it for each."""
    if not any(before.values()):
        return {path: first} if before else {}
    return {other: f"{factor}{first}" for other, factor in before.items()}


def _stated(runs: Sequence[Run]) -> dict[str, Any]:
    """What the runs say of how surely something is known, by path."""
    stated: dict[str, Any] = {}
    for run in runs:
        for path, deviations in run.definition.uncertainty.deviations.items():
            if stated.setdefault(path, deviations) != deviations:
                raise InputError(
                    f"the runs state different values of [uncertainty] for {path}: state one "
                    "value, or fit the runs separately"
                )
    return stated


def _neutrally(model: AbstractModel, path: str) -> AbstractModel:
    """The model with what a path names on, where it does nothing yet, and in full."""
    name = path.partition("[")[0]
    absent = left_out(model).get(name)
    if absent is not None:
        about = absent.declaration
        if not about.lower < about.neutral < about.upper:
            raise InputError(
                f"[uncertainty] names {path}, which this model omits: state its value, too"
            )
        model = absent.set(model, about.neutral)
    if name in capabilities.scattering(model):
        model = in_full(model, declared(model)[name])
    return model


def in_full(model: AbstractModel, parameter: Parameter) -> AbstractModel:
    """The model with a value of this parameter for each joint or link, not one for all."""
    value = np.asarray(parameter.value(model))
    if value.ndim or parameter.any_number:
        return model
    for other in declared(model).values():
        count = np.asarray(other.value(model)).shape
        if other.declaration.per and not other.declaration.each and count:
            return parameter.set(model, np.full(count, float(value)))
    return model


def with_scattering(model: AbstractModel, paths: Iterable[str]) -> AbstractModel:
    """The model with a value of its own for each joint of what is named and may scatter.

    Likewise of what may be wrong of one element, where an element is named.
    """
    parts = [path.partition("[") for path in paths]
    named = {name for name, _, _ in parts}.intersection(capabilities.scattering(model))
    named |= {name for name, _, of in parts if of}.intersection(capabilities.one_by_one(model))
    for path in sorted(named):
        model = switched_on(model, [path])
        model = in_full(model, declared(model)[path])
    return model


def _add(
    model: AbstractModel,
    path: str,
    deviations: float | list[float],
    priors: dict[str, PriorEntry],
    ties: dict[str, str],
) -> None:
    """Add the priors of a path, and what follows from what it has them of."""
    parts = elements(model, path)
    sizes = np.asarray(deviations, dtype=float)
    if sizes.size not in (1, len(parts)):
        raise InputError(
            f"[uncertainty] states {sizes.size} values for {path}, which has {len(parts)}: give "
            "one value, or one for each element"
        )
    values = [float(part.value(model)) for part in parts]
    if sizes.ndim == 0 and len(parts) > 1 and not parts[0].declaration.shape:
        if sizes:
            # All are off by as much.
            apart = [f"{value - values[0]!r} + " * (value != values[0]) for value in values[1:]]
            names = [part.path for part in parts[1:]]
            ties |= _followers(path, parts[0].path, dict(zip(names, apart, strict=True)))
        parts = parts[:1]
    each = np.broadcast_to(sizes, (len(parts),)).tolist()
    for part, value, size in zip(parts, values, each, strict=False):
        if size:
            priors[part.path] = PriorEntry(value=value, deviation=size)
