"""A wind as numbers that may be fitted: logarithms, and turns of the mean flow."""

from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ._response import Turbulence
from ._resting import Resting

NUMBERS = ("speed", "deviation", "length_scale", "decay", "heading", "climb")
"""What a wind has, in the order of a result."""

UNITS = {"speed": "m/s", "deviation": "m/s", "length_scale": "m", "decay": ""}
UNITS |= {"heading": "rad", "climb": "rad"}
USUALLY = ("speed", "deviation", "length_scale")
TURNS = ("heading", "climb")


class Numbers:
    """The free numbers of a wind and of noise, as coordinates of a fit.

    Arguments:
        wind: what is held, and where a fit begins.
        free: of `NUMBERS`.
        record: whose noise is free by quantity where none is stated.
    """

    def __init__(self, wind: Turbulence, free: Sequence[str], record: Resting) -> None:
        self.wind = wind
        self.free = tuple(name for name in NUMBERS if name in free)
        stated = record.noise
        self.white = np.array([0.0 if one is None else one[0] for one in stated])
        open_noise = [
            quantity for quantity, one in zip(record.quantities, stated, strict=True) if one is None
        ]
        self.open = tuple(dict.fromkeys(open_noise))
        self.which = [
            np.array(
                [
                    one is None and quantity == name
                    for quantity, one in zip(record.quantities, stated, strict=True)
                ]
            )
            for name in self.open
        ]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coordinates."""
        return self.free + tuple(f"noise of {quantity.replace('_', ' ')}" for quantity in self.open)

    def start(self, deviations: np.ndarray) -> np.ndarray:
        """Coordinates of the beginning, with such deviations of each channel's noise, SI."""
        turns = dict(zip(TURNS, _turns(self.wind.mean), strict=True))
        wind = [turns[n] if n in TURNS else np.log(self._held(n)) for n in self.free]
        return np.array(wind + [np.log(np.median(deviations[which])) for which in self.which])

    def at(self, coordinates: np.ndarray) -> tuple[Turbulence, np.ndarray]:
        """The wind, and the deviation of white noise of each channel, SI."""
        split = len(self.free)
        value = dict(zip(self.free, coordinates[:split], strict=True))
        heading, climb = (
            value.get(name, turn) for name, turn in zip(TURNS, _turns(self.wind.mean), strict=True)
        )
        flat = np.cos(climb)
        along = np.array([flat * np.cos(heading), flat * np.sin(heading), np.sin(climb)])
        positive = {
            name: float(np.exp(value[name])) if name in value else self._held(name)
            for name in ("speed", "deviation", "length_scale", "decay")
        }
        white = self.white.copy()
        for which, level in zip(self.which, coordinates[split:], strict=True):
            white[which] = np.exp(level)
        return (
            Turbulence(
                along * positive["speed"],
                positive["deviation"],
                positive["length_scale"],
                positive["decay"],
                self.wind.shares,
            ),
            white,
        )

    def value(self, name: str, wind: Turbulence) -> float:
        """A number of a wind."""
        if name in TURNS:
            return float(_turns(wind.mean)[TURNS.index(name)])
        return float(getattr(wind, name))

    def _held(self, name: str) -> float:
        return float(getattr(self.wind, name))


def first_guess(
    mean: Sequence[float] | np.ndarray | None,
    intensity: float | Sequence[float],
    length_scale: float,
    decay: float,
) -> Turbulence:
    """The wind that a fit begins with.

    Raises:
        InputError: no mean flow, or numbers that are not positive.
    """
    flow = np.zeros(3) if mean is None else np.asarray(mean, float)
    if flow.shape != (3,) or not np.all(np.isfinite(flow)) or not np.any(flow):
        raise InputError(
            "no mean wind is stated to begin with, or one that is 0, about which drag has no "
            "slope: give its rough velocity, three numbers in m/s"
        )
    parts = np.asarray(intensity, float)
    sound = np.all(np.isfinite(parts) & (parts >= 0))
    if parts.shape not in ((), (3,)) or not sound or not parts.flat[0] > 0:
        raise InputError(
            f"the intensity to begin with is {np.array2string(parts)}: give one number or three, "
            "the first of them positive"
        )
    if not (0 < length_scale < np.inf and 0 <= decay < np.inf):
        raise InputError(
            f"the length scale to begin with is {length_scale:g} m and the decay {decay:g}: give "
            "a positive one, and one of at least 0"
        )
    shares = np.broadcast_to(parts / parts.flat[0], 3)
    return Turbulence(
        flow,
        float(parts.flat[0] * np.linalg.norm(flow)),
        length_scale,
        decay,
        (float(shares[0]), float(shares[1]), float(shares[2])),
    )


def _turns(mean: np.ndarray) -> tuple[float, float]:
    """Heading from x towards y, and climb, rad."""
    return float(np.arctan2(mean[1], mean[0])), float(np.arctan2(mean[2], np.hypot(*mean[:2])))
