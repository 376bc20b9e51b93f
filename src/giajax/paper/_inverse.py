"""Table 3 the other way round: arms for which its eight cells would be as they are printed."""

from collections.abc import Sequence
from typing import Any

from ._contenders import LINKS
from ._inverse_drawn import directions, drawn, in_words, nearest, rms, rough
from ._inverse_search import CELLS, STARTS, Say, SearchEnd, search
from ._readings import READINGS
from ._reproduced import Reproduced, Sources
from ._unknown_experiment import STARTS_AT, UNKNOWNS

SOURCES = Sources(
    printed="the eight cells, the definition of the concordance, the paper's model (eq. (1) at the "
    "centres of the links, 0.047 kg each), and that joints of the prototype do not return to 0.",
    assumed=f"that the base joint bends at {STARTS_AT:g} s and turns back once, as fast as it "
    "went; that the displacement is z; no noise of a camera, no wind; and the ranges of all "
    "numbers that are looked for (in the table).",
    reconstructed="the experiment: the paper's arm with joints that remember (Dahl's friction), or "
    "in the second reading with stiffness, damping, C_D and base angle of its own, too.",
)

_PLACES = tuple(f"link {link}, {air} air, %" for air in ("with", "without") for link in LINKS)


def table3_inverse(say: Say = lambda text: None) -> Reproduced:
    """Arms for which table 3 would be as it is printed, and what its cells say of them.

    Arguments:
        say: called with what is being done.

    Returns:
        The table and the picture; after Ctrl-C those of the searches that had begun.

    Raises:
        KeyboardInterrupt: stopped before any search had begun.
    """
    ends: list[SearchEnd] = []
    for reading in READINGS:
        try:
            found = search(reading, say=say)
        except KeyboardInterrupt:
            # What the searches before it found is kept.
            break
        ends += found
        if len(found) < STARTS or any(end.why == "interrupted" for end in found):
            break
    return shown(ends)


def shown(ends: Sequence[SearchEnd]) -> Reproduced:
    """How searches ended, as a table and a picture.

    Arguments:
        ends: of them; at least one.

    Raises:
        KeyboardInterrupt: there are none, because they were stopped before any had begun.
    """
    if not ends:
        raise KeyboardInterrupt
    reached = sum(end.why == "reached" for end in ends)
    best = nearest(ends)
    title = (
        f"Table 3 the other way round: {reached or 'none'} of {len(ends)} searches reach the eight "
        f"printed cells; the nearest is {rms(best):.1f} points off in the root mean square"
    )
    return Reproduced(
        title,
        SOURCES,
        drawn(ends, title),
        ("", "printed, or range", *(f"{end.reading} {end.number}" for end in ends)),
        _rows(ends),
        _columns(ends),
        {"searches": [_record(end) for end in ends]},
    )


def _rows(ends: Sequence[SearchEnd]) -> tuple[tuple[Any, ...], ...]:
    rows: list[tuple[Any, ...]] = []
    for at, place in enumerate(_PLACES):
        rows.append((place, f"{CELLS[at]:g}", *(f"{end.out.cells[at]:.1f}" for end in ends)))
    rows.append(("error, root mean square", "", *(f"{rms(end):.1f}" for end in ends)))
    rows.append(("ended", "", *(end.why for end in ends)))
    rows.append(("steps", "", *(end.iterations for end in ends)))
    for at, link in enumerate(LINKS):
        rows.append(
            (f"link {link}: smallest |Xe|, m", "", *(f"{end.out.nearest[at]:.2g}" for end in ends))
        )
    for at, (name, unknown) in enumerate(UNKNOWNS.items()):
        cells = [
            f"{end.end[at] / unknown.unit:.3g}{'*' if name in end.at_bounds() else ''}"
            for end in ends
        ]
        rows.append((unknown.label, f"{unknown.lower:g} .. {unknown.upper:g}", *cells))
    sizes = [directions(end)[0] for end in ends]
    for at in range(len(CELLS)):
        rows.append((f"singular value {at + 1}", "", *(f"{size[at]:.2g}" for size in sizes)))
    replaced = [int(rough(end).sum()) for end in ends]
    rows.append(("derivatives that are no slopes", "", *replaced))
    return tuple(rows)


def _columns(ends: Sequence[SearchEnd]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {
        "reading": [end.reading for end in ends],
        "start": [end.number for end in ends],
        "ended": [end.why for end in ends],
        "rms_error_percent": [rms(end) for end in ends],
    }
    cells = [f"link{link:02d}_{air}_air" for air in ("with", "without") for link in LINKS]
    for at, name in enumerate(cells):
        columns[f"{name}_percent"] = [end.out.cells[at] for end in ends]
    for at, (name, unknown) in enumerate(UNKNOWNS.items()):
        columns[f"{name}_at_start"] = [end.start[at] / unknown.unit for end in ends]
        columns[name] = [end.end[at] / unknown.unit for end in ends]
    for at in range(len(CELLS)):
        columns[f"singular_value_{at + 1}"] = [directions(end)[0][at] for end in ends]
    return columns


def _record(end: SearchEnd) -> dict[str, Any]:
    sizes, rows = directions(end)
    free = READINGS[end.reading].free
    return {
        "reading": end.reading,
        "meaning": READINGS[end.reading].label,
        "start": end.number,
        "ended": end.why,
        "iterations": end.iterations,
        "cells_percent": end.out.cells,
        "rms_error_percent": rms(end),
        "arm_crosses_zero": {
            f"link{n}": bool(c) for n, c in zip(LINKS, end.out.crossed, strict=True)
        },
        "at_an_end_of_its_range": end.at_bounds(),
        "free": list(free),
        "jacobian": end.jacobian,
        "jacobian_by_differences": end.checked,
        "by_differences": [name for name, so in zip(free, rough(end), strict=True) if so],
        "singular_values": sizes,
        "right_singular_vectors": rows,
        "directions": [in_words(row, free) for row in rows],
    }
