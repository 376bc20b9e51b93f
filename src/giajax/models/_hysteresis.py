"""Hysteresis as a model: from the history of an input to that of an output."""

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
    """The columns of input and output in the runs of a model, such as "command_deg" and
    "angle_deg".

    They are empty where not known.
    """

    input: str = ""
    output: str = ""

    @classmethod
    def of(cls, run: Run) -> Self:
        """Those of a run."""
        driven, measured = input_channel(run, run.model), output_channel(run)
        return cls(driven.column, "" if measured is None else measured.column)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """As `to_dict` gave them."""
        columns = [definition.get(key, "") for key in ("input_column", "output_column")]
        if not all(isinstance(column, str) for column in columns):
            raise InputError(
                f"the columns {shown(columns)} are not strings: give the names as strings"
            )
        return cls(*columns)

    def to_dict(self) -> dict[str, str]:
        """Those that are known, as plain data."""
        both = {"input_column": self.input, "output_column": self.output}
        return {name: column for name, column in both.items() if column}

    @property
    def input_channel(self) -> Channel:
        """The channel that drove the runs; the command of a joint where that is not known."""
        return parse_column(self.input or "command_rad")

    @property
    def output_channel(self) -> Channel | None:
        """The channel that the runs measured; None where that is not known."""
        return parse_column(self.output) if self.output else None

    def check(self, run: Run) -> None:
        """Raise `InputError` for a run of other quantities than those of the model."""
        own = [self.input_channel if self.input else None, self.output_channel]
        theirs = [input_channel(run, run.model), output_channel(run)]
        for mine, other in zip(own, theirs, strict=True):
            if mine is not None and other is not None and not comparable(mine, other):
                raise InputError(
                    f"'{run.name}' has the column {other.column}, but the model uses "
                    f"{mine.column}: give a run of the same quantity"
                )


def input_channel(run: Run, kind: str) -> Channel:
    """The channel that drives a run of a kind of model that has one input.

    Raises:
        InputError: a run of another kind, or with none or several.
    """
    if run.model != kind:
        raise InputError(
            f"'{run.name}' is a run of the {run.model} model: give a run of the {kind} model"
        )
    names = list(run.commands)
    if len(names) != 1:
        raise InputError(
            f"'{run.name}' must have one column of input or command, but has "
            f"{' and '.join(names) or 'none'}: rename or remove columns"
        )
    if len(_outputs(run)) > 1:
        raise InputError(f"'{run.name}' has both output and angle: remove one of the columns")
    return run.channels[names[0]]


def input_values(run: Run, kind: str) -> np.ndarray:
    """What drives a run of a kind of model that has one input, SI, shape (sample,).

    Raises:
        InputError: as `input_channel`.
    """
    return np.asarray(run.values[input_channel(run, kind).name], dtype=float)


def output_channel(run: Run) -> Channel | None:
    """The channel that a run measures; None where it measures none."""
    return next(iter(_outputs(run)), None)


def _outputs(run: Run) -> list[Channel]:
    return [channel for channel in run.channels.values() if channel.kind in run.kind.outputs]


def comparable(one: Channel, other: Channel) -> bool:
    """Whether two channels may be of one quantity; a bare `input` or `output` says none."""
    return "ratio" in (one.quantity, other.quantity) or one.quantity == other.quantity


def check_outputs(kind: str, channels: Sequence[str]) -> None:
    """Raise `InputError` for a channel that a kind of model does not predict."""
    outputs = KINDS[kind].outputs
    for name in channels:
        if Channel.named(name).kind not in outputs:
            raise InputError(
                f"'{name}' is not predicted by the {kind} model: use one of {', '.join(outputs)}"
            )


def products(element: BoucWen | BoucWenOscillator, unit: str) -> dict[str, Derived]:
    """The products of Bouc-Wen parameters that a history determines."""
    return {
        "beta*gamma": Derived(element.beta * element.gamma, unit),
        "beta*delta": Derived(element.beta * element.delta, unit),
    }


def products_condition(free: Sequence[str]) -> list[str]:
    """That beta, gamma and delta count only as products, where one of them is free."""
    names = [path for path in free if path in ("beta", "gamma", "delta")]
    held = [path for path in ("beta", "gamma", "delta") if path not in free]
    if not names:
        return []
    how = f"; held parameters: {', '.join(held)}" if held else ""
    return [f"{', '.join(names)}: only the products beta gamma and beta delta are determined{how}"]


Numbers = int | tuple[float, ...]

