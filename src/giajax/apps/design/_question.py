"""What a design is asked, resolved once: the arm, what is free and wanted, noise and knowledge."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from ...fitting import FitResult, checked_priors, prior_of, prior_row, resolved_ties, tied
from ...models import AbstractModel, ArmModel
from ...recordings import Channel, Definition, Run
from ...runtime.arrays import Float
from ...runtime.text import InputError
from ...schema import ARM, Prior
from ...schema.parameters import Parameter, default_free, elements, get, switched_on
from ...studies import body_of, expected_errors
from ..synthetic import Drive, sampled
from ._search import Experiment, Limits, base_step

# What makes one experiment better than another: c-, A- and D-optimality.
#
# Each is the logarithm of an error to expect, of the covariance C of all that is free, nuisances
# too (Pukelsheim, Optimal Design of Experiments, chapters 3 and 6):
#
# - c: the standard error of one linear combination w^T p, the square root of w^T C w;
# - A: the root of the trace of C over the parameters of interest, and not of its inverse;
# - D: the geometric mean of their standard errors as if uncorrelated, det(C)^(1 / 2n).
#
# C counts each parameter in a scale of its own, its value by default; D does not depend on it.

_KINDS = ("c", "A", "D")

Matrix = Float[np.ndarray, "parameter parameter"]

# Without data a parameter is known to within so many times its scale: no matrix is singular, and
# a parameter that nothing responds to weighs nothing on the others.
_LOOSE = 100.0


@dataclasses.dataclass(frozen=True)
class Criterion:
    """The logarithm of an error to expect.

    The weights are, for "c", those of each parameter in the combination; for "A" and "D" that of
    the parameters of interest is not 0.
    """

    kind: str
    weights: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise InputError(f"'{self.kind}' is not a criterion: use one of: {', '.join(_KINDS)}")
        if not any(self.weights):
            raise InputError("no parameter to estimate is given: give the path of at least one")

    @property
    def rank(self) -> int:
        """In how many directions of the parameters information changes it, at most."""
        return 1 if self.kind == "c" else int(np.count_nonzero(self.weights))

    def of(self, covariance: Matrix) -> tuple[float, Matrix]:
        """Its value, and the derivative of that by the covariance."""
        weights = np.asarray(self.weights)
        slope = np.zeros_like(covariance)
        if self.kind == "c":
            variance = float(weights @ covariance @ weights)
            return 0.5 * np.log(variance), 0.5 * np.outer(weights, weights) / variance
        some = np.flatnonzero(weights)
        part = covariance[np.ix_(some, some)]
        if self.kind == "A":
            trace = float(np.trace(part))
            slope[some, some] = 0.5 / trace
            return 0.5 * np.log(trace), slope
        each = 0.5 / len(some)
        slope[np.ix_(some, some)] = each * np.linalg.inv(part)
        return each * float(np.linalg.slogdet(part)[1]), slope

    def is_determined(self, information: Matrix) -> bool:
        """Whether the data tell all that it is of, and not only what is known without them."""
        some, weights = np.flatnonzero(self.weights), np.asarray(self.weights)
        if self.kind == "c":
            # The combination takes the place of the parameter that has most of it.
            most = int(np.argmax(np.abs(weights)))
            turn = np.eye(len(weights))
            turn[most] = weights / weights[most]
            back = np.linalg.inv(turn)
            some, information = np.asarray([most]), back.T @ information @ back
        return bool(np.all(expected_errors(information)[some] < _LOOSE))

    def of_information(self, information: Matrix) -> tuple[float, Matrix]:
        """The same of the information, whose inverse the covariance is."""
        covariance = covariance_of(information)
        value, slope = self.of(covariance)
        return value, -covariance @ slope @ covariance


def covariance_of(information: Matrix) -> Matrix:
    """Covariance of scaled parameters, of which something is known without data, too."""
    whole = information + np.eye(len(information)) / _LOOSE**2
    sizes = np.sqrt(np.diag(whole))
    return np.asarray(np.linalg.inv(whole / np.outer(sizes, sizes)) / np.outer(sizes, sizes))


# Standard deviation over the value of what is free, where no fit and no caller says it.
_UNCERTAIN = 0.2

# A normal deviate beyond this is drawn at it: a design need not bear what hardly happens.
_FURTHEST = 2.0

# Logarithmic deviation of what is known badly: twice the value and half of it are as likely.
_MOST = math.log(2)


def draws(
    parameters: Sequence[Parameter],
    values: Float[np.ndarray, " parameter"],
    deviations: Mapping[str, float],
    correlation: Float[np.ndarray, "parameter parameter"],
    count: int,
) -> Float[np.ndarray, "draw parameter"]:
    """Values of the parameters that may be true, the first of which are the present ones (SI).

    What must be positive is log-normal, and within a factor of four. The others are normal; all
    are points of a Sobol sequence. What has no deviation is known.
    """
    if count < 1:
        raise InputError(f"the number of draws is {count}: give at least 1")
    found = np.tile(values, (count, 1))
    sizes = np.asarray([deviations.get(one.path, 0.0) for one in parameters])
    if count == 1 or not np.any(sizes):
        return found[:1]
    # Slow to import, and only needed here.
    from scipy.stats import norm, qmc

    # The first two points of the sequence are a corner and the middle.
    places = qmc.Sobol(len(parameters), scramble=False).fast_forward(2).random(count - 1)
    roots, turns = np.linalg.eigh(correlation)
    normal = norm.ppf(np.clip(places, 1e-6, 1 - 1e-6)) @ (turns * np.sqrt(np.maximum(roots, 0))).T
    normal = np.clip(normal, -_FURTHEST, _FURTHEST)
    for column, one in enumerate(parameters):
        lower, upper = one.declaration.lower, one.declaration.upper
        if lower >= 0 < values[column]:
            deviation = min(sizes[column] / values[column], _MOST)
            drawn = values[column] * np.exp(normal[:, column] * deviation)
        else:
            drawn = values[column] + normal[:, column] * sizes[column]
        found[1:, column] = np.clip(drawn, lower, upper)
    return found


def known_before(
    result: FitResult | None, paths: Sequence[str]
) -> tuple[dict[str, float], Float[np.ndarray, "parameter parameter"]]:
    """Standard errors of a result, SI, by path, and the correlation of some parameters."""
    if result is None:
        return {}, np.eye(len(paths))
    errors = {
        path: float(error)
        for path in paths
        if path in result.parameters
        and (error := result.parameters[path].standard_error) is not None
        and np.isfinite(error)
    }
    correlation = np.eye(len(paths))
    known = [path for path in result.correlation.parameters if path in errors]
    at = [list(result.correlation.parameters).index(path) for path in known]
    to = [list(paths).index(path) for path in known]
    matrix = np.asarray(result.correlation.matrix, dtype=float)
    if len(known) and np.all(np.isfinite(matrix)):
        correlation[np.ix_(to, to)] = matrix[np.ix_(at, at)]
    return errors, correlation


def uncertain(
    stated: float | Mapping[str, float] | None,
    errors: Mapping[str, float],
    result: FitResult | None,
    values: Mapping[str, float],
) -> dict[str, float]:
    """Standard deviations by path, SI: what the caller says, else a fit, else a fifth.

    What is stated is over the present value, of all that is free or by path.
    """
    if stated is None and result is not None:
        # What a fit did not find is not known for that.
        return {path: errors.get(path, _UNCERTAIN * abs(value)) for path, value in values.items()}
    if isinstance(stated, Mapping):
        for path in stated:
            if path not in values:
                raise InputError(
                    f"'{path}' is uncertain but not free: free it, or remove its uncertainty"
                )
        relative = dict(stated)
    else:
        relative = dict.fromkeys(values, _UNCERTAIN if stated is None else stated)
    for path, size in relative.items():
        if not 0 <= size < math.inf:
            raise InputError(
                f"the uncertainty of '{path}' is {size:g}: give 0 or a positive number"
            )
    return {path: size * abs(values[path]) for path, size in relative.items()}


# Of positions (m) and of angles (rad, rad/s), where nobody states it: as `giajax sensitivity`.
_NOISE = 0.01
_NOISE_PIXEL = 2.0
_NOISE_ANGLE = math.radians(0.5)

_TOLERANCE = 1e-6  # a tolerance at which derivatives are right to a percent, and quick


@dataclasses.dataclass(frozen=True)
class Question:
    """What a design is asked.

    Attributes:
        parameters: what is free in a fit, with the bounds that each declares.
        values, deviations: present ones, and what each is uncertain by, SI.
        wanted: the weight of each parameter of interest, by path, in 1 over its unit.
        weighted: whether the caller gave these weights.
        known: information that priors are, in scales, with what is free in the run alone.
        experiment: what is recorded of the arm, at the present values.
        bodies, noise: names of what may be recorded, and the noise of a cell, SI, by channel.
        before: standard errors of the fit that was given; may be empty.
        definition: what the sidecar of the experiment says.
    """

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
    before: dict[str, float]
    definition: dict[str, Any]

    def weights(self, criterion: str) -> tuple[float, ...]:
        """Weights of all that is free, as `Criterion` takes them."""
        if criterion == "c" and len(self.wanted) > 1 and not self.weighted:
            raise InputError(
                f"criterion c needs one parameter, but {len(self.wanted)} are given: give one "
                "parameter, give a weight for each, or use criterion A or D"
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
    """The arguments of `design_experiment`, checked and resolved; it raises what that raises."""
    result = source if isinstance(source, FitResult) else None
    model = _arm_of(source)
    if model.tolerance is None:
        model = model.with_integration(solver=None, tolerance=_TOLERANCE)
    weighted = isinstance(wanted, Mapping)
    weights = dict(wanted) if isinstance(wanted, Mapping) else dict.fromkeys(wanted, 1.0)
    if not weights:
        raise InputError("no parameter to estimate is given: give the path of at least one")
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
            raise InputError(
                f"'{path}' is tied to other parameters: give the parameters that determine it"
            )
        parts.pop(path, None)
    before = checked_priors(settings.get("priors", {}) if priors is None else priors)
    values = np.asarray([float(part.value(model)) for part in parts.values()])
    scales = np.where(values != 0, np.abs(values), 1.0)
    links = range(1, model.arm.count + 1)
    names = tuple(channels or [f"link{i:02d}_{axis}" for i in links for axis in "xyz"])
    stated = _definition(model, result, definition)
    run = _planned(limits, base_step(limits, 3).drive(), names, stated, "design", noise)
    for name in names:
        if name not in run.observations:
            raise InputError(
                f"'{name}' is a command and not a recorded channel: give another channel"
            )
    inputs = model.prepare(run)
    own = tuple((path, get(inputs, path).size) for path in model.free_inputs(run))
    beside = [
        (f"{path}[{at}]", value)
        for path, _ in own
        for at, value in enumerate(np.ravel(get(inputs, path)).tolist())
    ]
    if priors is not None:
        may_have = {*parts, *(path for path, _ in beside)}
        may_have |= {path.partition("[")[0] for path in may_have}
        odd = next((path for path in before if path not in may_have), None)
        if odd is not None:
            # Refused as no parameter, where it is none.
            elements(model, odd)
            raise InputError(f"'{odd}' has a prior but is not free: free it, or remove the prior")
    counted = [*zip(parts, values, scales, strict=True), *((*one, 1.0) for one in beside)]
    rows = [
        0.0 if (prior := prior_of(before, path)) is None else prior_row(prior, value)[1] * scale
        for path, value, scale in counted
    ]
    errors, correlation = known_before(result, list(parts))
    bodies = tuple(dict.fromkeys(body_of(name) for name in names))
    deviations = _noise(run, names, result)
    return Question(
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
        before=errors,
        definition=stated,
    )


def joint_count(source: AbstractModel | FitResult) -> int:
    """How many joints an arm has, or that of a fit."""
    return _arm_of(source).arm.count


def _arm_of(source: AbstractModel | FitResult) -> ArmModel:
    given = source.model if isinstance(source, FitResult) else source
    if given.kind != ARM.name:
        raise InputError(f"the model describes a {given.kind}: give the model of an arm")
    return cast("ArmModel", given)


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
