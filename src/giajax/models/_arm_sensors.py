"""What the sensors of an arm show of its motion, channel by channel."""

from collections.abc import Callable

import jax.numpy as jnp

from .._typing import Array, Bool, Float, Scalar
from ..arm import Arm
from ..runs import Channel
from ..simulation import Trajectory
from ._delays import Seen, seen_with_delays
from ._protocol import Channels
from ._sensors import Sensors

# What the camera records, and what the angle sensors do.
_POSITIONS = frozenset({"link_position", "tip_position"})
_ANGLES = frozenset({"joint_angle", "joint_rate", "link_angle"})

Times = Float[Array, " sample"]
Motion = Callable[[Times, Scalar], Trajectory]
"""The motion at increasing times (s), simulated until a time (s)."""


def recorded_channels(
    arm: Arm, sensors: Sensors, motion: Motion, times: Times, channels: tuple[str, ...]
) -> tuple[Channels, Bool[Array, ""]]:
    """Channels (m, rad, rad/s) as the sensors show them.

    Arguments:
        arm: the arm.
        sensors: its camera, markers and angle sensors.
        motion: of the arm.
        times: of the samples, s, shape (sample,).
        channels: names without unit.

    Returns:
        The channels, each of shape (sample,), and whether the simulation succeeded.
    """
    known = [Channel.named(name) for name in channels]
    kinds = {channel.kind for channel in known}
    camera, encoder, successful = _seen(sensors, motion, times, kinds)
    tables: dict[str, Array] = {}
    if kinds & {"joint_angle", "link_angle"}:
        tables["joint_angle"] = sensors.encoder.shows(encoder.angles)
        tables["link_angle"] = jnp.cumsum(tables["joint_angle"], axis=1)
    if "joint_rate" in kinds:
        tables["joint_rate"] = sensors.encoder.shows_rates(encoder.rates)
    # Positions of all links are computed only where a channel asks for one.
    if "link_position" in kinds:
        tables["link_position"] = sensors.link_positions(arm, camera.angles)
    if "tip_position" in kinds:
        tables["tip_position"] = sensors.tip_positions(arm, camera.angles)[:, None]
    predicted = {}
    for channel in known:
        column = tables[channel.kind][:, (channel.index or 1) - 1]
        predicted[channel.name] = (
            column if channel.component is None else column[:, channel.component]
        )
    return predicted, successful


def _seen(
    sensors: Sensors, motion: Motion, times: Times, kinds: set[str]
) -> tuple[Seen, Seen, Bool[Array, ""]]:
    """What camera and angle sensors see; a clock that no channel needs costs nothing."""
    camera = sensors.camera.delay if kinds & _POSITIONS else None
    encoder = sensors.encoder.delay if kinds & _ANGLES else None
    if camera is None and encoder is None:
        moved = motion(times, times[-1])
        seen = Seen(moved.angles, moved.rates)
        return seen, seen, moved.successful
    clocks = [
        delay
        for delay, asked in ((camera, kinds & _POSITIONS), (encoder, kinds & _ANGLES))
        if asked
    ]
    clocks_seen, successful = seen_with_delays(motion, times, clocks)
    return clocks_seen[0], clocks_seen[-1], successful
