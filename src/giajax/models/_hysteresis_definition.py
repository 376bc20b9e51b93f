"""From the `[hysteresis]` section to an operator with start values, and back."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Self

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array
from ..hysteresis import (
    AbstractOperator,
    BoucWen,
    DeadZones,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    Preisach,
)
from ..kinds import HysteresisSection

Numbers = int | tuple[float, ...]

# Start values: shares of the stiffness and of the width of an ordinary loop.
_ELASTIC = 0.7
_KNEE = 4.0

# A mesh a little larger than the input: a relay at its edge would never switch.
_ROOM = 1.05


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
    """The `[hysteresis]` section with nothing left open; see `giajax.kinds.HysteresisSection`."""

    operator: str
    elements: str
    thresholds: Numbers
    upper_dead_zones: Numbers
    lower_dead_zones: Numbers
    rows: int
    input_range: tuple[float, float]
    previous_extremes: Numbers

    def to_dict(self) -> dict[str, Any]:
        """The section as plain data, with what this operator uses."""
        plain = {name: getattr(self, name) for name in hysteresis_keys(self.operator)}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in plain.items()
        }

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
            "the input never changes, so that nothing responds to it: give a run in which it does"
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
            elements=_elements(settings),
        )
    if settings.operator == "modified_prandtl_ishlinskii":
        thresholds = _even(settings.thresholds, reach)
        upper = _dense(settings.upper_dead_zones, abs(settings.input_range[1]) or reach)
        lower = _dense(settings.lower_dead_zones, abs(settings.input_range[0]) or reach)
        curve = DeadZones(
            _array(slope),
            upper,
            jnp.full_like(upper, slope),
            lower,
            jnp.full_like(lower, slope),
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


def check_keys(name: str, section: HysteresisSection) -> None:
    """Refuse keys of `[hysteresis]` that the operator of a run does not have.

    Raises:
        InputError: naming the run, the keys and the operator.
    """
    operator = section.operator or "prandtl_ishlinskii"
    known = hysteresis_keys(operator)
    ignored = [key for key in section.model_dump(exclude_none=True) if key not in known]
    if ignored:
        raise InputError(
            f"[hysteresis] of '{name}' states {', '.join(ignored)}, which {operator} does not "
            "have: remove it, or state the operator that it belongs to"
        )


def _array(value: float | np.ndarray) -> Array:
    return jnp.asarray(value, dtype=jnp.result_type(float))


def _elements(settings: HysteresisSettings) -> Any:
    return settings.elements


def _even(numbers: Numbers, reach: float) -> Array:
    if not isinstance(numbers, int):
        return _array(np.asarray(numbers))
    return _array(reach * np.arange(1, numbers + 1) / (numbers + 1))


def _dense(numbers: Numbers, reach: float) -> Array:
    """Densest near 0, where a joint is soft."""
    if not isinstance(numbers, int):
        return _array(np.asarray(numbers))
    return _array(reach * (np.arange(1, numbers + 1) / (numbers + 1)) ** 2)
