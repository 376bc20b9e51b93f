"""Hysteresis as a model: from the history of an input to that of an output."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..hysteresis import MOST_STEPS, AbstractOperator, BoucWen, BoucWenOscillator
from ..parameters import inline, parameter
from ..runs import Channel, Definition, Hysteresis, Run, parse_column
from ._hysteresis_definition import (
    HysteresisSettings,
    Scale,
    hysteresis_keys,
    operator_from_settings,
    settings_for,
)
from ._protocol import AbstractModel, Channels, Derived

INPUTS = ("input", "command")
OUTPUTS = ("output", "angle")

# Where turning points before the run are looked for first, as a part of the reach of the input.
_FIRST_EXTREME = 0.75


class HysteresisInputs(eqx.Module):
    """What the model needs of a run: the input at the samples, and before each of them.

    Attributes:
        values: SI; for an oscillator the forces since the sample before, see
            `BoucWenOscillator.motion`; else one column.
        intervals: s, since the sample before; 0 where the run has no times.
    """

    values: Float[Array, "sample part"]
    intervals: Float[Array, " sample"]


class HysteresisModel(AbstractModel):
    """Predicts `output` from `input`, or the `angle` of a joint from its `command`.

    Units of parameters in terms of "input" and "output" are the SI units of those channels.

    Arguments:
        settings: what of the `[hysteresis]` section is no parameter.
        operator: the operator, or an oscillator with one; its parameters keep their own paths.
        offset: added to the output, such as the inclination of a camera.
        previous_extremes: turning points of the input before the run, the latest last. What a
            rate-independent operator remembers of its past is a list of such extremes.
        input_column: the column that drove the runs, such as "command_deg"; empty if not known.
        output_column: the column that they measured, such as "angle_deg"; empty if not known.
    """

    kind: ClassVar[str] = "hysteresis"

    settings: HysteresisSettings = eqx.field(static=True)
    operator: AbstractOperator | BoucWenOscillator = inline()
    offset: Scalar = parameter(0.0, unit="output", frozen=False, doc="added to the output")
    previous_extremes: Float[Array, " extreme"] = parameter(
        0.0, unit="input", doc="turning points of the input before the run, the latest last"
    )
    input_column: str = eqx.field(default="", static=True)
    output_column: str = eqx.field(default="", static=True)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """The operator that the sidecars state, with start values of the size of the data.

        Raises:
            InputError: the sidecars disagree in [hysteresis], or no input ever turns.
        """
        inputs = [_input_of(run) for run in runs]
        outputs = [values for run in runs for values in run.observations.values()]
        first, *others = runs
        stated = first.definition.hysteresis
        for other in others:
            if other.definition.hysteresis != stated:
                raise InputError(
                    f"the sidecars of '{first.name}' and '{other.name}' disagree in [hysteresis]; "
                    "correct one, or fit the runs separately"
                )
        _check_keys(first.name, stated)
        settings = settings_for(stated, inputs)
        if not any(_turns(values) for values in inputs):
            raise InputError(
                f"the input of '{first.name}' never turns back, and hysteresis shows only where it "
                "does; give a run that goes up and down"
            )
        measured = output_channel(first)
        columns = input_channel(first).column, "" if measured is None else measured.column
        return cls._made(settings, Scale.of(inputs, outputs), columns)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """The operator that `definition()` described."""
        stated = Definition.parse({"hysteresis": definition["hysteresis"]}, "stored result")
        columns = definition.get("input_column", ""), definition.get("output_column", "")
        return cls._made(settings_for(stated.hysteresis, []), Scale(), columns)

    @classmethod
    def _made(cls, settings: HysteresisSettings, scale: Scale, columns: tuple[str, str]) -> Self:
        extremes = settings.previous_extremes
        values = np.zeros(extremes) if isinstance(extremes, int) else np.asarray(extremes)
        operator = operator_from_settings(settings, scale)
        return cls(
            settings,
            operator,
            previous_extremes=jnp.asarray(values),
            input_column=columns[0],
            output_column=columns[1],
        )

    def drawn_over(self, run: Run) -> str | None:
        """The input, which makes loops; the motion of an oscillator is drawn over time."""
        return None if isinstance(self.operator, BoucWenOscillator) else input_channel(run).name

    def at_start(self, runs: Sequence[Run], free: Sequence[str]) -> Self:
        """With turning points before the run, where they are free: at 0 they leave no trace.

        Those of the two directions from which the latest one may have come are tried, and that
        is taken whose prediction, scaled and shifted, is the closer one.
        """
        told = isinstance(self.settings.previous_extremes, tuple)
        if told or isinstance(self.operator, BoucWenOscillator):
            return self
        now = np.asarray(self.previous_extremes)
        count = len(now)
        paths = [f"previous_extremes[{index}]" for index in range(count)]
        moved = np.asarray([path in free for path in paths]) & (now == 0)
        if not np.any(moved):
            return self
        low, high = self.settings.input_range
        # Within each other, so that a later one does not wipe out an earlier one.
        sizes = _FIRST_EXTREME * self.settings.reach * np.arange(count, 0, -1) / count
        signs = (-1.0) ** np.arange(count)
        tried = []
        for sign in (1.0, -1.0):
            extremes = np.where(moved, (low + high) / 2 + sign * signs * sizes, now)
            tried.append(dataclasses.replace(self, previous_extremes=jnp.asarray(extremes)))
        return min(tried, key=lambda model: model._distance(runs))

    def _distance(self, runs: Sequence[Run]) -> float:
        """Sum of the squares that the best scale and offset of the response leave, SI."""
        total = 0.0
        for run in runs:
            response = np.asarray(self._response(self.prepare(run)))
            if not np.all(np.isfinite(response)):
                return np.inf
            for values in run.observations.values():
                there = ~np.isnan(values)
                columns = np.stack([response[there], np.ones(there.sum())], axis=-1)
                scale = np.linalg.lstsq(columns, values[there])[0]
                total += float(np.sum((values[there] - columns @ scale) ** 2))
        return total

    def definition(self) -> dict[str, Any]:
        """The `[hysteresis]` section, and the columns of input and output where known."""
        columns = {"input_column": self.input_column, "output_column": self.output_column}
        known = {name: column for name, column in columns.items() if column}
        return {"hysteresis": self.settings.to_dict(), **known}

    def input_channel(self) -> Channel:
        """The channel that drove the runs; the command of a joint where that is not known."""
        return parse_column(self.input_column or "command_rad")

    def output_channel(self) -> Channel | None:
        """The channel that the runs measured; None where that is not known."""
        return parse_column(self.output_column) if self.output_column else None

    def reachable(self) -> tuple[float, float]:
        """Least and largest output, SI, at the ends of the range of the input.

        Each end is come to from the other one.
        """
        if isinstance(self.operator, BoucWenOscillator):
            raise InputError("an oscillator at rest has no range of outputs")
        low, high = (jnp.asarray(end) for end in self.settings.input_range)
        operator = self.operator
        state = operator.travelled(operator.travelled(operator.reset(), low), high)
        state = operator.travelled(state, low)
        _, lowest = operator.step(state, low)
        state = operator.travelled(state, high)
        _, highest = operator.step(state, high)
        return float(self.offset + lowest), float(self.offset + highest)

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """None: offset and memory are parameters of the model."""
        return ()

    def prepare(self, run: Run) -> HysteresisInputs:
        """The input of a hysteresis run."""
        values = _input_of(run)
        self._check_quantities(run)
        if isinstance(self.operator, BoucWenOscillator):
            if run.times is None:
                raise InputError(
                    f"'{run.name}' has no times, which an oscillator needs; add the column time_s"
                )
            parts = _forces(run.name, run.times, values, self.settings.interpolation)
            intervals = np.diff(run.times, prepend=run.times[0])
        else:
            parts, intervals = values[:, None], np.zeros(len(values))
        dtype = jnp.result_type(float)
        return HysteresisInputs(jnp.asarray(parts, dtype), jnp.asarray(intervals, dtype))

    def _check_quantities(self, run: Run) -> None:
        own = [self.input_channel() if self.input_column else None, self.output_channel()]
        for mine, given in zip(own, (input_channel(run), output_channel(run)), strict=True):
            if mine is not None and given is not None and not comparable(mine, given):
                raise InputError(
                    f"'{run.name}' has the column {given.column} where the model has "
                    f"{mine.column}; give a run of the same quantity"
                )

    def predict(
        self, inputs: HysteresisInputs, channels: tuple[str, ...]
    ) -> tuple[Channels, Bool[Array, ""]]:
        """The output, SI, under the name of each channel, of shape (sample,)."""
        for name in channels:
            if Channel.named(name).kind not in OUTPUTS:
                raise InputError(
                    f"'{name}' is not predicted by the hysteresis model; use one of: "
                    f"{', '.join(OUTPUTS)}"
                )
        response = self._response(inputs)
        output = self.offset + response
        fine = jnp.all(jnp.isfinite(output))
        if isinstance(self.operator, BoucWen):
            fine &= ~self.operator.too_coarse(inputs.values[:, 0], response)
            # No number is better than a wrong one.
            output = jnp.where(fine, output, jnp.inf)
        return dict.fromkeys(channels, output), fine

    def _response(self, inputs: HysteresisInputs) -> Float[Array, " sample"]:
        if isinstance(self.operator, BoucWenOscillator):
            return self.operator.motion(inputs.values, inputs.intervals)[:, 0]
        values = inputs.values[:, 0]
        # The move to the first sample may be a long one.
        return self.operator.history(values, self.operator.travelled(self.memory(), values[0]))[0]

    def memory(self) -> Any:
        """Memory of the operator before the run: virgin, then through the previous extremes."""
        if isinstance(self.operator, BoucWenOscillator):
            raise InputError("an oscillator starts at rest; it has no memory of an input")
        state = self.operator.reset()
        for extreme in self.previous_extremes:
            state = self.operator.travelled(state, extreme)
        return state

    def failure(self, inputs: HysteresisInputs) -> str:
        """The response is not finite, or the input moves too far between two samples."""
        if isinstance(self.operator, BoucWen):
            values = inputs.values[:, 0]
            if bool(self.operator.too_coarse(values, self._response(inputs))):
                return (
                    "the input moves too far between two samples for the narrow knee of the "
                    "Bouc-Wen operator; record more samples, or start with a smaller beta, gamma "
                    "or nu"
                )
        return (
            "the response of the hysteresis model is not finite; choose start values with a "
            "smaller beta, gamma or delta, or a larger mass and damping"
        )

    def refined(self, factor: float) -> Self:
        """The same model with a finer integration, where it has one."""
        return eqx.tree_at(lambda model: model.operator, self, self.operator.refined(factor))

    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """The same: its steps are those of the samples."""
        return self

    def conditions(self, free: Sequence[str], runs: Sequence[Run] = ()) -> list[str]:
        """That beta, gamma and delta count only as products."""
        names = [path for path in free if path in ("beta", "gamma", "delta")]
        held = [path for path in ("beta", "gamma", "delta") if path not in free]
        if not names or isinstance(self.operator, BoucWen | BoucWenOscillator) is False:
            return []
        how = f"; held: {', '.join(held)}" if held else ""
        return [
            f"{', '.join(names)}: only the products beta gamma and beta delta are determined{how}"
        ]

    def derived(self) -> dict[str, Derived]:
        """The products of the Bouc-Wen parameters that a history determines."""
        operator = self.operator
        if not isinstance(operator, BoucWen | BoucWenOscillator):
            return {}
        unit = "1/m" if isinstance(operator, BoucWenOscillator) else "1/input"
        return {
            "beta*gamma": Derived(operator.beta * operator.gamma, unit),
            "beta*delta": Derived(operator.beta * operator.delta, unit),
        }


def _check_keys(name: str, stated: Hysteresis) -> None:
    operator = stated.operator or "prandtl_ishlinskii"
    known = hysteresis_keys(operator)
    ignored = [key for key in stated.model_dump(exclude_none=True) if key not in known]
    if ignored:
        raise InputError(
            f"[hysteresis] of '{name}' states {', '.join(ignored)}, which {operator} does not "
            "have; remove it, or state the operator that it belongs to"
        )


def input_channel(run: Run) -> Channel:
    """The channel that drives a hysteresis run.

    Raises:
        InputError: a run of another model, or with none or several.
    """
    if run.model != HysteresisModel.kind:
        raise InputError(f"'{run.name}' is a run of the {run.model} model, not of hysteresis")
    names = [name for name, channel in run.channels.items() if channel.kind in INPUTS]
    if len(names) != 1:
        found = " and ".join(names) or "none"
        raise InputError(
            f"'{run.name}' must have one column of input or command, and has {found}; "
            "rename or remove columns"
        )
    outputs = [name for name, channel in run.channels.items() if channel.kind in OUTPUTS]
    if len(outputs) > 1:
        raise InputError(f"'{run.name}' has both output and angle; remove one of the columns")
    return run.channels[names[0]]


def output_channel(run: Run) -> Channel | None:
    """The channel that a hysteresis run measures; None where it measures none."""
    found = [channel for channel in run.channels.values() if channel.kind in OUTPUTS]
    return found[0] if found else None


def comparable(one: Channel, other: Channel) -> bool:
    """Whether two channels may be of one quantity; a bare `input` or `output` says none."""
    return "ratio" in (one.quantity, other.quantity) or one.quantity == other.quantity


def _input_of(run: Run) -> np.ndarray:
    return np.asarray(run.values[input_channel(run).name], dtype=float)


def _turns(values: np.ndarray) -> bool:
    steps = np.diff(values)
    steps = steps[steps != 0]
    return bool(np.any(steps[1:] * steps[:-1] < 0))


# Neighbouring intervals that differ by more than this part are not rounding of a file.
_UNEVEN = 1e-5


def _forces(name: str, times: np.ndarray, values: np.ndarray, interpolation: str) -> np.ndarray:
    """Forces at equal distances after the sample before, shape (sample, 2 MOST_STEPS)."""
    count = 2 * MOST_STEPS
    if interpolation == "linear":
        fractions = np.arange(1, count + 1) / count
        steps = np.diff(values)[:, None] * fractions[None]
        rows = values[:-1, None] + steps
    else:
        intervals = np.diff(times)
        if np.ptp(intervals) > _UNEVEN * np.mean(intervals):
            raise InputError(
                f"'{name}' is not sampled evenly, which interpolation = \"band_limited\" needs; "
                'state "linear" in [hysteresis]'
            )
        rows = _band_limited(values, count)[1 : count * (len(values) - 1) + 1].reshape(-1, count)
    return np.concatenate([np.full((1, count), values[0]), rows])


def _band_limited(values: np.ndarray, factor: int) -> np.ndarray:
    """One period of a band-limited signal, sampled more often: zeros beyond its spectrum."""
    spectrum = np.fft.rfft(values)
    if len(values) % 2 == 0:
        spectrum[-1] /= 2  # the highest frequency is shared by the two sides of the spectrum
    return factor * np.fft.irfft(spectrum, factor * len(values))