# Start values: shares of the stiffness and of the width of an ordinary loop.
_ELASTIC = 0.7
_KNEE = 4.0

_ROOM = 1.05  # a mesh a little larger than the input: a relay at its edge would never switch


def hysteresis_keys(operator: str) -> list[str]:
    """The keys of the `[hysteresis]` section that an operator uses."""
    used = {
        "prandtl_ishlinskii": ("elements", "thresholds"),
        "modified_prandtl_ishlinskii": ("thresholds", "upper_dead_zones", "lower_dead_zones"),
        "preisach": ("rows",),
        "bouc_wen": (),
    }[operator]
    return ["operator", *used, "input_range", "previous_extremes"]


@dataclasses.dataclass(frozen=True)
class HysteresisSettings:
    """The `[hysteresis]` section with nothing left open; see `giajax.schema.HysteresisSection`."""

    operator: str
    elements: Literal["play", "stop"]
    thresholds: Numbers
    upper_dead_zones: Numbers
    lower_dead_zones: Numbers
    rows: int
    input_range: tuple[float, float]
    previous_extremes: Numbers

    def to_dict(self) -> dict[str, Any]:
        """The section as plain data, with what this operator uses."""
        plain = {name: getattr(self, name) for name in hysteresis_keys(self.operator)}
        return {name: list(of) if isinstance(of, tuple) else of for name, of in plain.items()}

    @property
    def reach(self) -> float:
        """Half the range of the input."""
        return (self.input_range[1] - self.input_range[0]) / 2


