"""Problem statement of a design: the arm, free and wanted parameters, noise and priors."""

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

# Criteria by which experiments are compared: c-, A- and D-optimality.
#
# Each is the logarithm of an expected error, computed from the covariance C of all free
# parameters, nuisance parameters included (Pukelsheim, Optimal Design of Experiments, chapters 3
# and 6):
#
# - c: the standard error of one linear combination w^T p, the square root of w^T C w;
# - A: the root of the trace of C over the parameters of interest, not of the inverse of C;
# - D: the geometric mean of their standard errors as if uncorrelated, det(C)^(1 / 2n).
#
# C is the covariance of scaled parameters. The scale of each is its value by default. D does not
# depend on the scales.

_KINDS = ("c", "A", "D")

Matrix = Float[np.ndarray, "parameter parameter"]

# Each parameter has a weak prior whose standard deviation is this number of its scales. No matrix
# is then singular, and a parameter to which no channel responds does not affect the others.
_LOOSE = 100.0


@dataclasses.dataclass(frozen=True)
class Criterion:
    """The logarithm of an expected error.

    For "c" the weights are the coefficients of the parameters in the linear combination. For "A"
    and "D" the weights of the parameters of interest are nonzero.
    """

    kind: str
    weights: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise InputError(f"'{self.kind}' is not a criterion: use one of {', '.join(_KINDS)}")
        if not any(self.weights):
            raise InputError("no parameter to estimate is given: give the path of at least one")

    @property
    def rank(self) -> int:
        """Largest number of parameter directions in which information changes the criterion."""
        return 1 if self.kind == "c" else int(np.count_nonzero(self.weights))

    def of(self, covariance: Matrix) -> tuple[float, Matrix]:
        """Return the value of the criterion and its derivative with respect to the covariance."""
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
        """Return whether the data, and not only the weak prior, determine the criterion."""
        some, weights = np.flatnonzero(self.weights), np.asarray(self.weights)
        if self.kind == "c":
            # Replace the parameter with the largest weight by the combination.
            most = int(np.argmax(np.abs(weights)))
            turn = np.eye(len(weights))
            turn[most] = weights / weights[most]
            back = np.linalg.inv(turn)
            some, information = np.asarray([most]), back.T @ information @ back
        return bool(np.all(expected_errors(information)[some] < _LOOSE))

    def of_information(self, information: Matrix) -> tuple[float, Matrix]:
        """Return the value and its derivative with respect to the information matrix."""
        covariance = covariance_of(information)
        value, slope = self.of(covariance)
        return value, -covariance @ slope @ covariance


def covariance_of(information: Matrix) -> Matrix:
    """Return the covariance of the scaled parameters, with the weak prior included."""
    whole = information + np.eye(len(information)) / _LOOSE**2
    sizes = np.sqrt(np.diag(whole))
    return np.asarray(np.linalg.inv(whole / np.outer(sizes, sizes)) / np.outer(sizes, sizes))


# Relative standard deviation of a free parameter if neither a fit nor the caller gives one.
_UNCERTAIN = 0.2

# Normal deviates are clipped here: a design need not allow for very unlikely values.
_FURTHEST = 2.0

# Largest standard deviation of the logarithm: a factor of two up or down.
_MOST = math.log(2)


def draws(
    parameters: Sequence[Parameter],
    values: Float[np.ndarray, " parameter"],
    deviations: Mapping[str, float],
    correlation: Float[np.ndarray, "parameter parameter"],
    count: int,
) -> Float[np.ndarray, "draw parameter"]:
    """Return possible values of the parameters, SI; the first draw is the current values.

    A parameter that must be positive is log-normal and stays within a factor of four. The others
    are normal. All draws are points of a Sobol sequence. A parameter without a deviation is
    constant.
    """
    if count < 1:
        raise InputError(f"the number of draws is {count}: give at least 1")
    found = np.tile(values, (count, 1))
    sizes = np.asarray([deviations.get(one.path, 0.0) for one in parameters])
    if count == 1 or not np.any(sizes):
        return found[:1]
    # This import is slow and needed only here.
    from scipy.stats import norm, qmc

    # Skip the first two points of the sequence, a corner and the centre.
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
    """Return the standard errors of a result (SI, by path) and the parameter correlation."""
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
    """Return standard deviations by path, SI: as given, else from a fit, else a fifth of the value.

    `stated` is relative to the current value, either for all free parameters or by path.
    """
    if stated is None and result is not None:
        # A parameter without a standard error in the fit has the default uncertainty.
        return {path: errors.get(path, _UNCERTAIN * abs(value)) for path, value in values.items()}
    if isinstance(stated, Mapping):
        for path in stated:
            if path not in values:
                raise InputError(
                    f"'{path}' is uncertain but not free: free it, or remove the "
                    "uncertainty given for it"
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


# Defaults for positions (m), pixels and angles (rad, rad/s), the same as in `giajax sensitivity`.
_NOISE = 0.01
_NOISE_PIXEL = 2.0
_NOISE_ANGLE = math.radians(0.5)

_TOLERANCE = 1e-6  # At this tolerance derivatives are accurate to 1 % and still fast.


@dataclasses.dataclass(frozen=True)
class Question:
    """The problem that a design solves.

    Attributes:
        parameters: free parameters of the fit, with their declared bounds.
        values, deviations: current values and their standard deviations, SI.
        wanted: weight of each parameter of interest, by path, in the reciprocal of its unit.
        weighted: whether the caller gave these weights.
        known: information matrix of the priors, for the scaled parameters and the quantities that
            are free in this run only.
        experiment: the arm and its channels at the current values.
        bodies, noise: names of the bodies that may be recorded, and the standard deviation of one
            recorded value by channel, SI.
        before: standard errors of the given fit; may be empty.
        definition: contents of the sidecar of the experiment.
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
        """Return the weights of all free parameters in the form that `Criterion` takes."""
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
        """Return the experiment with a command, without recorded values."""
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
    """Check and resolve the arguments of `design_experiment`; its errors are raised here."""
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
            # If it is not a parameter at all, `elements` raises a more specific error.
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
    """Return the number of joints of an arm, or of the arm of a fit."""
    return _arm_of(source).arm.count


def _arm_of(source: AbstractModel | FitResult) -> ArmModel:
    given = source.model if isinstance(source, FitResult) else source
    if given.kind != ARM.name:
        raise InputError(f"the model describes a {given.kind}: give the model of an arm")
    return cast("ArmModel", given)


def _definition(
    model: ArmModel, result: FitResult | None, definition: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the sidecar: the arm, the interpolation of commands, and the caller's additions."""
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
    """Return the noise by channel, SI: as given, else as in the fit, else a default."""
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
