"""Least-squares estimation of selected parameters of any model that predicts channels."""

from typing import TYPE_CHECKING

from ..runtime.aliases import earlier as _earlier
from ._configuration import (
    Setup as Setup,
    Tie as Tie,
    WarmStart as WarmStart,
    between as between,
    resolved_ties as resolved_ties,
    set_up as set_up,
    tied as tied,
    within_bounds as within_bounds,
)
from ._coordinates import (
    Bijector as Bijector,
    Layout as Layout,
    members as members,
    sharing as sharing,
)
from ._density import (
    Density as Density,
    check_proper as check_proper,
    density_of as density_of,
    energy_at as energy_at,
)
from ._derived import (
    Direction as Direction,
    Response as Response,
    column_factors as column_factors,
    in_column_units as in_column_units,
    responses as responses,
    units_in_si as units_in_si,
    units_note as units_note,
)
from ._estimates import (
    Finding as Finding,
    odd_recordings as odd_recordings,
    student_reach as student_reach,
)
from ._fit import (
    Refit as Refit,
    check_effect as check_effect,
    fit as fit,
    solve as solve,
    versions as versions,
)
from ._hold_out import (
    HoldOut as HoldOut,
    PredictedChannel as PredictedChannel,
    PredictionTest as PredictionTest,
    set_up_with_hold_out as set_up_with_hold_out,
    state_at_end as state_at_end,
)
from ._linearise import (
    BlockJacobian as BlockJacobian,
    linearise as linearise,
    residuals as residuals,
)
from ._loop import Budget as Budget, descend as descend, stopped_by as stopped_by
from ._losses import (
    AbstractLoss as AbstractLoss,
    Huber as Huber,
    Linear as Linear,
    Scores as Scores,
    SoftL1 as SoftL1,
    StudentT as StudentT,
    check_loss as check_loss,
    loss_of as loss_of,
)
from ._nuisances import in_full as in_full
from ._optimum import (
    CellEquations as CellEquations,
    Equations as Equations,
    Optimum as Optimum,
    Point as Point,
    optimum as optimum,
)
from ._problem import (
    Problem as Problem,
    Recorded as Recorded,
    build_batches as build_batches,
    chunk_size as chunk_size,
    own_start as own_start,
    prepared_with as prepared_with,
    residual as residual,
)
from ._records import (
    ChannelErrors as ChannelErrors,
    ChannelFit as ChannelFit,
    Correlation as Correlation,
    Estimate as Estimate,
    GradientCheck as GradientCheck,
    HeldChannel as HeldChannel,
    HeldOut as HeldOut,
    Iteration as Iteration,
    NoiseFit as NoiseFit,
    OwnEstimate as OwnEstimate,
    PredictionErrors as PredictionErrors,
    RunFit as RunFit,
    Seconds as Seconds,
    Shift as Shift,
    Start as Start,
    Suspect as Suspect,
    SuspectKind as SuspectKind,
    SystematicError as SystematicError,
    ToleranceEffect as ToleranceEffect,
    estimate_table as estimate_table,
    layout_of as layout_of,
    matching_runs as matching_runs,
)
from ._result import (
    FitResult as FitResult,
    IntegrationFit as IntegrationFit,
    PredictedRun as PredictedRun,
    arm_model_of as arm_model_of,
    errors_of as errors_of,
    load_result as load_result,
    parse_result as parse_result,
    predict as predict,
    prediction_errors as prediction_errors,
)
from ._solver import Marquardt as Marquardt, boxed_step as boxed_step
from ._statistics import Statistics as Statistics, combinations as combinations
from ._steps import (
    FitJournal as FitJournal,
    begin as begin,
    evaluate as evaluate,
    residuals_at as residuals_at,
    step as step,
    trial as trial,
)
from ._uncertainty import (
    inverse_gram as inverse_gram,
    responds as responds,
    uncertainty as uncertainty,
    undetermined_groups as undetermined_groups,
)
from ._weights import (
    Noise as Noise,
    Whitening as Whitening,
    checked_priors as checked_priors,
    prior_of as prior_of,
    prior_row as prior_row,
)

# Type checkers should report missing names.
if not TYPE_CHECKING:
    __getattr__ = _earlier(__name__)
