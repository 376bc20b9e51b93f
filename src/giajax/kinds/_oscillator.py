"""An oscillator: a mass on a spring and a damper, with a Bouc-Wen element beside them."""

from typing import Any, Literal

from ._content import Content
from ._hysteresis import CHANNELS
from ._kind import Kind
from ._section import Section, key


class OscillatorSection(Section):
    """`[oscillator]`: the options of an oscillator, parameters apart."""

    interpolation: Literal["linear", "band_limited"] | None = key(
        '"linear" or "band_limited" (one period of evenly sampled rows)',
        "force between two rows",
        preset="linear",
    )


def _never(rows: frozenset[str]) -> bool:
    """Its columns are those of a hysteresis run: a sidecar must say which it is."""
    return False


def _interpolation(content: Content) -> str:
    return content.definition.section(OscillatorSection).interpolation or "linear"


def _upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Version 0.1 had the oscillator as an operator of `[hysteresis]`."""
    before = data.get("hysteresis")
    if not isinstance(before, dict) or before.get("operator") != "bouc_wen_oscillator":
        # A fit definition of that version names only the model, beside such a sidecar.
        renamed = data.get("model") == "hysteresis" and "oscillator" in data and not before
        return {**data, "model": "oscillator"} if renamed else data
    section = {name: value for name, value in before.items() if name == "interpolation"}
    upgraded = {name: value for name, value in data.items() if name != "hysteresis"}
    return {**upgraded, "model": "oscillator", "oscillator": section}


OSCILLATOR = Kind(
    name="oscillator",
    model="_oscillator:OscillatorModel",
    channels=CHANNELS,
    recognises=_never,
    measured="output or angle_deg",
    sections={"oscillator": OscillatorSection},
    commands=("input", "command"),
    timed=True,
    interpolation=_interpolation,
    former_parameters=frozenset({"previous_extremes"}),
    upgraded=_upgraded,
)
