"""What the recording cannot tell of a wind, in words."""

import itertools

import numpy as np

from ._response import Turbulence

# Standard error of a logarithm beyond which nothing is known: a factor of e.
OPEN = 1.0
_TOGETHER = 0.9
_OFF = 5.0
_ASIDE = 3.0
_SWINGS = 0.3
_GUSTS = 30


def wind_notes(
    wind: Turbulence,
    *,
    names: tuple[str, ...],
    covariance: np.ndarray,
    converged: bool,
    misfit: tuple[float, float],
    means: np.ndarray,
    left_out: tuple[str, ...],
    swing: float,
    lasts: float,
    filled: float,
    followed: bool,
) -> tuple[str, ...]:
    """Sentences on a fit.

    Arguments:
        wind: at its end.
        names: of the free numbers.
        covariance: of their logarithms, and of angles.
        converged: whether it ended at a maximum.
        misfit: of the spectra, and its standard error.
        means: recorded, fitted and standard error, shape (3, channel).
        left_out: channels.
        swing: largest deviation of a joint, rad.
        lasts: the record, s.
        filled: share of empty cells.
        followed: whether the means counted.
    """
    notes = []
    errors = np.sqrt(np.diag(covariance))
    if not converged:
        notes.append(
            "the fit did not end at a maximum, and its standard errors mean little: begin nearer "
            "to the truth, or hold more"
        )
    for name, error in zip(names, errors, strict=True):
        if error > OPEN:
            notes.append(f"{name} is not determined: hold it, or record longer or more links")
    for one, other in itertools.combinations(range(len(names)), 2):
        together = covariance[one, other] / (errors[one] * errors[other])
        if abs(together) > _TOGETHER:
            sign = np.sign(together)
            left = covariance[one, one] + covariance[other, other]
            known = np.sqrt(max(left - 2 * sign * covariance[one, other], 0.0))
            what = "ratio" if sign > 0 else "product"
            notes.append(
                f"{names[one]} and {names[other]} trade off (correlation {together:.2f}): their "
                f"{what} is known to {known:.1%}"
            )
    if abs(misfit[0] - 1) > _OFF * misfit[1]:
        much = "larger" if misfit[0] > 1 else "smaller"
        notes.append(
            f"the spectra are {misfit[0]:.2f} times what is expected, {much} than chance: another "
            "arm, noise or wind than assumed, and standard errors that do not know of it"
        )
    if followed:
        off = np.abs(means[0] - means[1]) / means[2]
        if np.max(off) > _ASIDE:
            notes.append(
                f"the mean of a channel is {np.max(off):.0f} standard errors off: the wind comes "
                "from elsewhere, or the arm rests elsewhere without it than its model; free the "
                "direction, or leave the means out"
            )
    else:
        notes.append(
            "the resting position was not used, so that the mean flow is known from how quickly "
            "gusts pass alone"
        )
    gusts = lasts * wind.speed / wind.length_scale
    if gusts < _GUSTS:
        notes.append(
            f"the record is {gusts:.0f} times as long as a gust, and standard errors are rough "
            f"with less than {_GUSTS}"
        )
    if swing > _SWINGS:
        notes.append(
            f"a joint swings by {np.rad2deg(swing):.0f} deg, and its response is not linear"
        )
    if left_out:
        notes.append(f"left out because they bend more than they move: {', '.join(left_out)}")
    if filled:
        notes.append(f"{filled:.1%} of the cells were empty and are filled by straight lines")
    return tuple(notes)
