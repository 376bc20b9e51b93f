"""Names of earlier versions, which continue to work with a warning until a given date.

`docs/migration.md` lists them. Modules that have moved are found through an entry of the path of
`giajax` that is not a folder, and their contents are looked up in their current modules.
"""

import importlib
import importlib.machinery
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, cast

UNTIL = "1 December 2027"
"""Date until which the earlier names work."""

MOVED: dict[str, tuple[str, ...]] = {
    "arm": ("mechanics.arm",),
    "control": ("apps.control",),
    "design": ("apps.design",),
    "diagnosis": ("studies",),
    "driving": ("apps.driving",),
    "execution": ("runtime.tasks", "runtime.execution"),
    "experiments": ("apps.experiments",),
    "filling": ("apps.filling", "mechanics.inflation"),
    "hysteresis": ("mechanics.hysteresis",),
    "joint": ("mechanics.joint",),
    "kinds": ("schema",),
    "mission": ("apps.mission",),
    "obstacles": ("mechanics.obstacles",),
    "paper": ("apps.paper",),
    "parameters": ("schema.parameters",),
    "quantities": ("schema",),
    "repetitions": ("studies",),
    "runs": ("recordings",),
    "study": ("studies",),
    "sweeping": ("tasks",),
    "synthetic": ("apps.synthetic",),
    "verdict": ("noise",),
    "viewer": ("apps.viewer",),
    "wind": ("apps.wind",),
}
"""Current location of the public names of each earlier module, within `giajax`."""

_REPORTS = {
    "apps.design": "DESIGN_HEADINGS design_figure design_json design_rows",
    "apps.filling": "CURVE_FILES FILLING_FILES curve_figure filling_figure filling_files "
    "filling_json",
    "apps.joint": "JOINT_FILES angle_figure angle_table correction_figure correction_table "
    "equilibria_figure equilibria_table joint_figure joint_files joint_points",
    "apps.mission": "CASES_FILES MISSION_FILES cases_files cases_json mission_figure mission_files "
    "mission_json",
    "apps.wind": "wind_figure wind_json",
}

# Former public names of `giajax` itself, by the package that contains them now.
_TO_ROOMS = {
    "apps.control": "Compensator compensator_for_loop compensator_for_model",
    "apps.design": "Design Limits",
    "apps.filling": "Filled FillingCurve filling_curve",
    "apps.synthetic": "RecordingErrors planned recorded_again",
    "apps.wind": "WindFit",
    "fitting": "ChannelFit Estimate Finding GradientCheck Marquardt PredictionErrors RunFit "
    "Suspect prediction_errors",
    "mechanics.arm": "Air Buoyancy Joints Links Pneumatics PointMasses acceleration "
    "cylinder_drag_coefficient damping_power drag_force drag_power forward_dynamics "
    "inverse_dynamics joint_torque kinetic_energy link_centres link_velocities mass_matrix "
    "muscle_power net_lift potential_energy tip_position trimmed",
    "mechanics.hysteresis": "BoucWen BoucWenOscillator ModifiedPrandtlIshlinskii "
    "PrandtlIshlinskii Preisach",
    "mechanics.inflation": "Filling",
    "mechanics.joint": "BraidedMuscle Correction EmpiricalMuscle Friction Joint JointGeometry "
    "JointPair Piston branch_angles equilibria joint_spring muscle_force muscle_path "
    "muscle_pressure muscle_state pair_command",
    "models": "OscillatorModel Scene Sensors SeveralModels arm_from_definition arm_scene "
    "joint_scene",
    "noise": "Reason Verdict",
    "recordings": "describe",
    "report": "draw_scene",
    "schema": "KINDS",
    "simulation": "RESULTS SOLVERS Contacts Moment Pressures Signal Stepper contacts logged",
    "studies": "Bootstrap Comparison Influence Posterior Profile Profiles Sensitivity Suspects "
    "choose_hysteresis load_profiles",
}


def _each(rooms: dict[str, str]) -> dict[str, str]:
    return {name: f"{room}.{name}" for room, names in rooms.items() for name in names.split()}


