"""Records of profiles: the increase of the cost when a quantity is held away from its estimate.

The file `profiles.json` has the same fields, and the records can be read from it.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from ..runtime.files import read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.records import parse_record
from ..runtime.text import InputError
from ._refit import StudyRecord

PROFILES = "profiles.json"
Ending: TypeAlias = Literal["level", "bound", "flat", "failed", "unfinished", "stopped"]
"""Reason why one side of a profile ended.

- level: the deviance exceeds the limit of the interval.
- bound: the quantity reached its bound first, so the interval ends there and is one-sided.
- flat: the deviance no longer rises, so the data do not limit the quantity there.
- failed: no further point could be fitted.
- unfinished: the deviance rises so slowly that the maximum number of points was reached.
- stopped: the profile was stopped by Ctrl-C.
"""


@dataclasses.dataclass(frozen=True)
class ProfilePoint:
    """Best fit with the quantity held at one value.

    Attributes:
        value: held value, SI.
        deviance: increase of the cost, scaled such that the linear interval corresponds to a
            parabola of height 1 at one standard error.
        values: values of the parameters of the model at this point, SI, in the order of
            `Profiles.labels`.
        at_bounds: names of other parameters that are at a bound at this point.
    """

    value: float
    deviance: float
    values: tuple[float, ...]
    at_bounds: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Profile:
    """Profile of one quantity.

    Attributes:
        name: name of a free parameter, with its run or group of runs if it is not shared, or of a
            derived quantity.
        unit: SI unit.
        value: estimate of the fit.
        standard_error: standard error of the fit; None if there is none.
        linear: interval of the fit, from Student's t within the bounds; None if there is no
            standard error.
        reach: square root of the deviance at which the interval ends: the quantile of Student's t.
        lower, upper: bounds of the quantity; None if there is none.
        interval: profile-likelihood interval; it ends where the deviance reaches the square of
            `reach`, or at a bound. None for an end that was not found.
        ended: reasons why the lower and the upper side ended.
        points: points in ascending order of the quantity, including the estimate.
        lowest: deviance of the best point; negative if the fit was not at its optimum.
        remarks: sentences that a reader must know.
    """

    name: str
    unit: str
    value: float
    standard_error: float | None
    linear: tuple[float, float] | None
    reach: float
    lower: float | None
    upper: float | None
    interval: tuple[float | None, float | None]
    ended: tuple[Ending, Ending]
    points: tuple[ProfilePoint, ...]
    lowest: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether no side was stopped by Ctrl-C."""
        return "stopped" not in self.ended


@dataclasses.dataclass(frozen=True)
class Profiles(
    StudyRecord, file=PROFILES, head={"giajax_profiles": 1}, remedy="run 'giajax profile' again"
):
    """Profiles of the quantities of a fit.

    Attributes:
        fit: `fit_key` of the result.
        level: confidence level of the intervals.
        labels: names of the free parameters of the model whose values the points contain.
        profiles: profiles by the name of the quantity.
    """

    fit: str
    level: float
    labels: tuple[str, ...]
    profiles: dict[str, Profile]

    def __getitem__(self, name: str) -> Profile:
        """Return the profile of a quantity."""
        return self.profiles[name]


def load_profiles(path: str | Path) -> Profiles:
    """Read a `profiles.json` file, given its path or the folder of the result.

    Example:
        >>> profiles = load_profiles("giajax-out/base_step")  # doctest: +SKIP
        >>> profiles["air.drag_coefficient"].interval  # doctest: +SKIP
    """
    path = Path(path)
    path = path / PROFILES if path.is_dir() else path
    what = f"{path} does not contain profiles of this version of giajax"
    try:
        text = read_bytes(path, RESULT_BYTES)
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: create it with 'giajax profile'") from None
    except OSError as error:
        raise InputError(f"{what} ({error.strerror}): run 'giajax profile' again") from None
    return parse_record(Profiles, text, Profiles.head, what, "run 'giajax profile' again")


