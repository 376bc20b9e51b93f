"""Least squares over chosen parameters of any model that predicts channels."""

from ._beginning import Beginning as Beginning, between as between
from ._budget import Budget as Budget
from ._conclude import versions as versions
from ._configuration import Setup as Setup, set_up as set_up
from ._density import (
    Density as Density,
    density_of as density_of,
    energy_at as energy_at,
)
from ._equations import CellEquations as CellEquations, Equations as Equations
from ._estimates import student_reach as student_reach
from ._findings import Finding as Finding
from ._fit import MAX_ITERATIONS as MAX_ITERATIONS, fit as fit, solve as solve
from ._hold_out import not_judged as not_judged, with_held_out as with_held_out
from ._integration import IntegrationFit as IntegrationFit
from ._jacobian import BlockJacobian as BlockJacobian
from ._loss import rho as rho, scores as scores
from ._noise import NOISE_MODELS as NOISE_MODELS, NoiseModel as NoiseModel
from ._of_runs import layout_of as layout_of, matching_runs as matching_runs
from ._optimum import Optimum as Optimum, Point as Point
from ._optimum_of import optimum as optimum
from ._predict import (
    errors_of as errors_of,
    predict as predict,
    prediction_errors as prediction_errors,
)
from ._prepared import prepared_with as prepared_with
from ._priors import (
    checked_priors as checked_priors,
    prior_of as prior_of,
    prior_row as prior_row,
)
from ._recorded import Recorded as Recorded
from ._records import (
    Correlation as Correlation,
    Estimate as Estimate,
    GradientCheck as GradientCheck,
    Iteration as Iteration,
    NoiseFit as NoiseFit,
    Seconds as Seconds,
    Shift as Shift,
    Start as Start,
    ToleranceEffect as ToleranceEffect,
)
from ._refit import Refit as Refit
from ._responses import (
    Direction as Direction,
    Response as Response,
    responses as responses,
)
from ._result import (
    FitResult as FitResult,
    load_result as load_result,
    parse_result as parse_result,
)
from ._run_records import (
    ChannelErrors as ChannelErrors,
    ChannelFit as ChannelFit,
    HeldChannel as HeldChannel,
    HeldOut as HeldOut,
    OwnEstimate as OwnEstimate,
    PredictionErrors as PredictionErrors,
    RunFit as RunFit,
)
from ._snapshot import FitJournal as FitJournal
from ._solver import Marquardt as Marquardt
from ._statistics import Statistics as Statistics
from ._suspect import (
    Suspect as Suspect,
    SuspectKind as SuspectKind,
    SystematicError as SystematicError,
)
from ._table import estimate_table as estimate_table
from ._ties import Tie as Tie, resolved_ties as resolved_ties, tied as tied
from ._units import (
    column_factors as column_factors,
    in_column_units as in_column_units,
    units_in_si as units_in_si,
    units_note as units_note,
)