RENAMED: dict[str, dict[str, str]] = {
    "report": {
        **_each(_REPORTS),
        "ladder_table": "report.stepwise_table",
    },
    "fitting": {"Beginning": "fitting.WarmStart", "NoiseModel": "recordings.NoiseModel"},
    "": {**_each(_TO_ROOMS), "AbstractDirectModel": "models.AbstractModel"},
    "kinds": {
        "Content": "schema.RecordedRun",
        "Offer": "schema.SectionTemplate",
        "Wording": "schema.Naming",
    },
    "models": {"AbstractDirectModel": "models.AbstractModel"},
    "tasks": {"begun": "tasks.with_warm_start"},
    "diagnosis": {
        "Ladder": "studies.StepwiseSelection",
        "Rung": "studies.Step",
        "planned": "apps.synthetic.planned",
    },
    "studies": {"planned": "apps.synthetic.planned"},
    "runs": {
        "Fit": "recordings.FitSettings",
        "Parted": "recordings.SplitRun",
        "parted": "recordings.split_run",
    },
    "study": {
        "Valley": "studies.DistinctOptimum",
        "begun_as_fitted": "studies.with_fitted_state",
        "begun_where_it_ended": "studies.with_fitted_states",
        "valleys": "studies.distinct_optima",
    },
    "verdict": {"Foretold": "fitting.PredictedChannel", "Predictions": "fitting.PredictionTest"},
}
"""Current location of each public name, by its earlier package ("" for `giajax`)."""


def earlier(room: str, level: int = 3) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package for names that have moved or changed.

    `room` is the `__name__` of the package. `level` is the stack level of the warning, one more if
    another function calls this one.
    """
    names = RENAMED[room.partition(".")[2]]

    def get(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        where, _, now = names[name].rpartition(".")
        _warn(f"{room}.{name}", f"giajax.{where}.{now}", level)
        return getattr(importlib.import_module(f"giajax.{where}"), now)

    return get


_PLACE = str(Path(__file__).parent / "earlier modules")


def install(path: list[str]) -> None:
    """Make the earlier modules importable; called once with the path of the package `giajax`."""
    if _Finder not in sys.path_hooks:
        sys.path_hooks.append(_Finder)
    # The entry comes after the folder of the package. Files that an earlier version left in that
    # folder have no loader there and do not interfere.
    path.append(_PLACE)


class _Finder:  # not derived from importlib.abc, whose import takes a tenth of the time of `--help`
    """Finder and loader of the earlier modules, which look up names in the current modules."""

    def __init__(self, entry: str) -> None:
        if entry != _PLACE:
            raise ImportError("this is not the path of the earlier modules", path=entry)

    def find_spec(
        self, fullname: str, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        known = fullname.rpartition(".")[2] in MOVED
        return importlib.machinery.ModuleSpec(fullname, cast(Any, self)) if known else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> None:
        """Return None, for the default behaviour of Python."""

    def exec_module(self, module: ModuleType) -> None:
        package, _, name = module.__name__.rpartition(".")
        places = [f"{package}.{place}" for place in MOVED[name]]
        _warn(module.__name__, " and ".join(places), 3)

        renamed = earlier(module.__name__, 4) if name in RENAMED else None

        def get(attribute: str) -> Any:
            if renamed is not None and attribute in RENAMED[name]:
                return renamed(attribute)
            if not attribute.startswith("__"):
                for place in places:
                    room = importlib.import_module(place)
                    if hasattr(room, attribute):
                        return getattr(room, attribute)
            raise AttributeError(f"module {module.__name__!r} has no attribute {attribute!r}")

        vars(module)["__getattr__"] = get


def warn_of_name(before: str, now: str) -> None:
    """Warn that an attribute has a new name; called by the property with the earlier name."""
    _warn(before, now, 4)


def _warn(before: str, now: str, level: int) -> None:
    warnings.warn(
        f"{before} is now {now}: use the new name, because the old name works only until {UNTIL}",
        DeprecationWarning,
        stacklevel=level,
    )
