"""What the points of a profile say: the ends of the interval, and what a reader must know."""

from collections.abc import Sequence

import numpy as np

from ._profile_records import Ending, ProfilePoint

# A deviance this far below that of the fit is no rounding.
LOWER = 0.01


def interval_end(points: Sequence[ProfilePoint], side: int, reach: float) -> float | None:
    """Where the deviance above its lowest comes to the square of `reach`.

    Of the root, which is nearly straight, the inverse is interpolated by a monotone cubic
    (Fritsch and Carlson 1980).

    Arguments:
        points: by value, ascending, the estimate among them.
        side: 1 for the upper end, -1 for the lower one.
        reach: root of the deviance.

    Returns:
        The value of the quantity; None where the points do not come to it.
    """
    ordered = points if side > 0 else points[::-1]
    lowest = min(range(len(ordered)), key=lambda index: ordered[index].deviance)
    base = ordered[lowest].deviance
    roots = [float(np.sqrt(max(point.deviance - base, 0.0))) for point in ordered[lowest:]]
    values = [point.value for point in ordered[lowest:]]
    crossing = next((index for index, root in enumerate(roots) if root >= reach), None)
    if crossing is None or crossing == 0:
        return None
    # Slow to import, and needed for profiles alone.
    from scipy.interpolate import PchipInterpolator

    # From the first crossing inwards, without what a rough cost makes rise there; and one beyond.
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
    """Sentences on what a reader must know before using the interval.

    Arguments:
        points: by value, ascending.
        interval: the ends that were found.
        ended: what ended each side.
        reasons: more of it, in a word.
        value: the estimate.
    """
    said = []
    lowest = min(points, key=lambda point: point.deviance)
    if lowest.deviance < -LOWER:
        said.append(
            f"the fit was not at its optimum: the deviance is {lowest.deviance:.2g} at "
            f"{lowest.value:.5g}, so fit again from there"
        )
    for place, word in enumerate(("lower", "upper")):
        if (sentence := _of_side(ended[place], reasons[place], word)) is not None:
            said.append(sentence)
        elif interval[place] is None and ended[place] == "level":
            said.append(f"its {word} end was not found: fit again from the lowest cost")
    if ended == ("bound", "bound"):
        said.append("the data say nothing within its bounds")
    inside = [
        point
        for point in points
        if (interval[0] is None or point.value >= interval[0])
        and (interval[1] is None or point.value <= interval[1])
    ]
    at_optimum = next((point.at_bounds for point in points if point.value == value), ())
    met: dict[str, float] = {}
    left: dict[str, float] = {}
    for point in sorted(inside, key=lambda point: abs(point.value - value)):
        for name in set(point.at_bounds) - set(at_optimum):
            met.setdefault(name, point.value)
        for name in set(at_optimum) - set(point.at_bounds):
            left.setdefault(name, point.value)
    said += [f"{name} meets its bound at {met[name]:.5g}" for name in sorted(met)]
    said += [f"{name} leaves its bound at {left[name]:.5g}" for name in sorted(left)]
    return tuple(said)


def _of_side(ended: Ending, reason: str, word: str) -> str | None:
    if ended == "bound":
        return f"one-sided: its {word} end is its bound"
    if ended == "flat":
        return f"the data give it no {word} end" + (f": {reason}" if reason else "")
    if ended == "failed":
        why = {
            "wall": "the model cannot be evaluated beyond",
            "iterations": "a fit used up its iterations",
        }.get(reason, reason if " " in reason else "a fit did not end at an optimum")
        return f"its {word} end was not reached: {why}"
    if ended == "unfinished":
        return f"its {word} end was not reached: the deviance rises too slowly"
    if ended == "stopped":
        return f"its {word} side was stopped"
    return None
