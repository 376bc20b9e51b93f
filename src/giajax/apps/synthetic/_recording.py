"""Synthetic recordings: the channels that a model predicts, with measurement errors."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...mechanics.arm import Arm
from ...models import (
    AbstractModel,
    ArmModel,
    capabilities,
    predicted_channels,
    preset_of,
)
from ...recordings import Definition, Run
from ...runtime.arrays import Float
from ...runtime.text import InputError
from ...schema import InitialSection
from ...schema.parameters import default_free, get
from ...simulation import RESULTS, SimulationError, Trajectory, logged


@dataclasses.dataclass(frozen=True)
class RecordingErrors:
    """Errors of a recording.

    Standard deviations and sizes are in SI units, by quantity (`position`, `angle`, `rate`) or by
    channel. A rotated, shifted or delayed camera is not an error of this kind: it is described by
    parameters of the model.

    Attributes:
        white: standard deviation of the white noise.
        correlated: standard deviation of the correlated noise (Ornstein-Uhlenbeck).
        correlation_time: time in which the correlation decreases to 1/e, s.
        missing: fraction of cells that are empty, at random places, in [0, 1).
        bursts: fraction of the samples of each link or joint that are lost in contiguous intervals.
        burst_duration: duration of each such interval, s.
        outliers: fraction of cells that are outliers, in [0, 1).
        outlier_size: magnitude of an outlier; its sign is random.
    """

    white: Mapping[str, float] = dataclasses.field(default_factory=dict)
    correlated: Mapping[str, float] = dataclasses.field(default_factory=dict)
    correlation_time: float = 0.5
    missing: float = 0.0
    bursts: float = 0.0
    burst_duration: float = 1.0
    outliers: float = 0.0
    outlier_size: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("missing", "bursts", "outliers"):
            if not 0 <= getattr(self, name) < 1:
                raise InputError(
                    f"the fraction {name} is {getattr(self, name):g}: give a number of at least 0 "
                    "and less than 1"
                )
        for name in ("correlation_time", "burst_duration"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} is {getattr(self, name):g} s: give a positive time")
        if (self.outliers > 0) != bool(self.outlier_size):
            raise InputError("outliers need both a fraction and a size: give both or neither")


def with_errors(run: Run, errors: RecordingErrors, *, seed: int = 0) -> Run:
    """Return a run with errors added to its recorded values, and with their noise in its sidecar.

    Raises:
        InputError: correlated noise or bursts in a run without times.
    """
    white, drift, size = (
        _by_channel(run, of) for of in (errors.white, errors.correlated, errors.outlier_size)
    )
    if run.times is None and (errors.correlated or errors.bursts):
        raise InputError(
            f"'{run.name}' has no times, so its errors cannot be correlated or occur in "
            "bursts: omit these options"
        )
    values: dict[str, Any] = dict(run.values)
    for name, exact in run.observations.items():
        recorded = exact + white[name] * _stream(seed, "white", name).standard_normal(len(exact))
        if drift[name]:
            assert run.times is not None
            random = _stream(seed, "correlated", name)
            recorded += drift[name] * drifting(run.times, errors.correlation_time, random)
        random = _stream(seed, "outliers", name)
        far = _some(len(exact), errors.outliers, random)
        recorded[far] += size[name] * random.choice([-1.0, 1.0], len(far))
        recorded[_some(len(exact), errors.missing, _stream(seed, "missing", name))] = np.nan
        if errors.bursts:
            assert run.times is not None
            channel = run.channels[name]
            random = _stream(seed, "bursts", f"{channel.kind}{channel.index}")
            recorded[_stretches(run.times, errors.bursts, errors.burst_duration, random)] = np.nan
        if np.all(np.isnan(recorded)):
            raise InputError(f"no value of {name} remains: reduce the fractions of lost values")
        values[name] = recorded
    kept = {key: value for key, value in run.definition.contents().items() if key != "noise"}
    total = {
        key: float(np.hypot(errors.white.get(key, 0.0), errors.correlated.get(key, 0.0)))
        for key in {**errors.white, **errors.correlated}
    }
    # A channel may have its own value for one kind of noise, and that of its quantity for the
    # other.
    for name in set(total) & set(run.observations):
        total[name] = float(np.hypot(white[name], drift[name]))
    return Run.from_arrays(
        run.times,
        values,
        name=run.name,
        noise={key: value for key, value in total.items() if value > 0},
        definition=Definition.parse(kept, run.name),
    )


def drifting(
    times: Float[np.ndarray, " sample"], correlation_time: float, random: np.random.Generator
) -> Float[np.ndarray, " sample"]:
    """Return stationary Ornstein-Uhlenbeck noise with <x(s) x(t)> = exp(-|s - t| / tau).

    Its variance is 1. It is exact for any spacing of the samples.
    """
    kept = np.exp(-np.diff(times) / correlation_time)
    kicks = random.standard_normal(len(times))
    values = np.empty(len(times))
    values[0] = kicks[0]
    for row, (keep, kick) in enumerate(zip(kept, kicks[1:], strict=True), start=1):
        values[row] = keep * values[row - 1] + np.sqrt(1 - keep**2) * kick
    return values


def _by_channel(run: Run, deviations: Mapping[str, float]) -> dict[str, float]:
    """Return the deviation of each measured channel, given by quantity or channel; 0 by default."""
    bare = {key: value for key, value in run.definition.contents().items() if key != "noise"}
    positive = {key: value for key, value in deviations.items() if value > 0}
    if any(not np.isfinite(value) or value < 0 for value in deviations.values()):
        raise InputError(
            "a standard deviation or an outlier size is negative or not finite: give finite "
            "numbers of at least 0"
        )
    plan = Run.from_arrays(run.times, run.values, noise=positive, definition=bare)
    return {name: plan.noise(name) or 0.0 for name in run.observations}


def _stream(seed: int, kind: str, name: str) -> np.random.Generator:
    return np.random.default_rng([seed, *kind.encode(), 0, *name.encode()])


def _some(count: int, fraction: float, random: np.random.Generator) -> npt.NDArray[Any]:
    """Return random rows, their exact number rounded down."""
    return random.permutation(count)[: int(fraction * count)]


def _stretches(
    times: Float[np.ndarray, " sample"],
    fraction: float,
    duration: float,
    random: np.random.Generator,
) -> npt.NDArray[np.bool_]:
    """Return rows in intervals of a duration; the last one is cut to reach the fraction."""
    lost = np.zeros(len(times), bool)
    count = int(fraction * len(times))
    while (left := count - int(lost.sum())) > 0:
        begin = random.uniform(times[0] - duration / 2, times[-1])
        rows = np.flatnonzero((times >= begin) & (times < begin + duration) & ~lost)
        lost[rows[:left]] = True
        # An interval shorter than the sample spacing may contain no row.
        if duration < np.min(np.diff(times)) and not len(rows):
            lost[random.integers(len(times))] = True
    return lost


def synthesise(
    model: AbstractModel,
    times: npt.ArrayLike | None,
    inputs: Mapping[str, npt.ArrayLike],
    channels: Sequence[str],
    *,
    noise: Mapping[str, float] | None = None,
    missing: float = 0.0,
    seed: int = 0,
    definition: Definition | Mapping[str, Any] | None = None,
    constants: AbstractModel | None = None,
    name: str = "synthetic",
) -> Run:
    """Return a run as an experiment would record it: the prediction of a model with noise and gaps.

    The model gets the inputs in the form in which the run contains them: between rows they are
    linear or held as `definition` specifies. A prediction of the returned run with the same model
    therefore gives the same channels without noise.

    The noise is white and normal. Empty cells are NaN. Each channel has its own random stream,
    derived from the seed and the name of the channel. Recording more channels therefore does not
    change the others.

    Arguments:
        model: the true model.
        times: increasing times, s, shape (sample,); None for a static run.
        inputs: inputs of the model by channel (`joint01_command`, `wind_x`), SI, each of shape
            (sample,). Without inputs the definition must allow a free motion.
        channels: names of the channels to record (`link06_z`, `tip_x`).
        noise: standard deviations, SI, by quantity (`position`, `angle`, `rate`) or channel, in
            addition to those in the definition.
        missing: fraction of the samples of each channel that are left empty, in [0, 1).
        seed: seed of the noise and the gaps.
        definition: contents of the sidecar of the run; the constants of the model are added.
        constants: model whose constants are added instead, such as one without a rotated camera.

    Raises:
        InputError: a channel that the model cannot predict, or `missing` outside [0, 1).
        SimulationError: the model cannot be evaluated.

    Example:
        >>> import giajax, numpy as np
        >>> from giajax.apps.synthetic import synthesise
        >>> times = np.linspace(0.0, 10.0, 101)
        >>> command = np.interp(times, [0.5, 1.5], [0.0, 0.5])
        >>> model = giajax.ArmModel(giajax.takeichi_20m())
        >>> run = synthesise(
        ...     model, times, {"joint01_command": command}, ["link20_z"], noise={"position": 0.02}
        ... )
        >>> sorted(run.observations)
        ['link20_z']
    """
    if not 0 <= missing < 1:
        raise InputError(
            f"the missing fraction is {missing:g}: give a number of at least 0 and less than 1"
        )
    times = None if times is None else np.asarray(times, dtype=float)
    if not isinstance(definition, Definition):
        definition = Definition.parse(definition or {}, f"{name}: definition")
    # The model is prepared from a run that has the channels, but no values yet.
    samples = len(np.asarray(next(iter(inputs.values()))) if times is None else times)
    blank = {channel: np.zeros(samples) for channel in channels}
    plan = Run.from_arrays(
        times,
        {**inputs, **blank},
        name=name,
        noise=noise,
        definition=definition.merged_with(
            Definition.parse(_constants(constants or model), "model")
        ),
    )
    plan = known_exactly(model, plan)
    unknown = [channel for channel in channels if channel not in plan.observations]
    if unknown:
        raise InputError(
            f"'{unknown[0]}' is an input of the model and is not predicted: record another channel"
        )
    predicted, _ = _predicted(model, plan, tuple(channels))
    recorded: dict[str, Any] = {}
    for channel in channels:
        random, exact = np.random.default_rng([seed, *channel.encode()]), predicted[channel]
        deviation = plan.noise(channel) or 0.0
        recorded[channel] = exact + deviation * random.standard_normal(len(exact))
        # The number of gaps is exact and rounded down: a channel always keeps at least one value.
        recorded[channel][_some(len(exact), missing, random)] = np.nan
    return Run.from_arrays(times, {**inputs, **recorded}, name=name, definition=plan.definition)


def known_exactly(model: AbstractModel, run: Run) -> Run:
    """Return a run without uncertain quantities, unless its definition specifies some."""
    if not capabilities.uncertain(model, [run]):
        return run
    exact = Definition.parse({"uncertainty": {"defaults": False}}, run.name)
    return dataclasses.replace(run, definition=exact.merged_with(run.definition))


def _predicted(
    model: AbstractModel, run: Run, channels: tuple[str, ...]
) -> tuple[dict[str, npt.NDArray[np.float64]], Any]:
    """Return the channels of a run, NaN where they cannot be observed, and the prepared run."""
    prepared = model.prepare(run)
    predicted, successful = predicted_channels(model, prepared, channels, run)
    if not successful:
        raise SimulationError(capabilities.failure(model, prepared))
    shown = {channel: predicted[channel].astype(float) for channel in channels}
    for channel, hidden in capabilities.unseen(model, prepared, channels).items():
        if channel in shown:
            shown[channel][hidden] = np.nan
    return shown, prepared


def _constants(model: AbstractModel) -> dict[str, Any]:
    """Return the properties of the model that a sidecar can contain."""
    known = {key: one for key, one in model.definition().items() if key in Definition.model_fields}
    return {**known, "model": model.kind}


# Keys of the sidecar that describe one recording, not the recorded system.
_OF_THE_FILE = ("noise", "truth", "sha256", "fit", "figures", "origin", "licence")


def recorded_again(
    model: AbstractModel,
    run: Run,
    errors: RecordingErrors | None = None,
    *,
    channels: Sequence[str] | None = None,
    seed: int = 0,
    truth: Sequence[str] = (),
    name: str = "synthetic",
) -> Run:
    """Return the run that an experiment with the inputs of `run` would record of the given model.

    The sidecar of `run` is kept, apart from its noise. Parameters that only the model has, such as
    a rotated camera, are listed in `[truth]` only, so that a fit can estimate them. The noise in
    the sidecar is the sum of white and correlated noise.

    Arguments:
        model: the true model.
        run: run that supplies inputs, times and sidecar. Of its recorded values only the first row
            is used.
        errors: errors of the recording; none by default.
        channels: channels to record, without unit; those of `run` by default.
        seed: seed of all errors. Each kind of error and each channel has its own random stream.
        truth: paths of parameters to list in `[truth]`, in addition to those that a fit frees.

    Raises:
        InputError: no channel to record, a channel that the model cannot predict, or errors
            that need times although the run has none.
        SimulationError: the model cannot be evaluated.
    """
    errors = RecordingErrors() if errors is None else errors
    names = tuple(run.observations if channels is None else channels)
    if not names:
        raise InputError(f"'{run.name}' has no measured channel: give the channels to record")
    predicted, prepared = _predicted(model, run, names)
    known = [path for path in default_free(model) if path not in truth]
    sidecar = run.definition.contents()
    sections = {key: sidecar[key] for key in sidecar if key not in _OF_THE_FILE}
    facts = {path: np.asarray(get(model, path), dtype=float).tolist() for path in (*known, *truth)}
    made = dataclasses.asdict(errors)
    facts["recording"] = {key: value for key, value in made.items() if value not in ({}, 0.0)}
    if run.definition.section(InitialSection).first_row:
        # The first row of the new run is noisy or not recorded.
        kept = {key: value for key, value in sections["initial"].items() if key != "first_row"}
        sections["initial"] = {**kept, **capabilities.initial_section(model, prepared)}
    exact = Run.from_arrays(
        run.times,
        {**run.commands, **run.winds, **predicted},
        name=name,
        definition=Definition.parse({"model": model.kind, **sections, "truth": facts}, name),
    )
    return with_errors(exact, errors, seed=seed)


def logged_motion(
    arm: Arm,
    times: Float[np.ndarray, " row"],
    angles: Float[np.ndarray, "row joint"],
    rates: Float[np.ndarray, "row joint"],
    commands: Float[np.ndarray, "row joint"],
    wind: Float[np.ndarray, "row width"],
) -> Trajectory:
    """Return a motion made of rows, SI, without the quantities that only the integrator knows."""
    return Trajectory(
        times=jnp.asarray(times),
        angles=jnp.asarray(angles),
        rates=jnp.asarray(rates),
        memory=None,
        pressures=None,
        skin=None,
        arm=arm,
        command=logged(times, commands),
        wind=logged(times, wind),
        result=RESULTS.successful,  # type: ignore[arg-type]
        steps=jnp.zeros(2, dtype=int),
    )


def command_columns(commands: Float[np.ndarray, "row joint"]) -> dict[str, np.ndarray]:
    """Return the commanded angles by channel, for the joints that move."""
    named = {f"joint{joint:02d}_command": row for joint, row in enumerate(commands.T, start=1)}
    return {name: row for name, row in named.items() if np.any(row)}


def driven_run(
    model: ArmModel,
    times: Float[np.ndarray, " row"],
    values: Mapping[str, npt.ArrayLike],
    *,
    name: str,
    noise: Mapping[str, float] | None = None,
    origin: str = "",
) -> Run:
    """Return a run of channels (SI); its commands, and its wind if any, are linear between rows."""
    facts: dict[str, Any] = {"arm": preset_of(model.arm), "command": {"interpolation": "linear"}}
    if any("wind" in channel for channel in values):
        facts["wind"] = {"interpolation": "linear"}
    facts |= {"noise": dict(noise)} if noise else {}
    facts |= {"origin": origin} if origin else {}
    definition = Definition.parse(facts, name)
    definition = definition.merged_with(Definition.parse(_constants(model), "model"))
    return known_exactly(model, Run.from_arrays(times, values, name=name, definition=definition))
