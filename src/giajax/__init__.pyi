"""The public names, each once: what is imported here is what `giajax` offers.

The file is longer than 200 lines because all public names are in one place.
"""

from . import (
    arm as arm,
    control as control,
    design as design,
    diagnosis as diagnosis,
    execution as execution,
    experiments as experiments,
    filling as filling,
    fitting as fitting,
    hysteresis as hysteresis,
    joint as joint,
    kinds as kinds,
    models as models,
    noise as noise,
    paper as paper,
    parameters as parameters,
    quantities as quantities,
    repetitions as repetitions,
    report as report,
    runs as runs,
    simulation as simulation,
    study as study,
    sweeping as sweeping,
    synthetic as synthetic,
    tasks as tasks,
    verdict as verdict,
    wind as wind,
)
from ._errors import InputError as InputError
from ._shares import map_on_cores as map_on_cores
from ._version import __version__ as __version__
from .arm import (
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
from .control import (
    Compensator as Compensator,
    compensator_for_loop as compensator_for_loop,
    compensator_for_model as compensator_for_model,
)
from .design import (
    Design as Design,
    Limits as Limits,
    design_experiment as design_experiment,
)
from .diagnosis import (
    Suspects as Suspects,
    ladder as ladder,
    suspects as suspects,
    systematic_errors as systematic_errors,
)
from .filling import (
    Filled as Filled,
    Filling as Filling,
    FillingCurve as FillingCurve,
    fill as fill,
    filling_curve as filling_curve,
)
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
from .hysteresis import (
    BoucWen as BoucWen,
    BoucWenOscillator as BoucWenOscillator,
    ModifiedPrandtlIshlinskii as ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii as PrandtlIshlinskii,
    Preisach as Preisach,
)
from .joint import (
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
from .kinds import KINDS as KINDS
from .models import (
    AbstractDirectModel as AbstractDirectModel,
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
from .parameters import declared as declared, get as get, replace as replace
from .quantities import Prior as Prior
from .repetitions import (
    Bootstrap as Bootstrap,
    Influence as Influence,
    bootstrap as bootstrap,
    influence as influence,
)
from .report import (
    draw_scene as draw_scene,
    parameter_table as parameter_table,
    summary as summary,
    write_figures as write_figures,
    write_result as write_result,
)
from .runs import (
    Definition as Definition,
    Run as Run,
    describe as describe,
    read_run as read_run,
    read_runs as read_runs,
    write_run as write_run,
)
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
from .study import (
    Comparison as Comparison,
    Posterior as Posterior,
    Profile as Profile,
    Profiles as Profiles,
    Sensitivity as Sensitivity,
    choose_hysteresis as choose_hysteresis,
    compare as compare,
    load_profiles as load_profiles,
    multi_start as multi_start,
    planned as planned,
    posterior as posterior,
    profile as profile,
    sensitivity as sensitivity,
)
from .sweeping import sweep as sweep
from .synthetic import (
    RecordingErrors as RecordingErrors,
    gusts as gusts,
    recorded_again as recorded_again,
    synthesise as synthesise,
    with_errors as with_errors,
)
from .tasks import FitTask as FitTask
from .verdict import Reason as Reason, Verdict as Verdict
from .wind import WindFit as WindFit, fit_wind as fit_wind
