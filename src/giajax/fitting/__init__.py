"""Least squares over chosen parameters of any model that predicts channels."""

from ._configuration import Setup as Setup, set_up as set_up
from ._density import Density as Density, density_of as density_of, energy_at as energy_at
from ._derived import (
    Direction as Direction,
    Response as Response,
    column_factors as column_factors,
    in_column_units as in_column_units,
    responses as responses,
    units_in_si as units_in_si,
    units_note as units_note,
)
from ._descend import Budget as Budget
from ._estimates import Finding as Finding, student_reach as student_reach
from ._fit import (
    MAX_ITERATIONS as MAX_ITERATIONS,
    Refit as Refit,
    fit as fit,
    solve as solve,
    versions as versions,
)
from ._free import (
    Beginning as Beginning,
    Tie as Tie,
    between as between,
    resolved_ties as resolved_ties,
    tied as tied,
)
from ._hold_out import (
    HoldOut as HoldOut,
    PredictedChannel as PredictedChannel,
    PredictionTest as PredictionTest,
    set_up_with_hold_out as set_up_with_hold_out,
)
from ._linearise import BlockJacobian as BlockJacobian
from ._optimum import (
    CellEquations as CellEquations,
    Equations as Equations,
    Optimum as Optimum,
    Point as Point,
    optimum as optimum,
)
from ._problem import Recorded as Recorded, prepared_with as prepared_with
from ._records import (
    Correlation as Correlation,
    Estimate as Estimate,
    GradientCheck as GradientCheck,
    Iteration as Iteration,
    NoiseFit as NoiseFit,
    Seconds as Seconds,
    Shift as Shift,
    Start as Start,
    Suspect as Suspect,
    SuspectKind as SuspectKind,
    SystematicError as SystematicError,
    ToleranceEffect as ToleranceEffect,
    estimate_table as estimate_table,
)
from ._result import (
    FitResult as FitResult,
    IntegrationFit as IntegrationFit,
    errors_of as errors_of,
    load_result as load_result,
    parse_result as parse_result,
    predict as predict,
    prediction_errors as prediction_errors,
)
from ._run_records import (
    ChannelErrors as ChannelErrors,
    ChannelFit as ChannelFit,
    HeldChannel as HeldChannel,
    HeldOut as HeldOut,
    OwnEstimate as OwnEstimate,
    PredictionErrors as PredictionErrors,
    RunFit as RunFit,
    layout_of as layout_of,
    matching_runs as matching_runs,
)
from ._solver import Marquardt as Marquardt
from ._statistics import Statistics as Statistics
from ._transitions import FitJournal as FitJournal
from ._weights import (
    NOISE_MODELS as NOISE_MODELS,
    NoiseModel as NoiseModel,
    checked_priors as checked_priors,
    prior_of as prior_of,
    prior_row as prior_row,
    rho as rho,
    scores as scores,
)
