"""Model of the arm: from commands and wind to positions and joint angles."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ..mechanics.arm import Arm
from ..recordings import Channel, Definition, Run
from ..runtime.arrays import Array, Float, Scalar, larger, on_device
from ..runtime.programs import program
from ..runtime.solvers import as_text, from_text
from ..runtime.text import InputError
from ..schema import (
    CAMERA,
    INITIAL,
    JOINT_MEMORY,
    JOINTS,
    LINKS,
    CommandSection,
    InitialSection,
    Prior,
    WindSection,
)
from ..schema.parameters import inline, parameter, replace
from ..simulation import (
    Pressures,
    Signal,
    SimulationError,
    Solver,
    StepsFor,
    Trajectory,
    check_method,
    check_muscles,
    check_steps_for,
    check_wind,
    constant,
    integrate,
    is_disturbance,
    logged,
    solver as solver_named,
)
from ._arm_conditions import (
    arm_variants,
    clock_conditions,
    controller_conditions,
    preset_conditions,
    scale_conditions,
    sensor_conditions,
    usual_uncertainty,
)
from ._arm_definition import (
    SECTIONS,
    agreed_parts,
    arm_from_definition,
    arm_to_definition,
    sensors_from_definition,
    sensors_to_definition,
)
from ._arm_sensors import (
    Encoder,
    Sensors,
    behind_conditions,
    check_sensor,
    own_sensors,
    recorded_channels,
    unseen_channels,
)
from ._protocol import AbstractModel, Prediction, Scene
from ._scenes import arm_scene
from .capabilities import Integration

if TYPE_CHECKING:
    import diffrax

Row = Float[np.ndarray, " joint"]

# Number of rows for the estimate of a rate that is not recorded: enough to average noise, and few
# enough for the motion to be approximately linear in time.
_ROWS = 8


def initial_state(run: Run, times: np.ndarray, joints: int) -> tuple[Row, Row]:
    """Return joint angles (rad) and rates (rad/s) from `[initial]`; zero if they are not given.

    Raises:
        InputError: a list has the wrong length, or the data that `first_row` requires are missing.
    """
    section = run.definition.section(InitialSection)
    if not section.first_row:
        stated = section.values()
        state = []
        for declared in (INITIAL.angle, INITIAL.rate):
            values = np.asarray(stated.get(declared.path, declared.default), dtype=float)
            if values.shape not in ((), (joints,)):
                raise InputError(
                    f"[initial] of '{run.name}' has {values.size} values for {joints} joints: "
                    "give one number or one for each joint"
                )
            state.append(np.broadcast_to(values, (joints,)))
        return state[0], state[1]
    angles, rates = np.zeros(joints), np.zeros(joints)
    recorded = True
    for joint in range(joints):
        name = f"joint{joint + 1:02d}"
        angle, rate = (
            np.full(len(times), np.nan) if column is None else column
            for column in (run.values.get(f"{name}_{kind}") for kind in ("angle", "rate"))
        )
        measured = np.isfinite(angle[:_ROWS])
        line = np.zeros(2)
        if np.sum(measured) >= 2:
            since = times[:_ROWS][measured] - times[0]
            line = np.polyfit(since, angle[:_ROWS][measured], 1)
        if np.isfinite(angle[0]):
            angles[joint] = angle[0]
        elif section.free:
            angles[joint] = line[1] if np.sum(measured) >= 2 else _swung(times, rate)
        else:
            raise InputError(
                f"[initial] of '{run.name}' sets first_row = true, but {name}_angle has no value "
                "in the first row: record the angle of every joint, set angle_deg, or let the fit "
                "estimate the initial state with free = true"
            )
        recorded = recorded and bool(np.isfinite(rate[0]))
        rates[joint] = rate[0] if np.isfinite(rate[0]) else line[0]
    if not (recorded or section.free):
        raise InputError(
            f"[initial] of '{run.name}' sets first_row = true, but the rate of a joint has no "
            "value in the first row: record the rates, or let the fit estimate them with free = "
            "true"
        )
    return angles, rates


def _swung(times: np.ndarray, rate: np.ndarray) -> float:
    """Estimate the initial angle of a joint that oscillates about 0 from its rates alone."""
    known = np.isfinite(rate)
    if np.sum(known) < 2:
        return 0.0
    rate, steps = rate[known], np.diff(times[known])
    turned = np.concatenate([[0.0], np.cumsum(steps * (rate[1:] + rate[:-1]) / 2)])
    return -float(np.mean(turned))


class InitialState(eqx.Module):
    """Joint angles and rates at the first sample; parameters of a run if it frees them."""

    angle: Float[Array, " joint"] = parameter(INITIAL.angle)
    rate: Float[Array, " joint"] = parameter(INITIAL.rate)


class ArmInputs(eqx.Module):
    """Inputs of the arm in a run: times, command, wind, drive torque, initial state, pressures."""

    times: Float[Array, " sample"]
    command: Signal
    wind: Signal | None
    torque: Signal | None
    initial: InitialState
    pressure: Pressures | None = None
    # Registered sensors are looked up during tracing, so they are part of the key of a program.
    own_sensors: tuple[type, ...] = eqx.field(static=True, default_factory=own_sensors)


def arm_inputs(arm: Arm, encoder: Encoder, run: Run) -> ArmInputs:
    """Prepare a run for an arm; with `first_row`, the initial state is corrected by the encoder.

    Raises:
        InputError: the run belongs to another model, has another number of joints, or its wind or
            initial state is not possible for the arm.
    """
    if run.model != "arm" or run.times is None:
        raise InputError(
            f"'{run.name}' is a run of the {run.model} model: give a run of the arm model"
        )
    times = run.times
    wind = wind_of(arm, run)
    check_wind(arm, wind)
    driven = any(run.channels[name].kind == "joint_torque" for name in run.commands)
    interpolation = run.definition.section(CommandSection).interpolation
    command = logged(times, _table(arm, run, times, "joint_command"), interpolation)
    pressure = _pressures(arm, run, times)
    check_muscles(arm, command, pressure)
    torque = _table(arm, run, times, "joint_torque")
    angle, rate = map(on_device, initial_state(run, times, arm.count))
    if run.definition.section(InitialSection).first_row:
        angle, rate = encoder.true_angles(angle), encoder.true_rates(rate)
    return ArmInputs(
        times=on_device(times, jnp.result_type(float)),
        command=command,
        wind=wind,
        torque=logged(times, torque, interpolation) if driven else None,
        initial=InitialState(angle, rate),
        pressure=pressure,
    )


def _pressures(arm: Arm, run: Run, times: np.ndarray) -> Pressures | None:
    """Return the pressures of the joints that have pressure columns, or None."""
    kinds = ("joint_pressure_first", "joint_pressure_second")
    numbers = {
        run.channels[name].index for name in run.commands if run.channels[name].kind in kinds
    }
    if not numbers:
        return None
    values = np.concatenate([_table(arm, run, times, kind) for kind in kinds], axis=1)
    interpolation = run.definition.section(CommandSection).interpolation
    joints = tuple(sorted(number for number in numbers if number is not None))
    return Pressures(logged(times, values, interpolation), joints)


def _table(arm: Arm, run: Run, times: np.ndarray, kind: str) -> np.ndarray:
    """Return commands, torques or pressures of all joints, with zeros for missing columns."""
    values = np.zeros((len(times), arm.count))
    for name, column in run.commands.items():
        if run.channels[name].kind != kind:
            continue
        joint = run.channels[name].index or 0
        if joint > arm.count:
            raise InputError(
                f"'{run.name}' drives joint {joint}, but the arm has only {arm.count} joints: "
                "remove the column, or give an arm with more links"
            )
        values[:, joint - 1] = column
    return values


def wind_of(arm: Arm, run: Run) -> Signal | None:
    """Return the wind of a run, m/s, for the arm or for each link; None if it has none.

    A link without wind columns has the wind of the arm.

    Raises:
        InputError: the wind of a link is given that the arm does not have.
    """
    section = run.definition.section(WindSection)
    if section.velocity_m_per_s is not None:
        return constant(section.velocity_m_per_s)
    if not run.winds:
        return None
    times = run.times
    assert times is not None
    velocity = np.zeros((len(times), arm.count, 3))
    each = False
    for own in (False, True):
        for name, values in run.winds.items():
            channel = run.channels[name]
            if (channel.index or 0) > arm.count:
                raise InputError(
                    f"'{run.name}' has a wind column for link {channel.index}, but the arm has "
                    f"only {arm.count} links: remove the column, or give an arm with more links"
                )
            if (channel.index is not None) == own:
                places = slice(None) if channel.index is None else channel.index - 1
                velocity[:, places, channel.component] = values if own else values[:, None]
                each = each or own
    rows = velocity.reshape(len(times), -1) if each else velocity[:, 0]
    return logged(times, rows, section.interpolation)


# Default for a prediction. With it, positions of the 20 m arm are accurate to about 1e-6 m, far
# below the noise of a camera.
_TOLERANCE = 1e-7

# Fifty times the number of steps that the arm in the paper takes for 25 s. A trial step of a fit
# that makes the chain stiffer is rejected after seconds instead of minutes. Longer runs get more.
_MAX_STEPS = 50_000
_STEPS_PER_SECOND = 2_000


def _array(value: Any) -> Any:
    # With a strong type, another tolerance does not cause a new compilation.
    return None if value is None else jnp.asarray(value, dtype=jnp.result_type(float))


def _method(solver: Solver) -> Solver:
    """Return a solver name unchanged, and construct the solver from a call as text."""
    return solver_named(solver) if "(" in str(solver) else solver


def _controller(given: Any) -> Any:
    if given is None:
        return None
    import diffrax

    if isinstance(given, diffrax.StepTo):
        raise InputError(
            "StepTo contains the step times of a single run: give an adaptive step size controller"
        )
    return from_text(given) if isinstance(given, str) else given


class ArmModel(AbstractModel):
    """Predicts the arm channels of the column table: links, tip, joint angles and rates.

    Arguments:
        arm: the arm; its parameters keep their own paths (`air.drag_coefficient`).
        tolerance: relative and absolute tolerance of the integrator. If it is None, a fit chooses
            it, and a prediction uses 1e-7.
        solver: integration method, as in `giajax.simulate`.
        stepsize_controller: adaptive step size controller, as in `giajax.simulate`; its tolerances
            are replaced by those of the model.
        max_steps: maximum number of steps of one simulation.
        sensors: sensors that record the motion; exact by default.
        steps_for: purpose for which the integrator's steps are short enough; see `giajax.simulate`.
    """

    kind: ClassVar[str] = "arm"

    arm: Arm = inline()
    tolerance: Scalar | None = eqx.field(default=None, converter=_array)
    # With springs5 the motion is a smooth function of the parameters. It is not with an explicit
    # method, whose steps are at the limit of stability if the springs are stiff.
    solver: Solver = eqx.field(default="springs5", static=True, converter=_method)
    max_steps: int = eqx.field(default=_MAX_STEPS, static=True)
    sensors: Sensors = inline(default_factory=Sensors)
    steps_for: StepsFor = eqx.field(default="motion", static=True)
    stepsize_controller: "diffrax.AbstractAdaptiveStepSizeController | None" = eqx.field(
        default=None, static=True, converter=_controller
    )

    def __check_init__(self) -> None:
        check_steps_for(self.steps_for)
        check_method(self.solver, self.stepsize_controller)
        self.sensors.check(self.arm.links.length.shape[0])

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """Return the model with the arm and sensors in the sidecars, which must agree.

        Raises:
            InputError: the sidecars disagree in [arm], [sensors], [camera] or [landmark].
        """
        arm, sensors = agreed_parts(runs)
        durations = [float(np.ptp(run.times)) for run in runs if run.times is not None]
        steps = int(np.ceil(_STEPS_PER_SECOND * max(durations, default=0.0)))
        return cls(arm, max_steps=max(_MAX_STEPS, steps), sensors=sensors)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """Return the model with the arm, sensors and integrator settings from `definition()`."""
        sections = {key: definition[key] for key in ("arm", *SECTIONS) if key in definition}
        stored = Definition.parse(sections, "stored result")
        return cls.stated_in(stored, **definition["simulation"])

    @classmethod
    def stated_in(cls, definition: Definition, **integration: Any) -> Self:
        """Return the model with the arm and the sensors that a definition gives."""
        arm = arm_from_definition(definition)
        return cls(arm, sensors=sensors_from_definition(definition), **integration)

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """Return the paths of the initial state if the run sets `[initial] free = true`."""
        free = run.definition.section(InitialSection).free
        return ("initial.angle", "initial.rate") if free else ()

    def initial_section(self, inputs: ArmInputs) -> dict[str, Any]:
        """Return the true angles and rates at the first sample, without the errors of sensors."""
        first = inputs.initial
        state = {INITIAL.angle.path: first.angle, INITIAL.rate.path: first.rate}
        return InitialSection.keys_of(state)

    def scene(self, run: Run) -> Scene:
        """Return the links, their markers and the tip in the base frame."""
        motion = _trajectory(self, self.prepare(run))
        if not motion.successful:
            raise SimulationError(motion.message)
        return arm_scene(motion, self.sensors.marker)

    def failure(self, inputs: ArmInputs) -> str:
        """Return the message of the simulation."""
        return self.trajectory(inputs).message

    def prepare(self, run: Run) -> ArmInputs:
        """Return sample times, command, wind and initial state of an arm run."""
        self.sensors.pictures(run.channels[name] for name in run.observations)
        for each in self.sensors.sensor.values():
            # Built-in sensors are tested in the test suite.
            if not type(each).__module__.startswith("giajax."):
                check_sensor(each, self.arm)
        return arm_inputs(self.arm, self.sensors.encoder, run)

    def trajectory(self, inputs: ArmInputs) -> Trajectory:
        """Simulate the true motion of the arm at the samples of a prepared run, without sensors."""
        return self._motion(inputs, inputs.times, inputs.times[-1])

    def _motion(self, inputs: ArmInputs, times: Array, end: Array) -> Trajectory:
        # Below this tolerance rounding errors dominate a step, which occurs in 32-bit arithmetic.
        tolerance = jnp.maximum(self._tolerance(), 50 * jnp.finfo(jnp.result_type(float)).eps)
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
            pressure=inputs.pressure,
            stepsize_controller=self.stepsize_controller,
        )

    def predict(self, inputs: ArmInputs, channels: tuple[str, ...]) -> Prediction:
        """Return predicted channels (SI) as recorded by the sensors, each of shape (sample,)."""
        return recorded_channels(
            self.sensors,
            lambda times, end: self._motion(inputs, times, end),
            inputs.times,
            channels,
        )

    def unseen(
        self, inputs: ArmInputs, channels: tuple[str, ...]
    ) -> dict[str, npt.NDArray[np.bool_]]:
        """Return the samples at which a point is behind its camera or outside the image."""
        return {name: outside for name, (_, outside) in self._unseen(inputs, channels).items()}

    def _unseen(
        self, inputs: ArmInputs, channels: Sequence[str]
    ) -> dict[str, tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]]:
        pixels = tuple(name for name in channels if Channel.named(name).quantity == "pixel")
        found: dict[str, Any] = _unseen(self, inputs, pixels) if pixels else {}
        return jax.tree.map(np.asarray, found)

    def refined(self, factor: float) -> Self:
        """Return the model with the tolerances of the integrator multiplied by a factor."""
        # Computed on the host, because JAX would compile a program for this product.
        return dataclasses.replace(self, tolerance=_array(float(self._tolerance()) * factor))

    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """Return the model with steps for derivatives if parameters can move an arm at rest."""
        necks = self.arm.pneumatics is not None and self.arm.pneumatics.neck.radius is not None
        held = [LINKS.pressure.path] if necks else []
        moving = [path for path in paths if path.startswith(("initial.", *held))]
        if not moving and not any(map(is_disturbance, paths)):
            return self
        return dataclasses.replace(self, steps_for="derivatives")

    def variants(self) -> dict[str, Self]:
        """Return variants of the model, such as another drag law, a floating arm, or a lag."""
        others = {
            name: dataclasses.replace(self, arm=arm) for name, arm in arm_variants(self.arm).items()
        }
        delay = self.sensors.camera.delay
        if delay is not None and self.arm.joints.drive_lag is None:
            # To first order both have the same effect, so derivatives cannot distinguish them.
            late = {CAMERA.delay.path: 0.0, JOINTS.drive_lag.path: larger(delay, 0)}
            others["joints.drive_lag = camera.delay, camera.delay = 0"] = replace(self, late)
        return others

    def scattering(self) -> tuple[str, ...]:
        """Return the stiffness factor and the initial memory, which may differ between joints."""
        alone = () if self.arm.pneumatics is not None else (JOINTS.stiffness_factor.path,)
        remembers = self.arm.joints.hysteresis.memory.strength is not None
        return (*alone, *([JOINT_MEMORY.initial.path] if remembers else []))

    def one_by_one(self) -> tuple[str, ...]:
        """Return the drive gain, because a single drive may not move."""
        return (JOINTS.drive_gain.path,)

    def rather(self) -> dict[str, str]:
        """Prefer a joint memory to friction, because the joints of inflated links have one."""
        memory = JOINT_MEMORY.strength.path
        names = [name for name in self.variants() if name.startswith(memory)]
        return {JOINTS.friction.path: names[0]} if names else {}

    def freed_with(self) -> dict[str, tuple[str, ...]]:
        """Free the yield angle with a memory, because it determines the width of the loop."""
        return {JOINT_MEMORY.strength.path: (JOINT_MEMORY.yield_angle.path,)}

    def uncertain(self, runs: Sequence[Run]) -> dict[str, Prior]:
        """Return priors for clock and scale of an uncalibrated camera, and for the diameter."""
        own = [run for run in runs if run.model == self.kind]
        return usual_uncertainty(self.arm, self.sensors, own) if own else {}

    def integration(self) -> Integration:
        """Return the solver and the tolerance, which is both relative and absolute."""
        return Integration(
            self.solver if isinstance(self.solver, str) else as_text(self.solver),
            None if self.tolerance is None else float(self.tolerance),
        )

    def with_integration(self, *, solver: str | None, tolerance: float | None) -> Self:
        """Return the same arm with another solver or tolerance."""
        if tolerance is not None and not 0 < tolerance < np.inf:
            raise InputError(
                f"the tolerance is {tolerance:g}, but must be positive: give a number such as "
                f"{_TOLERANCE:g}"
            )
        changes: dict[str, Any] = {"solver": solver, "tolerance": tolerance}
        return dataclasses.replace(self, **{k: v for k, v in changes.items() if v is not None})

    def _tolerance(self) -> Scalar:
        return _array(_TOLERANCE) if self.tolerance is None else self.tolerance

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        """Return the conditions on scale, clock, controller, sensors, preset and cameras."""
        sentences = scale_conditions(self, self.arm, free, runs)
        sentences += clock_conditions(self, self.arm, free, runs)
        sentences += controller_conditions(self.arm, free, runs)
        sentences += sensor_conditions(self, free, runs)
        own = [run for run in runs if run.model == self.kind]
        sentences += preset_conditions(self.arm, free, own)
        for run in runs:
            pixels = [name for name in run.observations if run.channels[name].quantity == "pixel"]
            if run.model == self.kind and pixels:
                sentences += behind_conditions(run, self._unseen(self.prepare(run), pixels))
        return sentences

    def definition(self) -> dict[str, Any]:
        """Return the constants of the arm, its sensors and the integrator settings."""
        integration, controller = self.integration(), {}
        if self.stepsize_controller is not None:
            controller = {"stepsize_controller": as_text(self.stepsize_controller)}
        return {
            "arm": arm_to_definition(self.arm),
            **sensors_to_definition(self.sensors),
            "simulation": {
                "solver": integration.solver,
                "tolerance": integration.tolerance,
                "max_steps": self.max_steps,
                **controller,
            },
        }


@program
def _unseen(model: ArmModel, inputs: ArmInputs, channels: tuple[str, ...]) -> dict[str, Any]:
    return unseen_channels(
        model.sensors, lambda times, end: model._motion(inputs, times, end), inputs.times, channels
    )


@program
def _trajectory(model: ArmModel, inputs: ArmInputs) -> Trajectory:
    return model.trajectory(inputs)
