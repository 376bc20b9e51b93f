"""The arm as a model: from commands and wind to positions and joint angles."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..arm import Arm
from ..parameters import declared, find, inline, parameter
from ..runs import Channel, Definition, Run
from ..simulation import SOLVERS, Signal, Trajectory, check_wind, constant, integrate, logged
from ._definition import arm_from_definition, arm_to_definition
from ._initial import initial_state
from ._protocol import AbstractModel, Channels

# Positions of the 20 m arm are then right to about 1e-6 m, far below the noise of a camera.
_TOLERANCE = 1e-7

# Fifty times what the paper's arm needs for 25 s. A trial step of a fit that makes the chain
# stiffer than that is given up, which costs seconds instead of minutes. Longer runs get more.
_MAX_STEPS = 50_000
_STEPS_PER_SECOND = 2_000


def step_limit(duration: float) -> int:
    """Step limit for runs of a duration (s)."""
    return max(_MAX_STEPS, int(np.ceil(_STEPS_PER_SECOND * duration)))


# Scaling all of these together leaves every motion unchanged: only ratios are determined.
_SCALE = (
    "links.mass",
    "links.inertia_transverse",
    "links.inertia_axial",
    "joints.pitch_stiffness",
    "joints.yaw_stiffness",
    "joints.damping",
    "joints.friction",
    "joints.armature",
    "air.drag_coefficient",
    "air.axial_coefficient",
    "air.added_mass_coefficient",
    "buoyancy.helium_density",
    "buoyancy.trim_mass",
    "buoyancy.imbalance",
    "point_masses.mass",
)

# C_D is referred to these (eq. 1).
_DRAG_AREA = ("air.density", "links.length", "links.diameter")


class InitialState(eqx.Module):
    """Joint angles and rates at the first sample; parameters of one run, if it says so."""

    angle: Float[Array, " joint"] = parameter(
        0.0, unit="rad", doc="joint angles at the first sample"
    )
    rate: Float[Array, " joint"] = parameter(
        0.0, unit="rad/s", doc="joint rates at the first sample"
    )


class ArmInputs(eqx.Module):
    """What the arm needs of a run: sample times, command, wind, drive torque, initial state."""

    times: Float[Array, " sample"]
    command: Signal
    wind: Signal | None
    torque: Signal | None
    initial: InitialState


class ArmModel(AbstractModel):
    """Predicts the arm channels of the column table: links, tip, joint angles and rates.

    Arguments:
        arm: the arm; its parameters keep their own paths (`air.drag_coefficient`).
        tolerance: relative and absolute tolerance of the integrator.
        solver: one of `giajax.SOLVERS`.
        max_steps: step limit of one simulation.
    """

    kind: ClassVar[str] = "arm"

    arm: Arm = inline()
    tolerance: Scalar = eqx.field(
        default=_TOLERANCE, converter=lambda x: jnp.asarray(x, dtype=jnp.result_type(float))
    )
    solver: str = eqx.field(default="tsit5", static=True)
    max_steps: int = eqx.field(default=_MAX_STEPS, static=True)

    def __check_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InputError(
                f"there is no solver '{self.solver}'; use one of: {', '.join(SOLVERS)}"
            )

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """The arm that the sidecars state, which must agree.

        Raises:
            InputError: the sidecars disagree in [arm].
        """
        first, *others = runs
        arm = arm_from_definition(first.definition)
        constants = arm_to_definition(arm)
        for other in others:
            theirs = arm_to_definition(arm_from_definition(other.definition))
            for key, value in constants.items():
                if theirs[key] != value:
                    raise InputError(
                        f"the sidecars of '{first.name}' and '{other.name}' disagree in [arm] "
                        f"{key} ({value} and {theirs[key]}); correct one, or fit the runs "
                        "separately"
                    )
        durations = [float(np.ptp(run.times)) for run in runs if run.times is not None]
        return cls(arm, max_steps=step_limit(max(durations, default=0.0)))

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """The arm and the settings of the integrator that `definition()` gave."""
        arm = arm_from_definition(Definition.parse({"arm": definition["arm"]}, "stored result"))
        return cls(arm, **definition["simulation"])

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """The initial state, where the run says `[initial] free = true`."""
        return ("initial.angle", "initial.rate") if run.definition.initial.free else ()

    def failure(self, inputs: ArmInputs) -> str:
        """What the simulation says."""
        return self.trajectory(inputs).message

    def prepare(self, run: Run) -> ArmInputs:
        """Sample times, command, wind and initial state of an arm run."""
        if run.model != self.kind or run.times is None:
            raise InputError(f"'{run.name}' is a run of the {run.model} model, not of an arm")
        wind = _wind(run, run.times)
        check_wind(self.arm, wind)
        driven = any(run.channels[name].kind == "joint_torque" for name in run.commands)
        return ArmInputs(
            times=jnp.asarray(run.times, dtype=jnp.result_type(float)),
            command=self._rows(run, run.times, "joint_command"),
            wind=wind,
            torque=self._rows(run, run.times, "joint_torque") if driven else None,
            initial=InitialState(*map(jnp.asarray, initial_state(run, run.times, self.arm.count))),
        )

    def _rows(self, run: Run, times: np.ndarray, kind: str) -> Signal:
        """Commands or torques of all joints; those without a column are zero."""
        values = np.zeros((len(times), self.arm.count))
        for name, column in run.commands.items():
            if run.channels[name].kind != kind:
                continue
            joint = run.channels[name].index or 0
            if joint > self.arm.count:
                raise InputError(
                    f"'{run.name}' drives joint {joint} of an arm of {self.arm.count} joints"
                )
            values[:, joint - 1] = column
        return logged(times, values, run.definition.command.interpolation)

    def trajectory(self, inputs: ArmInputs) -> Trajectory:
        """Motion of the arm in a prepared run."""
        # Below this a step is all rounding, which matters in 32-bit.
        tolerance = jnp.maximum(self.tolerance, 50 * jnp.finfo(self.tolerance.dtype).eps)
        return integrate(
            self.arm,
            inputs.command,
            inputs.times,
            inputs.wind,
            inputs.torque,
            jnp.stack([inputs.initial.angle, inputs.initial.rate]),
            (tolerance, tolerance),
            solver=self.solver,
            max_steps=self.max_steps,
            derivatives="forward",
        )

    def predict(
        self, inputs: ArmInputs, channels: tuple[str, ...]
    ) -> tuple[Channels, Bool[Array, ""]]:
        """Predicted channels (m, rad, rad/s), each of shape (sample,)."""
        motion = self.trajectory(inputs)
        known = [Channel.named(name) for name in channels]
        kinds = {channel.kind for channel in known}
        # Positions of all links are computed only where a channel asks for one.
        tables: dict[str, Array] = {"joint_angle": motion.angles, "joint_rate": motion.rates}
        if "link_angle" in kinds:
            tables["link_angle"] = jnp.cumsum(motion.angles, axis=1)
        if "link_position" in kinds:
            tables["link_position"] = motion.link_centres
        if "tip_position" in kinds:
            tables["tip_position"] = motion.tip[:, None]
        predicted = {}
        for channel in known:
            column = tables[channel.kind][:, (channel.index or 1) - 1]
            predicted[channel.name] = (
                column if channel.component is None else column[:, channel.component]
            )
        return predicted, motion.successful

    def refined(self, factor: float) -> Self:
        """The same model with the integrator's tolerances multiplied by a factor."""
        return eqx.tree_at(lambda model: model.tolerance, self, self.tolerance * factor)

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        """The scale that motion alone cannot determine, and what C_D is referred to."""
        fitted = {path.partition("[")[0] for path in free}
        scaled = [path for path in free if path.partition("[")[0] in _SCALE]
        # A known torque sets the scale.
        driven = any(c.kind == "joint_torque" for run in runs for c in run.channels.values())
        if not scaled or driven:
            return []
        present = declared(self)
        held = [path for path in _SCALE if path in present and path not in fitted]
        sentences = [
            f"{', '.join(scaled)}: determined only per unit of mass, because scaling masses, "
            "inertias, drag, stiffness and damping together leaves the motion unchanged; "
            + (f"held at {self._values(held)}" if held else "nothing of these is held")
        ]
        area = [path for path in _DRAG_AREA if path not in fitted]
        if "air.drag_coefficient" in fitted and area:
            sentences.append(f"air.drag_coefficient: holds for {self._values(area)}")
        return sentences

    def _values(self, paths: Sequence[str]) -> str:
        """Paths with their values; of an array that is not uniform, the range."""
        shown = []
        for path in paths:
            parameter = find(self, path)
            values, unit = np.atleast_1d(parameter.value(self)), parameter.declaration.unit
            low, high = float(values.min()), float(values.max())
            text = f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"
            shown.append(f"{path} = {text}{f' {unit}' if unit else ''}")
        return ", ".join(shown)

    def definition(self) -> dict[str, Any]:
        """The arm's constants and the settings of the integrator."""
        return {
            "arm": arm_to_definition(self.arm),
            "simulation": {
                "solver": self.solver,
                "tolerance": float(self.tolerance),
                "max_steps": self.max_steps,
            },
        }


def _wind(run: Run, times: np.ndarray) -> Signal | None:
    stated = run.definition.wind
    if stated.velocity_m_per_s is not None:
        return constant(stated.velocity_m_per_s)
    if not run.winds:
        return None
    velocity = np.zeros((len(times), 3))
    for name, values in run.winds.items():
        velocity[:, run.channels[name].component] = values
    return logged(times, velocity, stated.interpolation)
