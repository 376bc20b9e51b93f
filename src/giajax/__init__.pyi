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
from .apps.control import (
    Compensator as Compensator,
    compensator_for_loop as compensator_for_loop,
    compensator_for_model as compensator_for_model,
)
from .apps.design import Design as Design, Limits as Limits, design_experiment as design_experiment
from .apps.filling import (
    Filled as Filled,
    FillingCurve as FillingCurve,
    fill as fill,
    filling_curve as filling_curve,
)
from .apps.synthetic import (
    RecordingErrors as RecordingErrors,
    gusts as gusts,
    planned as planned,
    recorded_again as recorded_again,
    synthesise as synthesise,
    with_errors as with_errors,
)
from .apps.wind import WindFit as WindFit, fit_wind as fit_wind
from .fitting import (
    ChannelFit as ChannelFit,
    Estimate as Estimate,
    Finding as Finding,
    FitResult as FitResult,
    GradientCheck as GradientCheck,
    Marquardt as Marquardt,
    PredictionErrors as PredictionErrors,
    RunFit as RunFit,
    Suspect as Suspect,
    fit as fit,
    load_result as load_result,
    predict as predict,
    prediction_errors as prediction_errors,
)
from .mechanics.arm import (
    Air as Air,
    Arm as Arm,
    Buoyancy as Buoyancy,
    Joints as Joints,
    Links as Links,
    Pneumatics as Pneumatics,
    PointMasses as PointMasses,
    acceleration as acceleration,
    chain as chain,
    cylinder_drag_coefficient as cylinder_drag_coefficient,
    damping_power as damping_power,
    drag_force as drag_force,
    drag_power as drag_power,
    forward_dynamics as forward_dynamics,
    inverse_dynamics as inverse_dynamics,
    joint_torque as joint_torque,
    kinetic_energy as kinetic_energy,
    link_centres as link_centres,
    link_velocities as link_velocities,
    mass_matrix as mass_matrix,
    muscle_power as muscle_power,
    net_lift as net_lift,
    pendulum as pendulum,
    potential_energy as potential_energy,
    preset as preset,
    takeichi_20m as takeichi_20m,
    takeichi_20m_full as takeichi_20m_full,
    tip_position as tip_position,
    trimmed as trimmed,
)
from .mechanics.hysteresis import (
    BoucWen as BoucWen,
    BoucWenOscillator as BoucWenOscillator,
    ModifiedPrandtlIshlinskii as ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii as PrandtlIshlinskii,
    Preisach as Preisach,
)
from .mechanics.inflation import Filling as Filling
from .mechanics.joint import (
    BraidedMuscle as BraidedMuscle,
    Correction as Correction,
    EmpiricalMuscle as EmpiricalMuscle,
    Friction as Friction,
    Joint as Joint,
    JointGeometry as JointGeometry,
    JointPair as JointPair,
    Piston as Piston,
    branch_angles as branch_angles,
    equilibria as equilibria,
    joint_spring as joint_spring,
    muscle_force as muscle_force,
    muscle_path as muscle_path,
    muscle_pressure as muscle_pressure,
    muscle_state as muscle_state,
    pair_command as pair_command,
)
from .models import (
    AbstractModel as AbstractModel,
    ArmModel as ArmModel,
    HysteresisModel as HysteresisModel,
    JointModel as JointModel,
    MuscleModel as MuscleModel,
    OscillatorModel as OscillatorModel,
    Scene as Scene,
    Sensors as Sensors,
    SeveralModels as SeveralModels,
    arm_from_definition as arm_from_definition,
    arm_scene as arm_scene,
    build_model as build_model,
    joint_scene as joint_scene,
    model_for as model_for,
)
from .noise import Reason as Reason, Verdict as Verdict
from .recordings import (
    Definition as Definition,
    FitSettings as FitSettings,
    Run as Run,
    describe as describe,
    read_run as read_run,
    read_runs as read_runs,
    write_run as write_run,
)
from .report import (
    draw_scene as draw_scene,
    parameter_table as parameter_table,
    summary as summary,
    write_figures as write_figures,
    write_result as write_result,
)
from .runtime.parallel import map_on_cores as map_on_cores
from .runtime.plugins import register as register
from .runtime.text import InputError as InputError, __version__ as __version__
from .schema import KINDS as KINDS, Prior as Prior
from .schema.parameters import declared as declared, get as get, replace as replace
from .simulation import (
    RESULTS as RESULTS,
    SOLVERS as SOLVERS,
    Contacts as Contacts,
    Moment as Moment,
    Pressures as Pressures,
    Signal as Signal,
    SimulationError as SimulationError,
    Stepper as Stepper,
    Trajectory as Trajectory,
    contacts as contacts,
    joint_ramps as joint_ramps,
    joint_steps as joint_steps,
    logged as logged,
    simulate as simulate,
)
from .studies import (
    Bootstrap as Bootstrap,
    Comparison as Comparison,
    Influence as Influence,
    Posterior as Posterior,
    Profile as Profile,
    Profiles as Profiles,
    Sensitivity as Sensitivity,
    Suspects as Suspects,
    bootstrap as bootstrap,
    choose_hysteresis as choose_hysteresis,
    compare as compare,
    influence as influence,
    ladder as ladder,
    load_profiles as load_profiles,
    multi_start as multi_start,
    posterior as posterior,
    profile as profile,
    sensitivity as sensitivity,
    suspects as suspects,
    systematic_errors as systematic_errors,
)
from .tasks import FitTask as FitTask, sweep as sweep
