"""What cameras show of an arm and of the room, channel by channel."""

from collections.abc import Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._text import one_of
from .._typing import Array, Float
from ..arm import Arm
from ..runs import Channel, Run
from ._pinhole import NEAR, Pinhole, Projection
from ._sensors import Sensors


def camera_of(sensors: Sensors, channel: Channel) -> str:
    """The name of the camera that shows a channel.

    Raises:
        InputError: there is no such camera, several and none is named, or the channel is of a
            landmark that is not stated.
    """
    cameras = sensors.camera.pinholes
    name, known = channel.camera, one_of(list(cameras))
    if not cameras:
        section = f"[camera.{name or 'NAME'}]"
        raise InputError(
            f"channel {channel.name!r} is of a picture, but no camera is described: give {section} "
            "with mount, size_px, focal_length_px, position_m and rotation_deg"
        )
    if name is not None and name not in cameras:
        raise InputError(
            f"channel {channel.name!r} is of the camera '{name}', which is not described: it must "
            f"be {known}, so correct the name or give [camera.{name}]"
        )
    if name is None and len(cameras) > 1:
        raise InputError(
            f"channel {channel.name!r} does not say which camera shows it: begin its name with "
            f"that of a camera, {known}, as in '{next(iter(cameras))}.{channel.name}'"
        )
    if channel.kind == "mark_pixel" and mark_of(channel) not in sensors.landmark:
        raise InputError(
            f"channel {channel.name!r} is of a landmark that is not described: say where it is in "
            f"[landmark.{mark_of(channel)}]"
        )
    return name or next(iter(cameras))


def cameras_of(sensors: Sensors, channels: Iterable[str]) -> tuple[str, ...]:
    """The names of the cameras that show some channels, each once.

    Raises:
        InputError: as `camera_of`.
    """
    known = [Channel.named(name) for name in channels]
    seen = [camera_of(sensors, channel) for channel in known if channel.quantity == "pixel"]
    return tuple(dict.fromkeys(seen))


def mark_of(channel: Channel) -> str:
    """The name of the landmark that a channel shows."""
    return f"mark{channel.index or 0:02d}"


def clock_of(sensors: Sensors, name: str) -> Float[Array, ""] | None:
    """How late a camera is, s: as all cameras are, and by itself; None: it is not late."""
    delays = [sensors.camera.delay, sensors.camera.pinholes[name].delay]
    late = [delay for delay in delays if delay is not None]
    return sum(late[1:], late[0]) if late else None


def projections(
    arm: Arm,
    sensors: Sensors,
    name: str,
    angles: Float[Array, "sample joint"],
    channels: Iterable[Channel],
) -> dict[tuple[str, int], Projection]:
    """Where a camera shows what some channels are of.

    Arguments:
        arm: the arm.
        sensors: its markers, landmarks and cameras.
        name: of the camera.
        angles: of the joints at the samples of this camera's clock, rad.
        channels: that are of this camera.

    Returns:
        By row of the column table and number: pixels (sample, 2) and depths (sample,).
    """
    camera: Pinhole = sensors.camera.pinholes[name]
    # In an order of their own: both coordinates of a point are computed together.
    asked = sorted({(channel.kind, channel.index or 0) for channel in channels})
    kinds = {kind for kind, _ in asked}

    def at(row: Float[Array, " joint"]) -> Projection:
        links = sensors.marker.on_links(arm, row) if "link_pixel" in kinds else None
        points = []
        for kind, index in asked:
            if kind == "mark_pixel":
                points.append(sensors.landmark[f"mark{index:02d}"].position)
            elif kind == "tip_pixel":
                points.append(sensors.marker.at_tip(arm, row))
            else:
                assert links is not None
                points.append(links[index - 1])
        return camera.project(jnp.stack(points), arm, row)

    seen = jax.vmap(at)(angles)
    return {
        point: Projection(seen.pixels[:, place], seen.depth[:, place])
        for place, point in enumerate(asked)
    }


@program
def _unseen(
    arm: Arm, sensors: Sensors, name: str, angles: Array, asked: tuple[str, ...]
) -> dict[str, tuple[Array, Array]]:
    """Of each channel of a camera, where its point is behind it, and where out of the picture."""
    channels = [Channel.named(each) for each in asked]
    seen = projections(arm, sensors, name, angles, channels)
    camera = sensors.camera.pinholes[name]
    return {
        channel.name: (one.depth <= NEAR, ~camera.sees(one))
        for channel in channels
        for one in (seen[channel.kind, channel.index or 0],)
    }


def unseen(
    arm: Arm, sensors: Sensors, angles: Mapping[str, Array], channels: Iterable[str]
) -> dict[str, tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]]:
    """Where cameras cannot see what channels are of.

    Arguments:
        arm: the arm.
        sensors: its markers, landmarks and cameras.
        angles: of the joints by camera, at the samples of its clock, rad.
        channels: names; those that are of no picture are left out.

    Returns:
        By channel: at which samples the point is behind the camera, and at which it is not in
        the picture.
    """
    by_camera: dict[str, list[str]] = {}
    for name in channels:
        channel = Channel.named(name)
        if channel.quantity == "pixel":
            by_camera.setdefault(camera_of(sensors, channel), []).append(name)
    return {
        channel: (np.asarray(behind), np.asarray(outside))
        for name, asked in by_camera.items()
        for channel, (behind, outside) in _unseen(
            arm, sensors, name, angles[name], tuple(asked)
        ).items()
    }


def behind_conditions(
    run: Run, unseen: Mapping[str, tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]]
) -> list[str]:
    """That pixels were recorded of points that the model has behind the camera.

    Arguments:
        run: that was recorded.
        unseen: by channel, at which samples the point is behind the camera, and out of the picture.

    Returns:
        A sentence for each camera, or none.
    """
    cells: dict[str, list[tuple[str, int]]] = {}
    for name, (behind, _) in unseen.items():
        count = int(np.sum(behind & np.isfinite(run.values[name])))
        if count:
            cells.setdefault(run.channels[name].camera or "", []).append((name, count))
    return [
        f"{'camera ' + camera if camera else 'the camera'}: in '{run.name}' "
        f"{sum(count for _, count in found)} recorded pixels of "
        f"{', '.join(name for name, _ in found)} are of points that the model has behind it, "
        "where nothing is seen: correct its position and rotation, or which point is which"
        for camera, found in cells.items()
    ]
