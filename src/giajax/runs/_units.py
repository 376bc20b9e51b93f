"""Conversion of columns to and from SI; the units themselves are in `giajax.quantities`."""

import numpy as np
import numpy.typing as npt

from ..quantities import (
    QUANTITIES as QUANTITIES,
    QUANTITY_OF_SUFFIX as QUANTITY_OF_SUFFIX,
    si_factor,
)


def to_si(quantity: str, suffix: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """`values` in the unit of `suffix`, any shape, as float64 in SI."""
    with np.errstate(over="ignore"):  # what is infinite then is refused as such
        return np.asarray(np.asarray(values, dtype=np.float64) * si_factor(quantity, suffix))


def from_si(quantity: str, suffix: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """`values` in SI, any shape, as float64 in the unit of `suffix`."""
    return np.asarray(np.asarray(values, dtype=np.float64) / si_factor(quantity, suffix))
