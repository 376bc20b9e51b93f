"""Mean flow and gusts, from the spectra of a resting arm."""

from ._fit import fit_wind as fit_wind
from ._numbers import USUALLY as USUALLY
from ._result import WindFit as WindFit, WindNumber as WindNumber
