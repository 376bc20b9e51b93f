"""The arm as a model: from commands and wind to positions and joint angles."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._program import program
from .._typing import Array, Bool, Float, Scalar
from ..arm import Arm
from ..kinds import ArmSection, CommandSection, InitialSection, SensorsSection, WindSection
from ..parameters import declared, find, inline, parameter
from ..quantities import INITIAL
from ..runs import Channel, Definition, Run
from ..simulation import (
    SOLVERS,
    Signal,
    SimulationError,
    StepsFor,
    Trajectory,
    check_steps_for,
    check_wind,
    constant,
    integrate,
    is_disturbance,
    logged,
)
from ._arm_scene import arm_scene
from ._definition import (
    arm_from_definition,
    arm_to_definition,
    sensors_from_definition,
    sensors_to_definition,
)
from ._delays import Seen, seen_with_delays
from ._initial import initial_state
from ._protocol import AbstractModel, Channels, Integration
from ._scene import Scene
from ._sensors import CONDITIONS, Sensors

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

# What the camera records, and what the angle sensors do.
_POSITIONS = frozenset({"link_position", "tip_position"})
_ANGLES = frozenset({"joint_angle", "joint_rate", "link_angle"})


class InitialState(eqx.Module):
    """Joint angles and rates at the first sample; parameters of one run, if it says so."""

    angle: Float[Array, " joint"] = parameter(INITIAL.angle)
    rate: Float[Array, " joint"] = parameter(INITIAL.rate)


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
        sensors: what stands between the motion and its recording; exact by default.
        steps_for: what the integrator's steps are short enough for; see `giajax.simulate`.
    """

    kind: ClassVar[str] = "arm"

    arm: Arm = inline()
    tolerance: Scalar = eqx.field(
        default=_TOLERANCE, converter=lambda x: jnp.asarray(x, dtype=jnp.result_type(float))
    )
    solver: str = eqx.field(default="tsit5", static=True)
    max_steps: int = eqx.field(default=_MAX_STEPS, static=True)
    sensors: Sensors = inline(default_factory=Sensors)
    steps_for: StepsFor = eqx.field(default="motion", static=True)

    def __check_init__(self) -> None:
        check_steps_for(self.steps_for)
        if self.solver not in SOLVERS:
            raise InputError(
                f"there is no solver '{self.solver}'; use one of: {', '.join(SOLVERS)}"
            )
        self.sensors.check(self.arm.count)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """The arm and the sensors that the sidecars state, which must agree.

        Raises:
            InputError: the sidecars disagree in [arm] or [sensors].
        """
        first, *others = runs
        arm = arm_from_definition(first.definition)
        sensors = sensors_from_definition(first.definition)
        sections = [first.definition.section(of) for of in (ArmSection, SensorsSection)]
        for other in others:
            if [other.definition.section(type(of)) for of in sections] == sections:
                continue
            their_arm = arm_from_definition(other.definition)
            their_sensors = sensors_from_definition(other.definition)
            for section, ours, theirs in (
                ("arm", arm_to_definition(arm), arm_to_definition(their_arm)),
                ("sensors", sensors_to_definition(sensors), sensors_to_definition(their_sensors)),
            ):
                _check_agreement(section, (first, ours), (other, theirs))
        durations = [float(np.ptp(run.times)) for run in runs if run.times is not None]
        return cls(arm, max_steps=step_limit(max(durations, default=0.0)), sensors=sensors)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """The arm, its sensors and the settings of the integrator that `definition()` gave."""
        sections = {key: definition[key] for key in ("arm", "sensors") if key in definition}
        stated = Definition.parse(sections, "stored result")
        return cls(
            arm_from_definition(stated),
            sensors=sensors_from_definition(stated),
            **definition["simulation"],
        )

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """The initial state, where the run says `[initial] free = true`."""
        free = run.definition.section(InitialSection).free
        return ("initial.angle", "initial.rate") if free else ()

    def initial_section(self, inputs: ArmInputs) -> dict[str, Any]:
        """Angles and rates at the first sample, as the arm has them: without the sensors."""
        first = inputs.initial
        return {
            "angle_deg": np.rad2deg(np.asarray(first.angle)).tolist(),
            "rate_deg_per_s": np.rad2deg(np.asarray(first.rate)).tolist(),
        }

    def scene(self, run: Run) -> Scene:
        """The links, their markers and the tip, in the frame of the base."""
        motion = _trajectory(self, self.prepare(run))
        if not motion.successful:
            raise SimulationError(motion.message)
        return arm_scene(motion, self.sensors.marker)

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
            initial=self._initial(run, run.times),
        )

    def _initial(self, run: Run, times: np.ndarray) -> InitialState:
        """The state at the first sample; a first row was seen by the angle sensors."""
        angle, rate = map(jnp.asarray, initial_state(run, times, self.arm.count))
        if run.definition.section(InitialSection).first_row:
            encoder = self.sensors.encoder
            angle, rate = encoder.true_angles(angle), encoder.true_rates(rate)
        return InitialState(angle, rate)

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
        return logged(times, values, run.definition.section(CommandSection).interpolation)

    def trajectory(self, inputs: ArmInputs) -> Trajectory:
        """Motion of the arm at the samples of a prepared run, as it is: without sensors."""
        return self._motion(inputs, inputs.times, inputs.times[-1])

    def _motion(self, inputs: ArmInputs, times: Array, end: Array) -> Trajectory:
        # Below this a step is all rounding, which matters in 32-bit.
        tolerance = jnp.maximum(self.tolerance, 50 * jnp.finfo(self.tolerance.dtype).eps)
        return integrate(
            self.arm,
            inputs.command,
            times,
            inputs.wind,
            inputs.torque,
            jnp.stack([inputs.initial.angle, inputs.initial.rate]),
            (tolerance, tolerance),
            solver=self.solver,
            max_steps=self.max_steps,
            derivatives="forward",
            steps_for=self.steps_for,
            span=(inputs.times[0], end),
        )

    def predict(
        self, inputs: ArmInputs, channels: tuple[str, ...]
    ) -> tuple[Channels, Bool[Array, ""]]:
        """Predicted channels (m, rad, rad/s) as the sensors show them, each (sample,)."""
        known = [Channel.named(name) for name in channels]
        kinds = {channel.kind for channel in known}
        camera, encoder, successful = self._seen(inputs, kinds)
        sensors = self.sensors
        tables: dict[str, Array] = {}
        if kinds & {"joint_angle", "link_angle"}:
            tables["joint_angle"] = sensors.encoder.shows(encoder.angles)
            tables["link_angle"] = jnp.cumsum(tables["joint_angle"], axis=1)
        if "joint_rate" in kinds:
            tables["joint_rate"] = sensors.encoder.shows_rates(encoder.rates)
        # Positions of all links are computed only where a channel asks for one.
        if "link_position" in kinds:
            tables["link_position"] = sensors.link_positions(self.arm, camera.angles)
        if "tip_position" in kinds:
            tables["tip_position"] = sensors.tip_positions(self.arm, camera.angles)[:, None]
        predicted = {}
        for channel in known:
            column = tables[channel.kind][:, (channel.index or 1) - 1]
            predicted[channel.name] = (
                column if channel.component is None else column[:, channel.component]
            )
        return predicted, successful

    def _seen(self, inputs: ArmInputs, kinds: set[str]) -> tuple[Seen, Seen, Bool[Array, ""]]:
        """What camera and angle sensors see; a clock that no channel needs costs nothing."""
        camera = self.sensors.camera.delay if kinds & _POSITIONS else None
        encoder = self.sensors.encoder.delay if kinds & _ANGLES else None
        if camera is None and encoder is None:
            motion = self.trajectory(inputs)
            seen = Seen(motion.angles, motion.rates)
            return seen, seen, motion.successful
        clocks = [
            delay
            for delay, asked in ((camera, kinds & _POSITIONS), (encoder, kinds & _ANGLES))
            if asked
        ]
        clocks_seen, successful = seen_with_delays(
            lambda times, end: self._motion(inputs, times, end), inputs.times, clocks
        )
        return clocks_seen[0], clocks_seen[-1], successful

    def refined(self, factor: float) -> Self:
        """The same model with the integrator's tolerances multiplied by a factor."""
        return eqx.tree_at(lambda model: model.tolerance, self, self.tolerance * factor)

    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """With the steps that a parameter needs which may set moving what is at rest."""
        if not any(path.startswith("initial.") or is_disturbance(path) for path in paths):
            return self
        return dataclasses.replace(self, steps_for="derivatives")

    def integration(self) -> Integration:
        """Its solver, and the relative and absolute tolerance."""
        return Integration(self.solver, float(self.tolerance))

    def with_integration(self, *, solver: str | None, tolerance: float | None) -> Self:
        """The same arm with another solver or tolerance."""
        if tolerance is not None and not 0 < tolerance < np.inf:
            raise InputError(
                f"the tolerance is {tolerance:g}, and must be positive: give a number such as "
                f"{_TOLERANCE:g}"
            )
        model = self if solver is None else dataclasses.replace(self, solver=solver)
        if tolerance is None:
            return model
        return dataclasses.replace(model, tolerance=jnp.asarray(tolerance))

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        """The scale that motion alone cannot determine, and what C_D and sensors refer to."""
        return self._scale(free, runs) + self._sensor_conditions(free, runs)

    def _scale(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        fitted = {path.partition("[")[0] for path in free}
        scaled = [path for path in free if path.partition("[")[0] in _SCALE]
        # A known force sets the scale: a drive's torque, the lift of displaced air, or the push of
        # a changing wind on it.
        driven = any(c.kind == "joint_torque" for run in runs for c in run.channels.values())
        lifted = self.arm.buoyancy is not None and float(self.arm.gravity) != 0
        blown = self.arm.air.added_mass_coefficient is not None and any(run.winds for run in runs)
        sentences = []
        if scaled and not (driven or lifted or blown):
            present = declared(self)
            held = [path for path in _SCALE if path in present and path not in fitted]
            sentences.append(
                f"{', '.join(scaled)}: determined only per unit of mass, because scaling masses, "
                "inertias, drag, stiffness and damping together leaves the motion unchanged; "
                + (f"held at {self._values(held)}" if held else "nothing of these is held")
            )
        area = [path for path in _DRAG_AREA if path not in fitted]
        if "air.drag_coefficient" in fitted and area:
            sentences.append(f"air.drag_coefficient: holds for {self._values(area)}")
        return sentences

    def _sensor_conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        fitted = {path.partition("[")[0] for path in free}
        sentences = [f"{path}: {said}" for path, said in CONDITIONS.items() if path in fitted]
        encoder = sorted(fitted & {"encoder.offset", "encoder.scale"})
        read = [run for run in runs if run.definition.section(InitialSection).first_row]
        if encoder and any(not run.definition.section(InitialSection).free for run in read):
            sentences.append(
                f"{', '.join(encoder)}: the state in the first row was read with the start value; "
                "say free = true in [initial] to fit that state too"
            )
        if "camera.scale" in fitted and "links.length" not in fitted:
            sentences.append(
                f"camera.scale: holds for {self._values(['links.length'])}, because a camera "
                "that shows everything larger looks like a longer arm"
            )
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
        """The arm's constants, its sensors and the settings of the integrator."""
        sensors = sensors_to_definition(self.sensors)
        return {
            "arm": arm_to_definition(self.arm),
            **({"sensors": sensors} if sensors else {}),
            "simulation": {
                "solver": self.solver,
                "tolerance": float(self.tolerance),
                "max_steps": self.max_steps,
            },
        }


@program
def _trajectory(model: ArmModel, inputs: ArmInputs) -> Trajectory:
    return model.trajectory(inputs)


def _wind(run: Run, times: np.ndarray) -> Signal | None:
    stated = run.definition.section(WindSection)
    if stated.velocity_m_per_s is not None:
        return constant(stated.velocity_m_per_s)
    if not run.winds:
        return None
    velocity = np.zeros((len(times), 3))
    for name, values in run.winds.items():
        velocity[:, run.channels[name].component] = values
    return logged(times, velocity, stated.interpolation)


def _check_agreement(
    section: str, first: tuple[Run, dict[str, Any]], other: tuple[Run, dict[str, Any]]
) -> None:
    (one, ours), (two, theirs) = first, other
    for key in {**ours, **theirs}:
        if ours.get(key) != theirs.get(key):
            said = " and ".join(
                "nothing" if values.get(key) is None else str(values[key])
                for values in (ours, theirs)
            )
            raise InputError(
                f"the sidecars of '{one.name}' and '{two.name}' disagree in [{section}] "
                f"{key} ({said}); correct one, or fit the runs separately"
            )
