"""A differentiable simulator of very long, very light, air-dominated robot arms.

The public names are imported from their rooms when they are first used, so that what needs no
JAX (reading runs, the command line's help) starts without it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._errors import InputError as InputError
    from .arm import (
        Arm as Arm,
        Buoyancy as Buoyancy,
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
        net_lift as net_lift,
        pendulum as pendulum,
        potential_energy as potential_energy,
        preset as preset,
        takeichi_20m as takeichi_20m,
        takeichi_20m_full as takeichi_20m_full,
        tip_position as tip_position,
        trimmed as trimmed,
    )
    from .fitting import (
        FitResult as FitResult,
        Marquardt as Marquardt,
        fit as fit,
        load_result as load_result,
        predict as predict,
        prediction_errors as prediction_errors,
    )
    from .joint import (
        BraidedMuscle as BraidedMuscle,
        Correction as Correction,
        EmpiricalMuscle as EmpiricalMuscle,
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
        JointModel as JointModel,
        MuscleModel as MuscleModel,
        arm_from_definition as arm_from_definition,
        build_model as build_model,
        model_for as model_for,
    )
    from .parameters import declared as declared, get as get, replace as replace
    from .runs import (
        Definition as Definition,
        Run as Run,
        read_run as read_run,
        write_run as write_run,
    )
    from .simulation import (
        RESULTS as RESULTS,
        SOLVERS as SOLVERS,
        Signal as Signal,
        SimulationError as SimulationError,
        Trajectory as Trajectory,
        joint_ramps as joint_ramps,
        joint_steps as joint_steps,
        logged as logged,
        simulate as simulate,
    )
    from .study import compare as compare, multi_start as multi_start
    from .synthetic import synthesise as synthesise
    from .tasks import FitTask as FitTask

_ROOMS = {
    "_errors": ("InputError",),
    "arm": (
        "Arm",
        "Buoyancy",
        "PointMasses",
        "acceleration",
        "chain",
        "cylinder_drag_coefficient",
        "damping_power",
        "drag_force",
        "drag_power",
        "forward_dynamics",
        "inverse_dynamics",
        "joint_torque",
        "kinetic_energy",
        "link_centres",
        "link_velocities",
        "mass_matrix",
        "net_lift",
        "pendulum",
        "potential_energy",
        "preset",
        "takeichi_20m",
        "takeichi_20m_full",
        "tip_position",
        "trimmed",
    ),
    "fitting": ("FitResult", "Marquardt", "fit", "load_result", "predict", "prediction_errors"),
    "joint": (
        "BraidedMuscle",
        "Correction",
        "EmpiricalMuscle",
        "Joint",
        "JointGeometry",
        "JointPair",
        "Piston",
        "branch_angles",
        "equilibria",
        "joint_spring",
        "muscle_force",
        "muscle_path",
        "muscle_pressure",
        "muscle_state",
        "pair_command",
    ),
    "models": (
        "AbstractModel",
        "ArmModel",
        "JointModel",
        "MuscleModel",
        "arm_from_definition",
        "build_model",
        "model_for",
    ),
    "parameters": ("declared", "get", "replace"),
    "runs": ("Definition", "Run", "read_run", "write_run"),
    "simulation": (
        "RESULTS",
        "SOLVERS",
        "Signal",
        "SimulationError",
        "Trajectory",
        "joint_ramps",
        "joint_steps",
        "logged",
        "simulate",
    ),
    "study": ("compare", "multi_start"),
    "synthetic": ("synthesise",),
    "tasks": ("FitTask",),
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("giajax")
    if name not in _HOME:
        raise AttributeError(f"module 'giajax' has no attribute '{name}'")
    value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
