"""What a design is asked, resolved once: the arm, what is free and wanted, noise and knowledge.

Longer than 200 lines because what a fit says and what the caller says are brought together here.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from .._errors import InputError
from .._typing import Float
from ..fitting import (
    FitResult,
    Tie,
    checked_priors,
    prior_of,
    prior_row,
    resolved_ties,
    tied,
)
from ..kinds import ARM
from ..models import AbstractModel, ArmModel
from ..parameters import Parameter, default_free, elements, get, switched_on
from ..quantities import Prior
from ..runs import Channel, Definition, Run
from ..study import body_of
from ..synthetic import Drive, sampled
from ._command import base_step
from ._information import Experiment
from ._limits import Limits
from ._uncertainty import known_before, uncertain

# Of positions (m) and of angles (rad, rad/s), where nobody states it: as `giajax sensitivity`.
_NOISE = 0.01
_NOISE_PIXEL = 2.0
_NOISE_ANGLE = math.radians(0.5)

# A tolerance at which derivatives are right to a percent, and quick.
_TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True)
class Question:
    """What a design is asked.

    Attributes:
        model: the arm at the present values.
        limits: what the command may do.
        parameters: what is free in a fit, with the bounds that each declares.
        values: present ones, SI, shape (parameter,).
        wanted: the weight of each parameter of interest, by path, in 1 over its unit.
        weighted: whether the caller gave these weights.
        deviations: what each is uncertain by, SI, by path.
        correlation: of that, shape (parameter, parameter).
        known: information that priors are, in scales, with what is free in the run alone.
        experiment: what is recorded.
        bodies: names of what may be recorded.
        noise: of a cell, SI, by channel.
        ties: parameters that follow from others.
        before: standard errors of the fit that was given; may be empty.
        definition: what the sidecar of the experiment says.
    """

    model: ArmModel
    limits: Limits
    parameters: tuple[Parameter, ...]
    values: Float[np.ndarray, " parameter"]
    wanted: dict[str, float]
    weighted: bool
    deviations: dict[str, float]
    correlation: Float[np.ndarray, "parameter parameter"]
    known: Float[np.ndarray, "parameter parameter"]
    experiment: Experiment
    bodies: tuple[str, ...]
    noise: dict[str, float]
    ties: tuple[Tie, ...]
    before: dict[str, float]
    definition: dict[str, Any]

    def weights(self, criterion: str) -> tuple[float, ...]:
        """Weights of all that is free, as `Criterion` takes them.

        Raises:
            InputError: several parameters without weights for "c".
        """
        if criterion == "c" and len(self.wanted) > 1 and not self.weighted:
            raise InputError(
                f"criterion c is of one number, and {len(self.wanted)} are wanted: give one "
                "parameter, the weight of each, or the criterion A or D"
            )
        own = (0.0,) * (len(self.known) - len(self.parameters))
        parts = zip(self.experiment.paths, self.experiment.scales, strict=True)
        if criterion == "c":
            return (*(self.wanted.get(path, 0.0) * float(scale) for path, scale in parts), *own)
        return (*(float(path in self.wanted) for path in self.experiment.paths), *own)

    def run_of(self, drive: Drive, name: str) -> Run:
        """The experiment with a command, without recorded values."""
        return _planned(self.limits, drive, self.experiment.channels, self.definition, name)


def question_of(
    source: AbstractModel | FitResult,
    wanted: Sequence[str] | Mapping[str, float],
    limits: Limits,
    *,
    free: Sequence[str] | None,
    channels: Sequence[str] | None,
    noise: Mapping[str, float] | None,
    priors: Mapping[str, Prior] | None,
    ties: Mapping[str, str] | None,
    uncertainty: float | Mapping[str, float] | None,
    definition: Mapping[str, Any] | None,
) -> Question:
    """The arguments of `design_experiment`, checked and resolved.

    Raises:
        InputError: as `design_experiment`.
    """
    result = source if isinstance(source, FitResult) else None
    model = _arm_of(source)
    if model.tolerance is None:
        model = model.with_integration(solver=None, tolerance=_TOLERANCE)
    weighted = isinstance(wanted, Mapping)
    weights = dict(wanted) if isinstance(wanted, Mapping) else dict.fromkeys(wanted, 1.0)
    if not weights:
        raise InputError("no parameter is to be found: give the path of at least one")
    model = switched_on(model, [path.partition("[")[0] for path in weights])
    asked = free or ()
    if free is None:
        free = default_free(model) if result is None else tuple(result.free)
    named = list(dict.fromkeys([*weights, *free]))
    settings = {} if result is None else result.config
    texts = settings.get("ties", {}) if ties is None else ties
    model = switched_on(model, [*named, *texts])
    limits.check_joints(model.arm.count)
    order = resolved_ties(model, texts)
    model = tied(model, order)
    parts = {part.path: part for path in named for part in elements(model, path)}
    interest = {p.path: weight for path, weight in weights.items() for p in elements(model, path)}
    for path in (path for tie in order for path in tie.elements):
        if path in interest or path in asked:
            raise InputError(f"'{path}' is tied to others: ask for what it follows from")
        parts.pop(path, None)
    before = checked_priors(settings.get("priors", {}) if priors is None else priors)
    values = np.asarray([float(part.value(model)) for part in parts.values()])
    scales = np.where(values != 0, np.abs(values), 1.0)
    names = tuple(channels or _positions(model.arm.count))
    stated = _definition(model, result, definition)
    run = _planned(limits, base_step(limits, 3).drive(), names, stated, "design", noise)
    for name in names:
        if name not in run.observations:
            raise InputError(f"'{name}' is commanded, not recorded: give another channel")
    inputs = model.prepare(run)
    own = tuple((path, get(inputs, path).size) for path in model.free_inputs(run))
    beside = [(f"{path}[{at}]", value) for path, _ in own for at, value in _numbered(inputs, path)]
    if priors is not None:
        _check_free(model, before, [*parts, *(path for path, _ in beside)])
    counted = [*zip(parts, values, scales, strict=True), *((*one, 1.0) for one in beside)]
    rows = [
        0.0 if (prior := prior_of(before, path)) is None else prior_row(prior, value)[1] * scale
        for path, value, scale in counted
    ]
    errors, correlation = (
        ({}, np.eye(len(parts))) if result is None else known_before(result, list(parts))
    )
    bodies = tuple(dict.fromkeys(body_of(name) for name in names))
    deviations = _noise(run, names, result)
    return Question(
        model=model,
        limits=limits,
        parameters=tuple(parts.values()),
        values=values,
        wanted=interest,
        weighted=weighted,
        deviations=uncertain(uncertainty, errors, result, dict(zip(parts, values, strict=True))),
        correlation=correlation if uncertainty is None else np.eye(len(parts)),
        known=np.diag(np.square(rows)),
        experiment=Experiment(
            model=model,
            inputs=inputs,
            joints=model.arm.count,
            paths=tuple(parts),
            scales=scales,
            own=own,
            ties=order,
            channels=names,
            noise=np.asarray(list(deviations.values())),
            bodies=tuple(bodies.index(body_of(name)) for name in names),
        ),
        bodies=bodies,
        noise=deviations,
        ties=order,
        before=errors,
        definition=stated,
    )


def joint_count(source: AbstractModel | FitResult) -> int:
    """How many joints an arm has, or that of a fit.

    Raises:
        InputError: it is no arm.
    """
    return _arm_of(source).arm.count


def _arm_of(source: AbstractModel | FitResult) -> ArmModel:
    given = source.model if isinstance(source, FitResult) else source
    if given.kind != ARM.name:
        raise InputError(f"the model is that of a {given.kind}: give that of an arm")
    return cast("ArmModel", given)


def _numbered(inputs: Any, path: str) -> list[tuple[int, float]]:
    """Position and present value of each number of what is free in the run alone."""
    return list(enumerate(np.ravel(get(inputs, path)).tolist()))


def _check_free(model: ArmModel, priors: Mapping[str, Prior], free: Sequence[str]) -> None:
    """Refuse priors of what is not free, or is no parameter."""
    known = {*free, *(path.partition("[")[0] for path in free)}
    for path in priors:
        if path not in known:
            elements(model, path)
            raise InputError(
                f"'{path}' has a prior and is not free: free it, or leave the prior out"
            )


def _positions(count: int) -> list[str]:
    return [f"link{i:02d}_{axis}" for i in range(1, count + 1) for axis in "xyz"]


def _definition(
    model: ArmModel, result: FitResult | None, definition: Mapping[str, Any] | None
) -> dict[str, Any]:
    """What the sidecar says: the arm, how commands go on between rows, and what the caller adds."""
    known = {key: part for key, part in model.definition().items() if key in ARM.sections}
    fitted = () if result is None else result.runs
    if any(path.startswith("initial.") for run in fitted for path in run.parameters):
        known["initial"] = {"free": True}
    command = {"interpolation": "linear"}
    return {"model": ARM.name, **known, **(definition or {}), "command": command}


def _planned(
    limits: Limits,
    drive: Drive,
    channels: Sequence[str],
    definition: Mapping[str, Any],
    name: str,
    noise: Mapping[str, float] | None = None,
) -> Run:
    times, inputs = sampled([drive], start=0.0, duration=limits.duration, rate=limits.sampling)
    blank = {channel: np.zeros(len(times)) for channel in channels}
    stated = Definition.parse(dict(definition), name)
    return Run.from_arrays(times, {**inputs, **blank}, name=name, noise=noise, definition=stated)


def _noise(run: Run, channels: Sequence[str], result: FitResult | None) -> dict[str, float]:
    """What is stated, else what a fit took for noise of such a quantity, else the usual; SI."""
    fitted: dict[str, list[float]] = {}
    for record in () if result is None else result.runs:
        for name, one in record.channels.items():
            channel = dataclasses.replace(Channel.named(name), unit=one.unit)
            fitted.setdefault(channel.quantity, []).append(float(channel.to_si(one.noise)))
    found = {}
    for name in channels:
        quantity = run.channels[name].quantity
        deviation = run.noise(name)
        if deviation is None and quantity in fitted:
            deviation = float(np.sqrt(np.mean(np.square(fitted[quantity]))))
        if deviation is None:
            usual = {"length": _NOISE, "pixel": _NOISE_PIXEL}
            deviation = usual.get(quantity, _NOISE_ANGLE)
        found[name] = deviation
    return found
