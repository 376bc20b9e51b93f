"""Hysteresis as a model: from the history of an input to that of an output."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..hysteresis import AbstractOperator, BoucWen
from ..kinds import HysteresisSection
from ..parameters import inline, parameter
from ..quantities import LOOP
from ..runs import Definition, Run
from ._agreement import agreed_section
from ._direct import AbstractDirectModel
from ._extremes import first_extremes, turns, unexplained
from ._hysteresis_definition import (
    HysteresisSettings,
    Scale,
    check_keys,
    operator_from_settings,
    settings_for,
)
from ._protocol import Channels, Derived
from ._response import Columns, check_outputs, input_values, products, products_condition


class HysteresisInputs(eqx.Module):
    """What the model needs of a run: the input at the samples, SI."""

    values: Float[Array, " sample"]


class HysteresisModel(AbstractDirectModel):
    """Predicts `output` from `input`, or the `angle` of a joint from its `command`.

    Units of parameters in terms of "input" and "output" are the SI units of those channels.

    Arguments:
        settings: the `[hysteresis]` section, which holds no parameters.
        operator: its parameters keep their own paths.
        offset: added to the output, such as the inclination of a camera.
        previous_extremes: turning points of the input before the run, the latest last. What a
            rate-independent operator remembers of its past is a list of such extremes.
        columns: of input and output in the runs, where known.
    """

    kind: ClassVar[str] = "hysteresis"

    settings: HysteresisSettings = eqx.field(static=True)
    operator: AbstractOperator = inline()
    offset: Scalar = parameter(LOOP.offset)
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
        check_keys(first.name, section)
        settings = settings_for(section, inputs)
        if not any(turns(values) for values in inputs):
            raise InputError(
                f"the input of '{first.name}' never turns back, and hysteresis shows only where it "
                "does: give a run that goes up and down"
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

    def scene(self, run: Run) -> None:
        """Nothing: an operator has no shape."""

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
        operator = self.operator
        state = operator.travelled(operator.travelled(operator.reset(), low), high)
        state = operator.travelled(state, low)
        _, lowest = operator.step(state, low)
        state = operator.travelled(state, high)
        _, highest = operator.step(state, high)
        return float(self.offset + lowest), float(self.offset + highest)

    def prepare(self, run: Run) -> HysteresisInputs:
        """The input of a hysteresis run."""
        values = input_values(run, self.kind)
        self.columns.check(run)
        return HysteresisInputs(jnp.asarray(values, jnp.result_type(float)))

    def predict(
        self, inputs: HysteresisInputs, channels: tuple[str, ...]
    ) -> tuple[Channels, Bool[Array, ""]]:
        """The output, SI, under the name of each channel, of shape (sample,)."""
        check_outputs(self.kind, channels)
        response = self._response(inputs)
        output = self.offset + response
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
        operator = self.operator
        if isinstance(operator, BoucWen) and bool(
            operator.too_coarse(inputs.values, self._response(inputs))
        ):
            return (
                "the input moves too far between two samples for the narrow knee of the "
                "Bouc-Wen operator: record more samples, or start with a smaller beta, gamma "
                "or nu"
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
