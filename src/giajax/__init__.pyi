"""The public names, each once: what is imported here is what `giajax` offers."""

from . import (
    apps as apps,
    fitting as fitting,
    mechanics as mechanics,
    models as models,
    noise as noise,
    recordings as recordings,
    report as report,
    runtime as runtime,
    schema as schema,
    simulation as simulation,
    studies as studies,
    tasks as tasks,
)
from .apps.design import design_experiment as design_experiment
from .apps.filling import fill as fill
from .apps.synthetic import gusts as gusts, synthesise as synthesise, with_errors as with_errors
from .apps.tracking import Tracker as Tracker, track as track
from .apps.wind import fit_wind as fit_wind
from .fitting import (
    FitResult as FitResult,
    fit as fit,
    load_result as load_result,
    predict as predict,
)
from .mechanics.arm import (
    Arm as Arm,
    chain as chain,
    pendulum as pendulum,
    preset as preset,
    takeichi_20m as takeichi_20m,
    takeichi_20m_full as takeichi_20m_full,
)
from .models import (
    AbstractModel as AbstractModel,
    ArmModel as ArmModel,
    HysteresisModel as HysteresisModel,
    JointModel as JointModel,
    MuscleModel as MuscleModel,
    build_model as build_model,
    model_for as model_for,
)
from .recordings import (
    Definition as Definition,
    FitSettings as FitSettings,
    Run as Run,
    read_run as read_run,
    read_runs as read_runs,
    write_run as write_run,
)
from .report import (
    parameter_table as parameter_table,
    summary as summary,
    write_figures as write_figures,
    write_result as write_result,
)
from .runtime.parallel import map_on_cores as map_on_cores
from .runtime.plugins import register as register
from .runtime.text import InputError as InputError, __version__ as __version__
from .schema import Prior as Prior
from .schema.parameters import declared as declared, get as get, replace as replace
from .simulation import (
    SimulationError as SimulationError,
    Trajectory as Trajectory,
    joint_ramps as joint_ramps,
    joint_steps as joint_steps,
    simulate as simulate,
)
from .studies import (
    bootstrap as bootstrap,
    compare as compare,
    influence as influence,
    ladder as ladder,
    multi_start as multi_start,
    posterior as posterior,
    profile as profile,
    sensitivity as sensitivity,
    suspects as suspects,
    systematic_errors as systematic_errors,
)
from .tasks import FitTask as FitTask, sweep as sweep
