"""Estimate of the mean flow and the gusts from the spectra of an arm at rest."""

from ._fit import WindFit as WindFit, WindNumber as WindNumber, fit_wind as fit_wind
from ._model import (
    USUALLY as USUALLY,
    Expected as Expected,
    Recorded as Recorded,
    WindModel as WindModel,
    first_guess as first_guess,
    gradient_and_information as gradient_and_information,
    log_likelihood as log_likelihood,
    slopes as slopes,
)
from ._record import TAPERS as TAPERS, bands as bands, resting as resting, tapered as tapered
from ._report import wind_figure as wind_figure, wind_json as wind_json
from ._response import Turbulence as Turbulence, joint_responses as joint_responses
