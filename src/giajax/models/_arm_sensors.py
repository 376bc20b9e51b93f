"""What the sensors of an arm show of its motion, channel by channel."""

from collections.abc import Callable

import jax.numpy as jnp

from .._typing import Array, Bool, Float, Scalar
from ..arm import Arm
from ..runs import Channel
from ..simulation import Trajectory
from ._delays import Seen, seen_with_delays
from ._pixels import camera_of, clock_of, projections
from ._protocol import Channels
from ._sensors import Sensors

# What the camera records, and what the angle sensors do.
_POSITIONS = frozenset({"link_position", "tip_position"})
_ANGLES = frozenset({"joint_angle", "joint_rate", "link_angle"})

# The clocks beside those of the cameras with a lens, whose names have no space.
_FRAME = "camera frame"
_ENCODER = "angle sensors"

Times = Float[Array, " sample"]
Motion = Callable[[Times, Scalar], Trajectory]
"""The motion at increasing times (s), simulated until a time (s)."""


def recorded_channels(
    arm: Arm, sensors: Sensors, motion: Motion, times: Times, channels: tuple[str, ...]
) -> tuple[Channels, Bool[Array, ""]]:
    """Channels (m, rad, rad/s, px) as the sensors show them.

    Arguments:
        arm: the arm.
        sensors: its cameras, markers and angle sensors.
        motion: of the arm.
        times: of the samples, s, shape (sample,).
        channels: names without unit.

    Returns:
        The channels, each of shape (sample,), and whether the simulation succeeded.
    """
    known = [Channel.named(name) for name in channels]
    kinds = {channel.kind for channel in known}
    shown = {
        channel.name: camera_of(sensors, channel)
        for channel in known
        if channel.quantity == "pixel"
    }
    seen, successful = _seen(sensors, motion, times, kinds, tuple(dict.fromkeys(shown.values())))
    tables: dict[str, Array] = {}
    if kinds & {"joint_angle", "link_angle"}:
        tables["joint_angle"] = sensors.encoder.shows(seen[_ENCODER].angles)
        tables["link_angle"] = jnp.cumsum(tables["joint_angle"], axis=1)
    if "joint_rate" in kinds:
        tables["joint_rate"] = sensors.encoder.shows_rates(seen[_ENCODER].rates)
    # Positions of all links are computed only where a channel asks for one.
    if "link_position" in kinds:
        tables["link_position"] = sensors.link_positions(arm, seen[_FRAME].angles)
    if "tip_position" in kinds:
        tables["tip_position"] = sensors.tip_positions(arm, seen[_FRAME].angles)[:, None]
    pictures = {
        name: projections(
            arm,
            sensors,
            name,
            seen[name].angles,
            [channel for channel in known if shown.get(channel.name) == name],
        )
        for name in dict.fromkeys(shown.values())
    }
    predicted = {}
    for channel in known:
        if channel.name in shown:
            column = pictures[shown[channel.name]][channel.kind, channel.index or 0].pixels
        else:
            column = tables[channel.kind][:, (channel.index or 1) - 1]
        predicted[channel.name] = (
            column if channel.component is None else column[:, channel.component]
        )
    return predicted, successful


def seen_by_cameras(
    sensors: Sensors, motion: Motion, times: Times, cameras: tuple[str, ...]
) -> tuple[dict[str, Float[Array, "sample joint"]], Bool[Array, ""]]:
    """Joint angles (rad) at the samples of each camera's clock, and whether there is a motion."""
    seen, successful = _seen(sensors, motion, times, set(), cameras)
    return {name: seen[name].angles for name in cameras}, successful


def _seen(
    sensors: Sensors, motion: Motion, times: Times, kinds: set[str], cameras: tuple[str, ...]
) -> tuple[dict[str, Seen], Bool[Array, ""]]:
    """What each sensor sees, by name; a clock that no channel needs costs nothing."""
    clocks: dict[str, Scalar | None] = {}
    if kinds & _POSITIONS:
        clocks[_FRAME] = sensors.camera.delay
    if kinds & _ANGLES:
        clocks[_ENCODER] = sensors.encoder.delay
    clocks |= {name: clock_of(sensors, name) for name in cameras}
    # Sensors that share a clock see the same.
    delays = list({id(delay): delay for delay in clocks.values()}.values())
    if all(delay is None for delay in delays):
        moved = motion(times, times[-1])
        same = Seen(moved.angles, moved.rates)
        return dict.fromkeys(clocks, same), moved.successful
    shown, successful = seen_with_delays(motion, times, delays)
    places = {id(delay): place for place, delay in enumerate(delays)}
    return {name: shown[places[id(delay)]] for name, delay in clocks.items()}, successful
