"""Uncertain properties of devices and constants, which are free in a fit, with priors.

No test detects an omission that the fitted parameters can imitate: a camera delay that is wrong by
two standard errors is not noticed, but shifts a correlated drag coefficient by ten.
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
    """Return the settings with priors and ties of the nuisance parameters, and their paths.

    The nuisance parameters are those that the runs list in `[uncertainty]`, otherwise the usual
    ones of the devices of the model (`giajax.models.capabilities.uncertain`). If one number applies
    to an array, its first element is free, and the other elements are tied to it. Parameters that
    the settings mention are not changed.

    Raises:
        InputError: `[uncertainty]` contains a path that is not a parameter, or a wrong number of
            values, or the runs contradict each other.
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
    """Return the ties of the other elements of an array to the first, with a prefix for each."""
    if not any(before.values()):
        return {path: first} if before else {}
    return {other: f"{factor}{first}" for other, factor in before.items()}


def _stated(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the standard deviations that the runs give in `[uncertainty]`, by path."""
    stated: dict[str, Any] = {}
    for run in runs:
        for path, deviations in run.definition.uncertainty.deviations.items():
            if stated.setdefault(path, deviations) != deviations:
                raise InputError(
                    f"the runs have different values for {path} in [uncertainty]: give one value, "
                    "or fit the runs separately"
                )
    return stated


def _neutrally(model: AbstractModel, path: str) -> AbstractModel:
    """Return the model with an omitted parameter switched on at its neutral value, as an array."""
    name = path.partition("[")[0]
    absent = left_out(model).get(name)
    if absent is not None:
        about = absent.declaration
        if not about.lower < about.neutral < about.upper:
            raise InputError(
                f"[uncertainty] contains {path}, which is not part of this model: give the value "
                f"of {path}, too"
            )
        model = absent.set(model, about.neutral)
    if name in capabilities.scattering(model):
        model = in_full(model, declared(model)[name])
    return model


def in_full(model: AbstractModel, parameter: Parameter) -> AbstractModel:
    """Return the model with a value of this parameter for each joint or link instead of one."""
    value = np.asarray(parameter.value(model))
    if value.ndim or parameter.any_number:
        return model
    for other in declared(model).values():
        count = np.asarray(other.value(model)).shape
        if other.declaration.per and not other.declaration.each and count:
            return parameter.set(model, np.full(count, float(value)))
    return model


def with_scattering(model: AbstractModel, paths: Iterable[str]) -> AbstractModel:
    """Return the model with separate values for each joint of named parameters that may scatter.

    The same applies to parameters of which a single element is named, if single elements may be
    wrong.
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
    """Add the priors of a path, and the ties of the elements that depend on them."""
    parts = elements(model, path)
    sizes = np.asarray(deviations, dtype=float)
    if sizes.size not in (1, len(parts)):
        raise InputError(
            f"[uncertainty] gives {sizes.size} values for {path}, which has {len(parts)} "
            f"element{'s' * (len(parts) != 1)}: give one value, or one for each element"
        )
    values = [float(part.value(model)) for part in parts]
    if sizes.ndim == 0 and len(parts) > 1 and not parts[0].declaration.shape:
        if sizes:
            # All elements deviate by the same amount.
            apart = [f"{value - values[0]!r} + " * (value != values[0]) for value in values[1:]]
            names = [part.path for part in parts[1:]]
            ties |= _followers(path, parts[0].path, dict(zip(names, apart, strict=True)))
        parts = parts[:1]
    each = np.broadcast_to(sizes, (len(parts),)).tolist()
    for part, value, size in zip(parts, values, each, strict=False):
        if size:
            priors[part.path] = PriorEntry(value=value, deviation=size)