# A deviance that is lower than that of the fit by more than this is not a rounding error.
LOWER = 0.01


def interval_end(points: Sequence[ProfilePoint], side: int, reach: float) -> float | None:
    """Return the upper (side 1) or lower (-1) value at which the deviance rises by reach^2.

    The rise is measured from the minimum. The square root of the deviance is nearly linear, so its
    inverse is interpolated by a monotone cubic (Fritsch and Carlson 1980). Points are in ascending
    order of the value. None if the deviance does not rise so far.
    """
    ordered = points if side > 0 else points[::-1]
    lowest = min(range(len(ordered)), key=lambda index: ordered[index].deviance)
    base = ordered[lowest].deviance
    roots = [float(np.sqrt(max(point.deviance - base, 0.0))) for point in ordered[lowest:]]
    values = [point.value for point in ordered[lowest:]]
    crossing = next((index for index, root in enumerate(roots) if root >= reach), 0)
    if not crossing:
        return None
    # Imported here because it is slow to import and only profiles need it.
    from scipy.interpolate import PchipInterpolator

    # Points from the first crossing inwards, without those at which a rough cost rises, and one
    # point beyond the crossing.
    kept = [crossing]
    for index in range(crossing - 1, -1, -1):
        if roots[index] < roots[kept[0]]:
            kept.insert(0, index)
    if crossing + 1 < len(roots) and roots[crossing + 1] > roots[crossing]:
        kept.append(crossing + 1)
    inverse = PchipInterpolator([roots[i] for i in kept], [values[i] for i in kept])
    return float(inverse(reach))


def remarks_on(
    points: Sequence[ProfilePoint],
    interval: tuple[float | None, float | None],
    ended: tuple[Ending, Ending],
    reasons: tuple[str, str],
    value: float,
) -> tuple[str, ...]:
    """Return the sentences that a reader must know before using the interval."""
    said = []
    lowest = min(points, key=lambda point: point.deviance)
    if lowest.deviance < -LOWER:
        said.append(
            f"the fit was not at its optimum: the deviance is {lowest.deviance:.2g} at "
            f"{lowest.value:.5g}, so fit again from this value"
        )
    for place, word in enumerate(("lower", "upper")):
        if (sentence := _of_side(ended[place], reasons[place], word)) is not None:
            said.append(sentence)
        elif interval[place] is None and ended[place] == "level":
            said.append(f"its {word} limit was not found: fit again from the point of lowest cost")
    if ended == ("bound", "bound"):
        said.append("the data do not constrain it within its bounds")
    low = -np.inf if interval[0] is None else interval[0]
    high = np.inf if interval[1] is None else interval[1]
    inside = [point for point in points if low <= point.value <= high]
    at_optimum = {name for point in points if point.value == value for name in point.at_bounds}
    met: dict[str, float] = {}
    left: dict[str, float] = {}
    for point in sorted(inside, key=lambda point: abs(point.value - value)):
        met = dict.fromkeys(set(point.at_bounds) - at_optimum, point.value) | met
        left = dict.fromkeys(at_optimum - set(point.at_bounds), point.value) | left
    said += [f"{name} reaches its bound at {met[name]:.5g}" for name in sorted(met)]
    said += [f"{name} leaves its bound at {left[name]:.5g}" for name in sorted(left)]
    return tuple(said)


def _of_side(ended: Ending, reason: str, word: str) -> str | None:
    why = {
        "wall": "the model cannot be evaluated beyond this point",
        "iterations": "a fit reached its iteration limit",
    }.get(reason, reason if " " in reason else "a fit did not end at an optimum")
    sentences = {
        "bound": f"one-sided: its {word} limit is its bound",
        "flat": f"the data give no {word} limit{f': {reason}' if reason else ''}",
        "failed": f"its {word} limit was not reached: {why}",
        "unfinished": f"its {word} limit was not reached: the deviance rises too slowly",
        "stopped": f"the search for its {word} limit was stopped",
    }
    return sentences.get(ended)