def settings_for(section: HysteresisSection, inputs: Sequence[np.ndarray]) -> HysteresisSettings:
    """What the section says, and for the rest the default; the range is that of the inputs.

    Raises:
        InputError: an input that never changes.
    """
    ends = section.input_range
    if ends is None:
        together = np.concatenate([*inputs]) if inputs else np.zeros(1)
        ends = [float(np.min(together)), float(np.max(together))]
    if not ends[0] < ends[1]:
        raise InputError(
            "the input never changes, so that the output is constant: give a run in which it "
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
    """The size of the data, which start values are made from: slope and half range of output."""

    slope: float = 1.0
    height: float = 1.0

    @classmethod
    def of(cls, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> Self:
        """From recorded histories; of 1 where nothing was recorded."""
        measured = [values[~np.isnan(values)] for values in outputs]
        if not measured:
            return cls()
        height = float(np.ptp(np.concatenate(measured))) / 2
        width = float(np.ptp(np.concatenate(list(inputs)))) / 2
        return cls(height / width, height) if height > 0 and width > 0 else cls()


def operator_from_settings(settings: HysteresisSettings, scale: Scale) -> AbstractOperator:
    """The operator with start values of the size of the data."""
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
    """Densest near 0, where a joint is soft."""
    if not isinstance(numbers, int):
        return _array(np.asarray(numbers))
    return _array(reach * (np.arange(1, numbers + 1) / (numbers + 1)) ** 2)


# Where turning points before the run are looked for first, as a part of the reach of the input.
_FIRST_EXTREME = 0.75


def turns(values: np.ndarray) -> bool:
    """Whether an input, shape (sample,), ever turns back."""
    steps = np.diff(values)
    steps = steps[steps != 0]
    return bool(np.any(steps[1:] * steps[:-1] < 0))


def first_extremes(
    settings: HysteresisSettings, now: np.ndarray, free: Sequence[str]
) -> list[np.ndarray]:
    """Turning points to start from, one list for each direction that the latest one came from.

    `now` are those of the model before the run, of the input, SI; of `free`, the paths of the
    elements to fit that have no start, those at 0 are moved. No list where there are none.
    """
    count = len(now)
    paths = [f"previous_extremes[{index}]" for index in range(count)]
    moved = np.asarray([path in free for path in paths], dtype=bool) & (now == 0)
    if isinstance(settings.previous_extremes, tuple) or not np.any(moved):
        return []
    low, high = settings.input_range
    # Within each other, so that a later one does not wipe out an earlier one.
    sizes = _FIRST_EXTREME * settings.reach * np.arange(count, 0, -1) / count
    signs = (-1.0) ** np.arange(count)
    return [np.where(moved, (low + high) / 2 + sign * signs * sizes, now) for sign in (1.0, -1.0)]


def unexplained(response: np.ndarray, run: Run) -> float:
    """Sum of the squares that the best scale and offset of a response leave of what a run measured,
    SI.

    It is infinite where the response is not finite.
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
    """What the model needs of a run: the input at the samples, SI, and the share of the run that
    is over.
    """

    values: Float[Array, " sample"]
    over: Float[Array, " sample"]


class HysteresisModel(AbstractModel):
    """Predicts `output` from `input`, or the `angle` of a joint from its `command`.

    Units of parameters in terms of "input" and "output" are the SI units of those channels.

    Arguments:
        settings: the `[hysteresis]` section, which holds no parameters.
        operator: its parameters keep their own paths.
        offset: added to the output, such as the inclination of a camera.
        drift: added to the output at the last sample, and in proportion to time (without times, to
            the number of samples) before.
        previous_extremes: turning points of the input before the run, the latest last. What a
            rate-independent operator remembers of its past is a list of such extremes.
        columns: of input and output in the runs, where known.
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
        """The operator that the sidecars state, with start values of the size of the data.

        Raises:
            InputError: the sidecars disagree in [hysteresis], or no input ever turns.
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
                f"[hysteresis] of '{first.name}' states {', '.join(ignored)}, which {operator} "
                "does not have: remove this key, or state the operator that has it"
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
        """The operator that `definition()` described."""
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
        """With turning points before the run, where they are free: at 0 they leave no trace.

        Those of the two directions from which the latest one may have come are tried, and that
        is taken whose prediction, scaled and shifted, is the closer one.
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
        """The `[hysteresis]` section, and the columns of input and output where known."""
        return {"hysteresis": self.settings.to_dict(), **self.columns.to_dict()}

    def reachable(self) -> tuple[float, float]:
        """Least and largest output, SI, at the ends of the range of the input.

        Each end is come to from the other one.
        """
        low, high = (jnp.asarray(end) for end in self.settings.input_range)
        operator, state, found = self.operator, self.operator.reset(), []
        for end in (low, high, low, high):
            state = operator.travelled(state, end)
            found.append(float(self.offset + operator.step(state, end)[1]))
        return found[2], found[3]

    def prepare(self, run: Run) -> HysteresisInputs:
        """The input of a hysteresis run."""
        values = input_values(run, self.kind)
        self.columns.check(run)
        since = np.arange(len(values)) if run.times is None else run.times - run.times[0]
        over = since / max(since[-1], 1e-300)
        return HysteresisInputs(
            *(jnp.asarray(each, jnp.result_type(float)) for each in (values, over))
        )

    def predict(self, inputs: HysteresisInputs, channels: tuple[str, ...]) -> Prediction:
        """The output, SI, under the name of each channel, of shape (sample,)."""
        check_outputs(self.kind, channels)
        response = self._response(inputs)
        output = self.offset + response
        if self.drift is not None:
            output += self.drift * inputs.over
        fine = jnp.all(jnp.isfinite(output))
        if isinstance(self.operator, BoucWen):
            fine &= ~self.operator.too_coarse(inputs.values, response)
            # No number is better than a wrong one.
            output = jnp.where(fine, output, jnp.inf)
        return dict.fromkeys(channels, output), fine

    def _response(self, inputs: HysteresisInputs) -> Float[Array, " sample"]:
        values = inputs.values
        # The move to the first sample may be a long one.
        return self.operator.history(values, self.operator.travelled(self.memory(), values[0]))[0]

    def memory(self) -> Any:
        """Memory of the operator before the run: virgin, then through the previous extremes."""
        state = self.operator.reset()
        for extreme in self.previous_extremes:
            state = self.operator.travelled(state, extreme)
        return state

    def failure(self, inputs: HysteresisInputs) -> str:
        """The response is not finite, or the input moves too far between two samples."""
        operator, response = self.operator, self._response(inputs)
        if isinstance(operator, BoucWen) and bool(operator.too_coarse(inputs.values, response)):
            return (
                "the input moves too far between two samples for the narrow knee of the "
                "Bouc-Wen operator: record more samples, or start with a smaller beta, gamma or nu"
            )
        return (
            "the response of the hysteresis model is not finite: choose start values with a "
            "smaller beta, gamma or delta"
        )

    def refined(self, factor: float) -> Self:
        """The same model with a finer integration, where it has one."""
        return eqx.tree_at(lambda model: model.operator, self, self.operator.refined(factor))

    def conditions(self, free: Sequence[str], runs: Sequence[Run] = ()) -> list[str]:
        """That beta, gamma and delta count only as products."""
        return products_condition(free) if isinstance(self.operator, BoucWen) else []

    def derived(self) -> dict[str, Derived]:
        """The products of the Bouc-Wen parameters that a history determines."""
        operator = self.operator
        return products(operator, "1/input") if isinstance(operator, BoucWen) else {}
