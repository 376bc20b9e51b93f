"""Hysteresis model: from the history of an input to that of an output."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..mechanics.hysteresis import (
    AbstractOperator,
    BoucWen,
    BoucWenOscillator,
    DeadZones,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    Preisach,
)
from ..recordings import Channel, Definition, Run, parse_column
from ..runtime.arrays import Array, Float, Scalar
from ..runtime.text import InputError, shown
from ..schema import KINDS, LOOP, HysteresisSection
from ..schema.parameters import inline, parameter
from ._arm_definition import agreed_section
from ._protocol import AbstractModel, Prediction
from .capabilities import Derived


@dataclasses.dataclass(frozen=True)
class Columns:
    """Names of input and output columns in the runs of a model, such as "command_deg".

    A name is empty if it is not known.
    """

    input: str = ""
    output: str = ""

    @classmethod
    def of(cls, run: Run) -> Self:
        """Return the columns of a run."""
        driven, measured = input_channel(run, run.model), output_channel(run)
        return cls(driven.column, "" if measured is None else measured.column)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """Return the columns that `to_dict` stored."""
        columns = [definition.get(key, "") for key in ("input_column", "output_column")]
        if not all(isinstance(column, str) for column in columns):
            raise InputError(
                f"the columns {shown(columns)} are not strings: give the names as strings"
            )
        return cls(*columns)

    def to_dict(self) -> dict[str, str]:
        """Return the known columns as plain data."""
        both = {"input_column": self.input, "output_column": self.output}
        return {name: column for name, column in both.items() if column}

    @property
    def input_channel(self) -> Channel:
        """Return the input channel of the runs; if it is not known, the command of a joint."""
        return parse_column(self.input or "command_rad")

    @property
    def output_channel(self) -> Channel | None:
        """Return the measured channel of the runs; None if it is not known."""
        return parse_column(self.output) if self.output else None

    def check(self, run: Run) -> None:
        """Raise `InputError` for a run whose quantities differ from those of the model."""
        own = [self.input_channel if self.input else None, self.output_channel]
        theirs = [input_channel(run, run.model), output_channel(run)]
        for mine, other in zip(own, theirs, strict=True):
            if mine is not None and other is not None and not comparable(mine, other):
                raise InputError(
                    f"'{run.name}' has the column {other.column}, but the model uses "
                    f"{mine.column}: give a run with the same quantity"
                )


def input_channel(run: Run, kind: str) -> Channel:
    """Return the input channel of a run of a kind of model with one input.

    Raises:
        InputError: the run is of another kind, or has no input or several.
    """
    if run.model != kind:
        raise InputError(
            f"'{run.name}' is a run of the {run.model} model: give a run of the {kind} model"
        )
    names = list(run.commands)
    if len(names) != 1:
        raise InputError(
            f"'{run.name}' must have exactly one input or command column, but has "
            f"{' and '.join(names) or 'none'}: rename or remove columns"
        )
    if len(_outputs(run)) > 1:
        raise InputError(f"'{run.name}' has both an output and an angle column: remove one of them")
    return run.channels[names[0]]


def input_values(run: Run, kind: str) -> np.ndarray:
    """Return the input of a run of a kind of model with one input, SI, shape (sample,).

    Raises:
        InputError: as in `input_channel`.
    """
    return np.asarray(run.values[input_channel(run, kind).name], dtype=float)


def output_channel(run: Run) -> Channel | None:
    """Return the measured channel of a run; None if there is none."""
    return next(iter(_outputs(run)), None)


def _outputs(run: Run) -> list[Channel]:
    return [channel for channel in run.channels.values() if channel.kind in run.kind.outputs]


def comparable(one: Channel, other: Channel) -> bool:
    """Return whether two channels may have one quantity; `input` and `output` have any."""
    return "ratio" in (one.quantity, other.quantity) or one.quantity == other.quantity


def check_outputs(kind: str, channels: Sequence[str]) -> None:
    """Raise `InputError` for a channel that this kind of model does not predict."""
    outputs = KINDS[kind].outputs
    for name in channels:
        if Channel.named(name).kind not in outputs:
            raise InputError(
                f"'{name}' is not predicted by the {kind} model: use one of {', '.join(outputs)}"
            )


def products(element: BoucWen | BoucWenOscillator, unit: str) -> dict[str, Derived]:
    """Return the products of Bouc-Wen parameters that a history determines."""
    return {
        "beta*gamma": Derived(element.beta * element.gamma, unit),
        "beta*delta": Derived(element.beta * element.delta, unit),
    }


def products_condition(free: Sequence[str]) -> list[str]:
    """Return a sentence that only products of beta, gamma and delta are determined."""
    names = [path for path in free if path in ("beta", "gamma", "delta")]
    held = [path for path in ("beta", "gamma", "delta") if path not in free]
    if not names:
        return []
    how = f"; held parameters: {', '.join(held)}" if held else ""
    return [f"{', '.join(names)}: only the products beta gamma and beta delta are determined{how}"]


Numbers = int | tuple[float, ...]

# Initial guesses: fraction of the stiffness that is elastic, and relative sharpness of the knee.
_ELASTIC = 0.7
_KNEE = 4.0

_ROOM = 1.05  # the mesh exceeds the input, because a relay at the edge of the input never switches


def hysteresis_keys(operator: str) -> list[str]:
    """Return the keys of the `[hysteresis]` section that an operator uses."""
    used = {
        "prandtl_ishlinskii": ("elements", "thresholds"),
        "modified_prandtl_ishlinskii": ("thresholds", "upper_dead_zones", "lower_dead_zones"),
        "preisach": ("rows",),
        "bouc_wen": (),
    }[operator]
    return ["operator", *used, "input_range", "previous_extremes"]


@dataclasses.dataclass(frozen=True)
class HysteresisSettings:
    """Complete `[hysteresis]` section without None; see `giajax.schema.HysteresisSection`."""

    operator: str
    elements: Literal["play", "stop"]
    thresholds: Numbers
    upper_dead_zones: Numbers
    lower_dead_zones: Numbers
    rows: int
    input_range: tuple[float, float]
    previous_extremes: Numbers

    def to_dict(self) -> dict[str, Any]:
        """Return the section as plain data, with the keys that this operator uses."""
        plain = {name: getattr(self, name) for name in hysteresis_keys(self.operator)}
        return {name: list(of) if isinstance(of, tuple) else of for name, of in plain.items()}

    @property
    def reach(self) -> float:
        """Half of the input range."""
        return (self.input_range[1] - self.input_range[0]) / 2


def settings_for(section: HysteresisSection, inputs: Sequence[np.ndarray]) -> HysteresisSettings:
    """Complete a section with defaults; the default input range is that of the given inputs.

    Raises:
        InputError: an input is constant.
    """
    ends = section.input_range
    if ends is None:
        together = np.concatenate([*inputs]) if inputs else np.zeros(1)
        ends = [float(np.min(together)), float(np.max(together))]
    if not ends[0] < ends[1]:
        raise InputError(
            "the input never changes, so the output is constant: give a run in which the input "
            "changes"
        )

    def chosen(name: str) -> Any:
        value = getattr(section, name)
        if value is None:
            extra = HysteresisSection.model_fields[name].json_schema_extra
            value = extra["preset"] if isinstance(extra, dict) else None
        return tuple(float(v) for v in value) if isinstance(value, list) else value

    names = [field.name for field in dataclasses.fields(HysteresisSettings)]
    values = {name: chosen(name) for name in names if name != "input_range"}
    return HysteresisSettings(**values, input_range=(ends[0], ends[1]))


@dataclasses.dataclass(frozen=True)
class Scale:
    """Scale of the data for initial guesses: slope, and half of the output range."""

    slope: float = 1.0
    height: float = 1.0

    @classmethod
    def of(cls, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> Self:
        """Return the scale of recorded histories; 1 if nothing was measured."""
        measured = [values[~np.isnan(values)] for values in outputs]
        if not measured:
            return cls()
        height = float(np.ptp(np.concatenate(measured))) / 2
        width = float(np.ptp(np.concatenate(list(inputs)))) / 2
        return cls(height / width, height) if height > 0 and width > 0 else cls()


def operator_from_settings(settings: HysteresisSettings, scale: Scale) -> AbstractOperator:
    """Return the operator with initial guesses from the scale of the data."""
    slope, reach = scale.slope, settings.reach
    if settings.operator == "prandtl_ishlinskii":
        thresholds = _even(settings.thresholds, reach)
        return PrandtlIshlinskii(
            _array(slope * _ELASTIC),
            jnp.full_like(thresholds, slope * (1 - _ELASTIC) / len(thresholds)),
            thresholds,
            elements=settings.elements,
        )
    if settings.operator == "modified_prandtl_ishlinskii":
        thresholds = _even(settings.thresholds, reach)
        upper = _dense(settings.upper_dead_zones, abs(settings.input_range[1]) or reach)
        lower = _dense(settings.lower_dead_zones, abs(settings.input_range[0]) or reach)
        curve = DeadZones(
            _array(slope), upper, jnp.full_like(upper, slope), lower, jnp.full_like(lower, slope)
        )
        weights = jnp.full_like(thresholds, (1 / _ELASTIC - 1) / len(thresholds))
        return ModifiedPrandtlIshlinskii(curve, weights, thresholds)
    if settings.operator == "preisach":
        return Preisach(
            slope=_array(slope / 2),
            saturation=_array(scale.height / 2),
            coercivity=_array(0.2 * reach),
            coercivity_spread=_array(0.7),
            bias=_array(0.0),
            interaction=_array(0.3 * reach),
            extent=_ROOM * max(abs(end) for end in settings.input_range),
            rows=settings.rows,
        )
    return BoucWen(
        elastic=_array(slope * _ELASTIC),
        alpha=_array(slope * (1 - _ELASTIC)),
        beta=_array(_KNEE / reach),
        gamma=_array(0.5),
        delta=_array(0.1),
        nu=_array(1.0),
    )


def _array(value: float | np.ndarray) -> Array:
    return jnp.asarray(value, dtype=jnp.result_type(float))


def _even(numbers: Numbers, reach: float) -> Array:
    if not isinstance(numbers, int):
        return _array(np.asarray(numbers))
    return _array(reach * np.arange(1, numbers + 1) / (numbers + 1))


def _dense(numbers: Numbers, reach: float) -> Array:
    """Return points that are densest near 0, where a joint is soft."""
    if not isinstance(numbers, int):
        return _array(np.asarray(numbers))
    return _array(reach * (np.arange(1, numbers + 1) / (numbers + 1)) ** 2)


# Largest initial guess of a turning point before the run, as a fraction of half the input range.
_FIRST_EXTREME = 0.75


def turns(values: np.ndarray) -> bool:
    """Return whether an input, shape (sample,), reverses its direction."""
    steps = np.diff(values)
    steps = steps[steps != 0]
    return bool(np.any(steps[1:] * steps[:-1] < 0))


def first_extremes(
    settings: HysteresisSettings, now: np.ndarray, free: Sequence[str]
) -> list[np.ndarray]:
    """Return initial guesses of turning points, one list for each sign of the first one.

    `now` contains the turning points of the model before the run, input, SI. Only elements that are
    zero and whose paths are in `free` (elements to fit without a start value) are changed. The
    result is empty if there are none.
    """
    count = len(now)
    paths = [f"previous_extremes[{index}]" for index in range(count)]
    moved = np.asarray([path in free for path in paths], dtype=bool) & (now == 0)
    if isinstance(settings.previous_extremes, tuple) or not np.any(moved):
        return []
    low, high = settings.input_range
    # Nested, because a later extreme would erase the memory of a smaller earlier one.
    sizes = _FIRST_EXTREME * settings.reach * np.arange(count, 0, -1) / count
    signs = (-1.0) ** np.arange(count)
    return [np.where(moved, (low + high) / 2 + sign * signs * sizes, now) for sign in (1.0, -1.0)]


def unexplained(response: np.ndarray, run: Run) -> float:
    """Return the residual sum of squares of a response with the best scale and offset, SI.

    It is infinite if the response is not finite.
    """
    if not np.all(np.isfinite(response)):
        return np.inf
    total = 0.0
    for values in run.observations.values():
        there = ~np.isnan(values)
        columns = np.stack([response[there], np.ones(there.sum())], axis=-1)
        scale = np.linalg.lstsq(columns, values[there])[0]
        total += float(np.sum((values[there] - columns @ scale) ** 2))
    return total


class HysteresisInputs(eqx.Module):
    """Inputs of the model in a run: input at the samples, SI, and elapsed fraction of the run."""

    values: Float[Array, " sample"]
    over: Float[Array, " sample"]


class HysteresisModel(AbstractModel):
    """Predicts `output` from `input`, or the `angle` of a joint from its `command`.

    Units of parameters that contain "input" and "output" refer to the SI units of those channels.

    Arguments:
        settings: the `[hysteresis]` section, which contains no parameters.
        operator: hysteresis operator; its parameters keep their own paths.
        offset: constant added to the output, such as the inclination of a camera.
        drift: value added to the output at the last sample; before, it grows linearly with time
            (without times, with the number of the sample).
        previous_extremes: turning points of the input before the run, the latest one last. A
            rate-independent operator remembers only such extremes of its past.
        columns: names of input and output in the runs, if known.
    """

    kind: ClassVar[str] = "hysteresis"

    settings: HysteresisSettings = eqx.field(static=True)
    operator: AbstractOperator = inline()
    offset: Scalar = parameter(LOOP.offset)
    drift: Scalar | None = parameter(LOOP.drift)
    previous_extremes: Float[Array, " extreme"] = parameter(LOOP.previous_extremes)
    columns: Columns = eqx.field(default_factory=Columns, static=True)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """Return the operator in the sidecars with initial guesses from the scale of the data.

        Raises:
            InputError: the sidecars disagree in [hysteresis], or no input ever reverses.
        """
        inputs = [input_values(run, cls.kind) for run in runs]
        outputs = [values for run in runs for values in run.observations.values()]
        first = runs[0]
        section = agreed_section(runs, cls.kind, HysteresisSection)
        operator = section.operator or "prandtl_ishlinskii"
        known = hysteresis_keys(operator)
        ignored = [key for key in section.model_dump(exclude_none=True) if key not in known]
        if ignored:
            raise InputError(
                f"[hysteresis] of '{first.name}' sets {', '.join(ignored)}, which {operator} does "
                "not have: remove this key, or choose the operator that has it"
            )
        settings = settings_for(section, inputs)
        if not any(turns(values) for values in inputs):
            raise InputError(
                f"the input of '{first.name}' never turns back, but hysteresis is visible only "
                f"after a reversal: give a run with increasing and decreasing input"
            )
        return cls._made(settings, Scale.of(inputs, outputs), Columns.of(first))

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """Return the model that `definition()` described."""
        stored = Definition.parse({"hysteresis": definition["hysteresis"]}, "stored result")
        settings = settings_for(stored.section(HysteresisSection), [])
        return cls._made(settings, Scale(), Columns.from_definition(definition))

    @classmethod
    def _made(cls, settings: HysteresisSettings, scale: Scale, columns: Columns) -> Self:
        extremes = settings.previous_extremes
        values = np.zeros(extremes) if isinstance(extremes, int) else np.asarray(extremes)
        operator = operator_from_settings(settings, scale)
        return cls(settings, operator, previous_extremes=jnp.asarray(values), columns=columns)

    def at_start(self, runs: Sequence[Run], free: Sequence[str]) -> Self:
        """Return the model with non-zero turning points before the run, if these are free.

        At 0 they have no effect. Both signs of the first turning point are tried. The one whose
        scaled and shifted prediction is closer to the data is used.
        """
        now = np.asarray(self.previous_extremes)
        tried = [
            dataclasses.replace(self, previous_extremes=jnp.asarray(extremes))
            for extremes in first_extremes(self.settings, now, free)
        ]

        def distance(model: Self) -> float:
            responses = (np.asarray(model._response(model.prepare(run))) for run in runs)
            return sum(map(unexplained, responses, runs))

        return min(tried, key=distance, default=self)

    def definition(self) -> dict[str, Any]:
        """Return the `[hysteresis]` section, and the columns of input and output if known."""
        return {"hysteresis": self.settings.to_dict(), **self.columns.to_dict()}

    def reachable(self) -> tuple[float, float]:
        """Return the outputs, SI, at the lower and upper ends of the input range.

        Each end is approached from the other one.
        """
        low, high = (jnp.asarray(end) for end in self.settings.input_range)
        operator, state, found = self.operator, self.operator.reset(), []
        for end in (low, high, low, high):
            state = operator.travelled(state, end)
            found.append(float(self.offset + operator.step(state, end)[1]))
        return found[2], found[3]

    def prepare(self, run: Run) -> HysteresisInputs:
        """Return the input of a hysteresis run."""
        values = input_values(run, self.kind)
        self.columns.check(run)
        since = np.arange(len(values)) if run.times is None else run.times - run.times[0]
        over = since / max(since[-1], 1e-300)
        return HysteresisInputs(
            *(jnp.asarray(each, jnp.result_type(float)) for each in (values, over))
        )

    def predict(self, inputs: HysteresisInputs, channels: tuple[str, ...]) -> Prediction:
        """Return the output, SI, of shape (sample,), under the name of each channel."""
        check_outputs(self.kind, channels)
        response = self._response(inputs)
        output = self.offset + response
        if self.drift is not None:
            output += self.drift * inputs.over
        fine = jnp.all(jnp.isfinite(output))
        if isinstance(self.operator, BoucWen):
            fine &= ~self.operator.too_coarse(inputs.values, response)
            # An infinite value is better than a wrong one.
            output = jnp.where(fine, output, jnp.inf)
        return dict.fromkeys(channels, output), fine

    def _response(self, inputs: HysteresisInputs) -> Float[Array, " sample"]:
        values = inputs.values
        # The input may move far to the first sample, so this move is divided into steps.
        return self.operator.history(values, self.operator.travelled(self.memory(), values[0]))[0]

    def memory(self) -> Any:
        """Return the memory before the run: that of a virgin operator after the extremes."""
        state = self.operator.reset()
        for extreme in self.previous_extremes:
            state = self.operator.travelled(state, extreme)
        return state

    def failure(self, inputs: HysteresisInputs) -> str:
        """Return the message: an infinite response, or input steps that are too large."""
        operator, response = self.operator, self._response(inputs)
        if isinstance(operator, BoucWen) and bool(operator.too_coarse(inputs.values, response)):
            return (
                "the input changes too much between two samples to resolve the narrow knee of the "
                "Bouc-Wen operator: record more samples, or start with a smaller beta, gamma or nu"
            )
        return (
            "the response of the hysteresis model is not finite: choose start values with a "
            "smaller beta, gamma or delta"
        )

    def refined(self, factor: float) -> Self:
        """Return the model with a finer integration, if its operator is integrated."""
        return eqx.tree_at(lambda model: model.operator, self, self.operator.refined(factor))

    def conditions(self, free: Sequence[str], runs: Sequence[Run] = ()) -> list[str]:
        """Return a sentence that only products of beta, gamma and delta are determined."""
        return products_condition(free) if isinstance(self.operator, BoucWen) else []

    def derived(self) -> dict[str, Derived]:
        """Return the products of the Bouc-Wen parameters that a history determines."""
        operator = self.operator
        return products(operator, "1/input") if isinstance(operator, BoucWen) else {}
