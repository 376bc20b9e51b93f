"""What the arm needs of a run: times, command, wind, drive torque and initial state."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._maths import on_device
from .._typing import Array, Float
from ..arm import Arm
from ..kinds import CommandSection, InitialSection, WindSection
from ..parameters import parameter
from ..quantities import INITIAL
from ..runs import Run
from ..simulation import Pressures, Signal, check_muscles, check_wind, constant, logged
from ._initial import initial_state
from ._sensors import Encoder


class InitialState(eqx.Module):
    """Joint angles and rates at the first sample; parameters of one run, if it says so."""

    angle: Float[Array, " joint"] = parameter(INITIAL.angle)
    rate: Float[Array, " joint"] = parameter(INITIAL.rate)


class ArmInputs(eqx.Module):
    """What the arm needs of a run: times, command, wind, drive torque, initial state, pressures."""

    times: Float[Array, " sample"]
    command: Signal
    wind: Signal | None
    torque: Signal | None
    initial: InitialState
    pressure: Pressures | None = None


def arm_inputs(arm: Arm, encoder: Encoder, run: Run) -> ArmInputs:
    """A run prepared for an arm.

    Arguments:
        arm: its number of joints counts, and whether it takes a wind that changes.
        encoder: the angle sensors, which saw the first row where the run starts from that.
        run: of the arm.

    Raises:
        InputError: a run of another model, of another number of joints, or whose wind or initial
            state the arm cannot have.
    """
    if run.model != "arm" or run.times is None:
        raise InputError(f"'{run.name}' is a run of the {run.model} model: give a run of an arm")
    wind = _wind(arm, run, run.times)
    check_wind(arm, wind)
    driven = any(run.channels[name].kind == "joint_torque" for name in run.commands)
    command, pressure = _rows(arm, run, run.times, "joint_command"), _pressures(arm, run, run.times)
    check_muscles(arm, command, pressure)
    return ArmInputs(
        times=on_device(run.times, jnp.result_type(float)),
        command=command,
        wind=wind,
        torque=_rows(arm, run, run.times, "joint_torque") if driven else None,
        initial=_initial(arm, encoder, run, run.times),
        pressure=pressure,
    )


def _initial(arm: Arm, encoder: Encoder, run: Run, times: np.ndarray) -> InitialState:
    """The state at the first sample; a first row was seen by the angle sensors."""
    angle, rate = map(on_device, initial_state(run, times, arm.count))
    if run.definition.section(InitialSection).first_row:
        angle, rate = encoder.true_angles(angle), encoder.true_rates(rate)
    return InitialState(angle, rate)


def _rows(arm: Arm, run: Run, times: np.ndarray, kind: str) -> Signal:
    """Commands or torques of all joints; those without a column are zero."""
    values = _table(arm, run, times, kind)
    return logged(times, values, run.definition.section(CommandSection).interpolation)


def _pressures(arm: Arm, run: Run, times: np.ndarray) -> Pressures | None:
    """Pressures of the joints that have columns of them."""
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
    values = np.zeros((len(times), arm.count))
    for name, column in run.commands.items():
        if run.channels[name].kind != kind:
            continue
        joint = run.channels[name].index or 0
        if joint > arm.count:
            raise InputError(
                f"'{run.name}' drives joint {joint}, but the arm has {arm.count} joints: remove "
                "the column, or give a longer arm"
            )
        values[:, joint - 1] = column
    return values


def _wind(arm: Arm, run: Run, times: np.ndarray) -> Signal | None:
    """The wind of the arm, or of each link: where a link has no columns, that of the arm."""
    section = run.definition.section(WindSection)
    if section.velocity_m_per_s is not None:
        return constant(section.velocity_m_per_s)
    if not run.winds:
        return None
    velocity = np.zeros((len(times), arm.count, 3))
    each = False
    for own in (False, True):
        for name, values in run.winds.items():
            channel = run.channels[name]
            if (channel.index or 0) > arm.count:
                raise InputError(
                    f"'{run.name}' has the wind of link {channel.index}, but the arm has "
                    f"{arm.count} links: remove the column, or give a longer arm"
                )
            if (channel.index is not None) == own:
                places = slice(None) if channel.index is None else channel.index - 1
                velocity[:, places, channel.component] = values if own else values[:, None]
                each = each or own
    rows = velocity.reshape(len(times), -1) if each else velocity[:, 0]
    return logged(times, rows, section.interpolation)
