"""Model of an oscillator: from the history of a force to that of a displacement."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..mechanics.hysteresis import MOST_STEPS, BoucWenOscillator
from ..recordings import Definition, Run
from ..runtime.arrays import Array, Float, Scalar
from ..runtime.text import InputError
from ..schema import LOOP, OscillatorSection
from ..schema.parameters import inline, parameter
from ._arm_definition import agreed_section
from ._hysteresis import Columns, check_outputs, input_values, products, products_condition
from ._protocol import AbstractModel, Prediction
from .capabilities import Derived

# Intervals between samples that differ by more than this fraction are not due to rounding.
_UNEVEN = 1e-5


class OscillatorInputs(eqx.Module):
    """Inputs of the oscillator in a run: forces and intervals.

    Forces, SI, are equally spaced since the previous sample (see `BoucWenOscillator.motion`).
    Intervals since the previous sample are in s.
    """

    forces: Float[Array, "sample part"]
    intervals: Float[Array, " sample"]


class OscillatorModel(AbstractModel):
    """Predicts `output`, the displacement of a mass, from `input`, the force on it.

    Arguments:
        oscillator: the oscillator; its parameters keep their own paths (`mass`, `beta`).
        offset: constant added to the output, such as the zero error of the sensor.
        interpolation: interpolation of the force between rows, "linear" or "band_limited".
        columns: names of input and output in the runs, if known.
    """

    kind: ClassVar[str] = "oscillator"

    oscillator: BoucWenOscillator = inline(default_factory=BoucWenOscillator)
    offset: Scalar = parameter(LOOP.offset)
    interpolation: str = eqx.field(default="linear", static=True)
    columns: Columns = eqx.field(default_factory=Columns, static=True)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """Return the oscillator of the benchmark with the interpolation in the sidecars.

        Raises:
            InputError: the sidecars disagree in [oscillator].
        """
        section = agreed_section(runs, cls.kind, OscillatorSection)
        return cls._made(section, Columns.of(runs[0]))

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """Return the oscillator that `definition()` described."""
        stored = Definition.parse({"oscillator": definition["oscillator"]}, "stored result")
        return cls._made(stored.section(OscillatorSection), Columns.from_definition(definition))

    @classmethod
    def _made(cls, section: OscillatorSection, columns: Columns) -> Self:
        return cls(interpolation=section.interpolation or "linear", columns=columns)

    def definition(self) -> dict[str, Any]:
        """Return the `[oscillator]` section, and the columns of input and output if known."""
        return {"oscillator": {"interpolation": self.interpolation}, **self.columns.to_dict()}

    def prepare(self, run: Run) -> OscillatorInputs:
        """Return the force of a run, interpolated between its rows."""
        values = input_values(run, self.kind)
        self.columns.check(run)
        if run.times is None:
            raise InputError(
                f"'{run.name}' has no times, which an oscillator requires: add the column time_s"
            )
        dtype = jnp.result_type(float)
        return OscillatorInputs(
            jnp.asarray(_forces(run.name, run.times, values, self.interpolation), dtype),
            jnp.asarray(np.diff(run.times, prepend=run.times[0]), dtype),
        )

    def predict(self, inputs: OscillatorInputs, channels: tuple[str, ...]) -> Prediction:
        """Return the displacement, SI, of shape (sample,), under the name of each channel."""
        check_outputs(self.kind, channels)
        output = self.offset + self.oscillator.motion(inputs.forces, inputs.intervals)[:, 0]
        return dict.fromkeys(channels, output), jnp.all(jnp.isfinite(output))

    def failure(self, inputs: OscillatorInputs) -> str:
        """Return the message that the motion is not finite."""
        return (
            "the motion of the oscillator is not finite: choose start values with a smaller beta, "
            "gamma or delta, or a larger mass and damping"
        )

    def refined(self, factor: float) -> Self:
        """Return the model with more integration steps between samples."""
        return eqx.tree_at(lambda model: model.oscillator, self, self.oscillator.refined(factor))

    def conditions(self, free: Sequence[str], runs: Sequence[Run] = ()) -> list[str]:
        """Return a sentence that only products of beta, gamma and delta are determined."""
        return products_condition(free)

    def derived(self) -> dict[str, Derived]:
        """Return the products of the Bouc-Wen parameters that a history determines."""
        return products(self.oscillator, "1/m")


def _forces(name: str, times: np.ndarray, values: np.ndarray, interpolation: str) -> np.ndarray:
    """Return equally spaced forces after the previous sample, shape (sample, 2 MOST_STEPS)."""
    count = 2 * MOST_STEPS
    if interpolation == "linear":
        fractions = np.arange(1, count + 1) / count
        rows = values[:-1, None] + np.diff(values)[:, None] * fractions[None]
    else:
        intervals = np.diff(times)
        if np.ptp(intervals) > _UNEVEN * np.mean(intervals):
            raise InputError(
                f"'{name}' is not sampled evenly, which interpolation = \"band_limited\" "
                'requires: set interpolation = "linear" in [oscillator]'
            )
        rows = _band_limited(values, count)[1 : count * (len(values) - 1) + 1].reshape(-1, count)
    return np.concatenate([np.full((1, count), values[0]), rows])


def _band_limited(values: np.ndarray, factor: int) -> np.ndarray:
    """Resample one period of a band-limited signal by adding zeros to its spectrum."""
    spectrum = np.fft.rfft(values)
    if len(values) % 2 == 0:
        spectrum[-1] /= 2  # the Nyquist frequency belongs to both halves of the spectrum
    return factor * np.fft.irfft(spectrum, factor * len(values))
