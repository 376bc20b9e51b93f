"""Mean flow and gusts, from the spectra of a resting arm."""

from ._fit import WindFit as WindFit, WindNumber as WindNumber, fit_wind as fit_wind
from ._model import USUALLY as USUALLY
from ._report import wind_figure as wind_figure, wind_json as wind_json
