"""Which rows of a log are knots of a signal, and how rough it is at them for a step."""

import numpy as np

# Parts of a piece whose ends are compared with the cubic.
_PARTS = 4

# Beyond this, as a fraction of the largest value, no tolerance has use for a stretch.
_ROUGH = 0.1


def corner_rows(times: np.ndarray, values: np.ndarray, allowed: float) -> np.ndarray:
    """Rows that remain when those on a straight line between their neighbours are merged.

    From each kept row the band of slopes that pass within `allowed` of every row seen so far
    narrows until it is empty; the row before that is the next corner.

    Arguments:
        times: of the rows, increasing, s, shape (row,).
        values: of the rows, shape (row, width).
        allowed: how far a merged row may lie off the line, in the unit of the values.

    Returns:
        Indices of the rows that remain, shape (knot,).
    """
    kept = [0]
    lowest, highest = np.full(values.shape[1], -np.inf), np.full(values.shape[1], np.inf)
    for row in range(1, len(times)):
        elapsed = times[row] - times[kept[-1]]
        rise = values[row] - values[kept[-1]]
        slope = rise / elapsed
        if np.any(slope < lowest) or np.any(slope > highest):
            kept.append(row - 1)
            elapsed = times[row] - times[row - 1]
            rise = values[row] - values[row - 1]
            lowest, highest = (rise - allowed) / elapsed, (rise + allowed) / elapsed
            continue
        lowest = np.maximum(lowest, (rise - allowed) / elapsed)
        highest = np.minimum(highest, (rise + allowed) / elapsed)
    if len(times) > 1:
        kept.append(len(times) - 1)
    return np.asarray(kept)


def roughness(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """How far a signal is from a cubic around each knot, as a fraction of its largest value.

    Stretches of 2, 4, 8, ... pieces are compared with the cubic that fits each best. A knot inside
    of one is as rough as the smallest stretch that has it in the middle, or any stretch within
    that. What two knots that are rougher than a tolerance enclose is therefore a cubic to within
    the tolerance, and hides nothing from a step, however long.

    Arguments:
        times: of the knots, increasing, s, shape (knot,).
        values: at the knots, linear in between, shape (knot, width).

    Returns:
        The roughness, shape (knot,); infinite where no stretch has the knot in its middle, as at
        both ends.
    """
    rough = np.full(len(times), np.inf)
    size = np.abs(values).max()
    values = values[:, np.ptp(values, axis=0) > 0]
    if values.size == 0:
        return rough
    pieces, within = 2, np.zeros(len(times) - 1)
    while pieces < len(times):
        count = (len(times) - 1) // pieces
        within = within[: 2 * count].reshape(count, 2).max(axis=1)
        within = np.maximum(within, _off_cubics(times, values / size, pieces, count))
        rough[pieces // 2 :: pieces][:count] = within
        if within.min() > _ROUGH:
            break
        pieces *= 2
    return rough


def _off_cubics(times: np.ndarray, values: np.ndarray, pieces: int, count: int) -> np.ndarray:
    """Largest distances of stretches of some pieces from their cubics, shape (count,)."""
    part = np.arange(_PARTS * pieces + 1)
    piece = np.minimum(part // _PARTS, pieces - 1)
    knot = pieces * np.arange(count)[:, None] + piece
    share = part / _PARTS - piece
    at = times[knot] + share * (times[knot + 1] - times[knot])
    value = values[knot] + share[:, None] * (values[knot + 1] - values[knot])
    x = 2 * (at - at[:, :1]) / (at[:, -1:] - at[:, :1]) - 1
    basis = np.linalg.qr(np.stack([np.ones_like(x), x, x**2, x**3], axis=-1))[0]
    off = value - basis @ (basis.swapaxes(1, 2) @ value)
    return np.asarray(np.abs(off).max(axis=(1, 2)))
