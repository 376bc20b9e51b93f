"""Sensors of an arm: what they record of its motion, channel by channel."""

import abc
import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ..mechanics.arm import Arm, pose
from ..recordings import Channel, Run
from ..runtime.arrays import (
    Array,
    Bool,
    Float,
    Scalar,
    rotate,
    rotation_vector_to_quaternion,
    scaled,
)
from ..runtime.plugins import classes_of_others, made_by_default, name_of, registered
from ..runtime.programs import program
from ..runtime.text import InputError, one_of, tried
from ..schema import CAMERA, ENCODER, KINDS, LANDMARK, MARKER, ChannelKind, add_kind
from ..schema.parameters import declared, inline, is_concrete, parameter
from ..simulation import Trajectory, at_rest
from ._cameras import NEAR, Pinhole, Projection
from ._protocol import Prediction

# Sensors that record an arm: cameras with frame, scale and clock, markers, and angle sensors.
#
# Every parameter is optional, and parameters that are left out need no computation. A camera
# records a point p of the base frame as scale * R^T (p - origin), where R is the rotation of the
# camera frame relative to the base frame.


class Camera(eqx.Module):
    """Frame, scale and clock of recorded positions, and the cameras that record pixels."""

    rotation: Float[Array, "3"] | None = parameter(CAMERA.rotation)
    origin: Float[Array, "3"] | None = parameter(CAMERA.origin)
    scale: Scalar | None = parameter(CAMERA.scale)
    delay: Scalar | None = parameter(CAMERA.delay)
    clock_rate: Scalar | None = parameter(CAMERA.clock_rate)
    lens_k1: Scalar | None = parameter(CAMERA.lens_k1)
    lens_k2: Scalar | None = parameter(CAMERA.lens_k2)
    # The key is the name, which is part of the paths: `camera.side.position`.
    pinholes: dict[str, Pinhole] = inline(default_factory=dict)

    def sees(self, positions: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Convert positions (m) in the base frame to recorded positions, without clock errors."""
        if self.origin is not None:
            positions = positions - self.origin.reshape((1,) * (positions.ndim - 1) + (3,))
        if self.rotation is not None:
            back = rotation_vector_to_quaternion(-self.rotation)
            rows = positions.reshape(-1, 3).T
            turned = rotate(jnp.broadcast_to(back[:, None], (4, rows.shape[1])), rows)
            positions = turned.T.reshape(positions.shape)
        return positions if self.scale is None else self.scale * positions

    def through_lens(self, positions: Float[Array, "*point 3"], arm: Arm) -> Array:
        """Apply the distortion of a lens aimed at the middle of the arm to positions (m).

        Positions do not determine the distance and direction of the camera. Therefore all three
        coordinates are distorted radially about the middle of the straight arm, and distances are
        divided by half of its length.
        """
        if self.lens_k1 is None and self.lens_k2 is None:
            return positions
        k1, k2 = (0.0 if k is None else k for k in (self.lens_k1, self.lens_k2))
        middle = Marker().at_tip(arm, jnp.zeros_like(arm.links.length)) / 2
        middle = middle.reshape((1,) * (positions.ndim - 1) + (3,))
        away = positions - middle
        squared = jnp.sum(away**2, axis=-1, keepdims=True) / jnp.sum(middle**2)
        return middle + away * (1 + squared * (k1 + squared * k2))


class Landmark(eqx.Module):
    """A fixed point of the room that cameras record."""

    position: Float[Array, "3"] = parameter(LANDMARK.position)


class Marker(eqx.Module):
    """Positions of the tracked points in the frames of their links."""

    along: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.along)
    left: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.left)
    up: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.up)
    tip: Float[Array, "3"] | None = parameter(MARKER.tip)

    def on_links(self, arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "link 3"]:
        """Return the positions of the link markers in the base frame, m."""
        here = pose(arm, angles, sideways=self.left is not None or self.up is not None)
        points = here.centre

        def each(offset: Array) -> Array:
            return jnp.broadcast_to(offset, (arm.count,))

        if self.along is not None:
            points = points + scaled(each(self.along), here.direction)
        if self.left is not None:
            assert here.left is not None
            points = points + scaled(each(self.left), here.left)
        if self.up is not None:
            points = points + scaled(each(self.up), here.up)
        return points.T

    def at_tip(self, arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "3"]:
        """Return the position of the tip marker in the base frame, m."""
        here = pose(arm, angles, sideways=self.tip is not None)
        end = scaled(arm.links.length, here.direction).sum(axis=-1)
        if self.tip is None:
            return end
        assert here.left is not None
        frame = jnp.stack([here.direction[:, -1], here.left[:, -1], here.up[:, -1]], axis=1)
        return end + frame @ self.tip


class Encoder(eqx.Module):
    """Offset, scale and clock of the joint sensors; link angles are sums of their angles."""

    offset: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.offset)
    scale: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.scale)
    delay: Scalar | None = parameter(ENCODER.delay)
    clock_rate: Scalar | None = parameter(ENCODER.clock_rate)
    rate_offset: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.rate_offset)

    def shows(self, angles: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        """Return recorded joint angles, rad, without clock errors."""
        shown = self._scaled(angles)
        return shown if self.offset is None else shown + per_row(self.offset, shown)

    def shows_rates(self, rates: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        """Return recorded joint rates, rad/s, without clock errors."""
        shown = self._scaled(rates)
        return shown if self.rate_offset is None else shown + per_row(self.rate_offset, shown)

    def _scaled(self, values: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        return values if self.scale is None else values * per_row(self.scale, values)

    def true_angles(self, shown: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Return true joint angles (rad) from recorded ones: the inverse of `shows`."""
        shown = shown if self.offset is None else shown - self.offset
        return shown if self.scale is None else shown / self.scale

    def true_rates(self, shown: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Return true joint rates (rad/s) from recorded ones: the inverse of `shows_rates`."""
        shown = shown if self.rate_offset is None else shown - self.rate_offset
        return shown if self.scale is None else shown / self.scale


def per_row(value: Array, table: Array) -> Array:
    return jnp.broadcast_to(value, table.shape[1:])[None]


_SENSORS: dict[str, str] = {}  # row of the column table -> name of the sensor class


class AbstractSensor(eqx.Module):
    """A sensor on an arm, which records the columns of one row of the column table.

    Its parameters are declared like all others (`giajax.schema.parameters.parameter`) and have
    paths such as `sensor.NAME.gain`. A parameter named `delay`, s, delays the recorded motion by
    this time; `clock_rate` has the meaning of `camera.clock_rate`. `check_sensor` tests a sensor.
    """

    registered_as: ClassVar[str] = "sensor"
    channel: ClassVar[ChannelKind]
    """Row of the column table: name, column (`gaugeNN`), quantity, "output" and noise key."""

    @classmethod
    def on_registration(cls) -> None:
        """Add the row of the sensor to those of an arm.

        Raises:
            InputError: the class has no row, or its row belongs to another sensor.
        """
        row, arm, name = getattr(cls, "channel", None), KINDS["arm"], name_of(cls)
        if not isinstance(row, ChannelKind) or row.part != "output" or row.quantity == "pixel":
            raise InputError(
                f"{name}.channel is {row!r}: make it a giajax.schema.ChannelKind with the part "
                '"output" and a quantity other than "pixel"'
            )
        # A notebook cell that is run again may define another row for the same class.
        former = {each for each, owner in _SENSORS.items() if owner == name and each != row.name}
        others = tuple(each for each in arm.channels if each.name not in {row.name, *former})
        owner = _SENSORS.get(row.name, "giajax")
        there = row.name in {each.name for each in arm.channels}
        if there and owner != name and not cls.__module__.startswith("giajax."):
            raise InputError(
                f"the channel '{row.name}' of {name} already belongs to {owner}: give the channel "
                "another name"
            )
        if former or row not in arm.channels:
            add_kind(dataclasses.replace(arm, channels=(*others, row)))
        for each in former:
            del _SENSORS[each]
        _SENSORS[row.name] = name

    @abc.abstractmethod
    def values(self, motion: Trajectory) -> Float[Array, "sample *place"]:
        """Return the recorded values at the samples of a motion, SI.

        Arguments:
            motion: the motion with times, angles, rates, accelerations and joint torques, and the
                arm.

        Returns:
            Values of shape (sample,), with one more axis for links or joints if the column has a
            number, and one for the components if it ends in `_x` or `_u`.
        """


def sensor_named(name: str) -> AbstractSensor:
    """Return a sensor with the default values of its class.

    Raises:
        InputError: the sensor is not registered, or its class has no defaults.
    """
    if (found := registered(AbstractSensor.registered_as, name)) is None:
        raise InputError(f"there is no registered sensor '{name}': register its class")
    made: AbstractSensor = made_by_default(found, f"the sensor {name}")
    return made


def own_sensors() -> tuple[type[AbstractSensor], ...]:
    """Return the registered user-defined classes, on which a program depends by default."""
    return tuple(each for _, each in sorted(classes_of_others("sensor").items()))


def check_sensor(sensor: AbstractSensor, arm: Arm) -> None:
    """Test a sensor on an arm that is straight and at rest.

    No test is made during tracing.

    Raises:
        InputError: the sensor raises an exception, or returns a wrong shape, or a value or
            derivative that is not finite; the message names the method and the problem.
    """
    if not is_concrete((sensor, arm)):
        return
    what, row = f"{type(sensor).__name__}.values", sensor.channel
    with tried(what):
        shown, slope = _shown_at_rest(sensor, arm)
    places = [arm.count] * ("NN" in row.column) + [len(row.components)] * bool(row.components)
    shape = getattr(shown, "shape", None)
    if shape != (1, *places):
        raise InputError(
            f"{what} returns the shape {shape} for one sample and an arm of {arm.count} links: "
            f"return {(1, *places)}, as {row.column} requires"
        )
    for each, found in {"value": shown, "derivative": slope}.items():
        if not bool(jnp.all(jnp.isfinite(found))):
            raise InputError(
                f"{what} has a {each} that is not finite at rest: correct it (safe_norm of "
                "giajax.runtime.arrays is a norm that is differentiable at rest)"
            )


@program
def _shown_at_rest(sensor: AbstractSensor, arm: Arm) -> tuple[Any, Any]:
    """Return the values at rest, and their derivative along all angles, rates and parameters."""

    def shown(sensor: AbstractSensor, angles: Array, rates: Array) -> Any:
        motion = at_rest(arm, angles)
        return sensor.values(dataclasses.replace(motion, rates=motion.rates + rates[None]))

    still = jnp.zeros(arm.count)
    given = (sensor, still, still)
    return eqx.filter_jvp(shown, given, jax.tree.map(_one, given))


def _one(leaf: Any) -> Any:
    return jnp.ones_like(leaf) if eqx.is_inexact_array(leaf) else None


class Picture(AbstractSensor):
    """The image of chosen points in a camera: both pixel coordinates of all points at once.

    Attributes:
        camera, marker, landmark: parts of `Sensors` that determine the image of the points.
        delay, clock_rate: clock errors of the camera.
        points: rows of the column table, each with the number of the link or landmark, or 0.
    """

    camera: Pinhole
    marker: Marker
    landmark: dict[str, Landmark]
    delay: Scalar | None
    clock_rate: Scalar | None
    points: tuple[tuple[str, int], ...] = eqx.field(static=True)

    def values(self, motion: Trajectory) -> Float[Array, "sample point 2"]:
        """Return the pixel coordinates of the points."""
        return self.projected(motion).pixels

    def projected(self, motion: Trajectory) -> Projection:
        """Return pixel coordinates and depths (m) of the points at the samples of a motion."""
        arm = motion.arm

        def at(row: Float[Array, " joint"]) -> Projection:
            linked = any(kind == "link_pixel" for kind, _ in self.points)
            links = self.marker.on_links(arm, row) if linked else None
            points = []
            for kind, index in self.points:
                if kind == "mark_pixel":
                    points.append(self.landmark[f"mark{index:02d}"].position)
                elif kind == "tip_pixel":
                    points.append(self.marker.at_tip(arm, row))
                else:
                    assert links is not None
                    points.append(links[index - 1])
            return self.camera.project(jnp.stack(points), arm, row)

        seen: Projection = jax.vmap(at)(motion.angles)
        return seen

    def place(self, channel: Channel) -> int:
        """Return the index of the point that a channel belongs to."""
        return self.points.index((channel.kind, channel.index or 0))


class Sensors(eqx.Module):
    """All sensors that record the motion of an arm."""

    camera: Camera = eqx.field(default_factory=Camera)
    marker: Marker = eqx.field(default_factory=Marker)
    encoder: Encoder = eqx.field(default_factory=Encoder)
    landmark: dict[str, Landmark] = eqx.field(default_factory=dict)
    sensor: dict[str, AbstractSensor] = eqx.field(default_factory=dict)

    def __check_init__(self) -> None:
        for name, each in self.sensor.items():
            if isinstance(each, AbstractSensor) and name != name_of(type(each)):
                raise InputError(
                    f"the sensor '{name}' is a {name_of(type(each))}, but must have the name of "
                    "its class, because this name links the sensor to its columns: rename the "
                    "sensor"
                )

    def of_row(self, kind: str) -> AbstractSensor | None:
        """Return the sensor of a row of the column table, by default with its default values.

        Rows that are recorded by camera, markers and angle sensors have no such sensor (None).
        """
        if (name := _SENSORS.get(kind)) is None:
            return None
        return self.sensor[name] if name in self.sensor else sensor_named(name)

    def rows(self, kinds: Iterable[str]) -> dict[str, tuple[Callable[[Trajectory], Array], Any]]:
        """Return for each row the function from motion to columns, and its clock; no pixels."""

        def seen(points: Callable[[Arm, Array], Array]) -> Callable[[Trajectory], Array]:
            def shown(of: Trajectory) -> Array:
                true = jax.vmap(lambda at: points(of.arm, at))(of.angles)
                return self.camera.sees(self.camera.through_lens(true, of.arm))

            return shown

        angles, rates = self.encoder.shows, self.encoder.shows_rates
        known: dict[str, tuple[Callable[[Trajectory], Array], Any]] = {
            "link_position": (seen(self.marker.on_links), self.camera),
            "tip_position": (seen(self.marker.at_tip), self.camera),
            "joint_angle": (lambda motion: angles(motion.angles), self.encoder),
            "joint_rate": (lambda motion: rates(motion.rates), self.encoder),
            "link_angle": (lambda motion: jnp.cumsum(angles(motion.angles), axis=1), self.encoder),
        }
        own = {kind: self.of_row(kind) for kind in sorted(kinds)}
        known |= {kind: (of.values, of) for kind, of in own.items() if of is not None}
        return {kind: known[kind] for kind in own if kind in known}

    def pictures(self, channels: Iterable[Channel]) -> dict[str, Picture]:
        """Return by camera the image of the points that the pixel channels require.

        Raises:
            InputError: as in `camera_of`.
        """
        shown: dict[str, set[tuple[str, int]]] = {}
        for channel in channels:
            if channel.quantity == "pixel":
                points = shown.setdefault(camera_of(self, channel), set())
                points.add((channel.kind, channel.index or 0))
        rate = self.camera.clock_rate
        return {
            name: Picture(
                self.camera.pinholes[name],
                self.marker,
                self.landmark,
                clock_of(self, name),
                rate,
                # Sorted, because both coordinates of a point are computed together.
                tuple(sorted(points)),
            )
            for name, points in shown.items()
        }

    def without_clocks(self) -> "Sensors":
        """Return the same sensors with exact clocks of camera and encoder."""
        lenses = self.camera.pinholes.items()
        on_time = {name: dataclasses.replace(each, delay=None) for name, each in lenses}
        right: dict[str, Any] = {"delay": None, "clock_rate": None}
        camera = dataclasses.replace(self.camera, **right, pinholes=on_time)
        encoder = dataclasses.replace(self.encoder, **right)
        return dataclasses.replace(self, camera=camera, encoder=encoder)

    def with_rows(self, kinds: Iterable[str]) -> "Sensors":
        """Return the sensors with those added that these rows of the column table require."""
        asked = [_SENSORS[kind] for kind in kinds if kind in _SENSORS]
        new = {name: sensor_named(name) for name in asked if name not in self.sensor}
        # Sorted, because JAX sorts the keys of dicts.
        return dataclasses.replace(self, sensor=dict(sorted((self.sensor | new).items())))

    def check(self, joints: int) -> None:
        """Refuse values for a different number of links or joints.

        Raises:
            InputError: the numbers differ; the message names the parameter and both numbers.
        """
        for name, known in declared(self).items():
            shape = known.value(self).shape
            if known.declaration.per and shape not in ((), (joints,)):
                raise InputError(
                    f"{name} has {np.prod(shape)} values for an arm of {joints} links: give one "
                    "number, or one for each joint"
                )


def camera_of(sensors: Sensors, channel: Channel) -> str:
    """Return the name of the camera that records a channel.

    Raises:
        InputError: the camera does not exist, several exist but the channel names none, or the
            landmark of the channel is not given.
    """
    cameras = sensors.camera.pinholes
    name, known = channel.camera, one_of(list(cameras))
    if not cameras:
        section = f"[camera.{name or 'NAME'}]"
        raise InputError(
            f"channel {channel.name!r} contains image coordinates, but no camera is described: "
            f"add {section} with mount, size_px, focal_length_px, position_m and rotation_deg"
        )
    if name is not None and name not in cameras:
        raise InputError(
            f"channel {channel.name!r} belongs to the camera '{name}', which is not described: "
            f"the camera must be {known}, so correct its name or add [camera.{name}]"
        )
    if name is None and len(cameras) > 1:
        raise InputError(
            f"channel {channel.name!r} does not specify its camera: begin the name of the channel "
            f"with the name of a camera ({known}), as in '{next(iter(cameras))}.{channel.name}'"
        )
    if channel.kind == "mark_pixel" and mark_of(channel) not in sensors.landmark:
        raise InputError(
            f"channel {channel.name!r} belongs to a landmark that is not described: give the "
            f"position of the landmark in [landmark.{mark_of(channel)}]"
        )
    return name or next(iter(cameras))


def mark_of(channel: Channel) -> str:
    """Return the name of the landmark of a channel."""
    return f"mark{channel.index or 0:02d}"


def clock_of(sensors: Sensors, name: str) -> Float[Array, ""] | None:
    """Return the delay of a camera, s: the common delay plus its own; None if it has none."""
    delays = [sensors.camera.delay, sensors.camera.pinholes[name].delay]
    late = [delay for delay in delays if delay is not None]
    return sum(late[1:], late[0]) if late else None


def behind_conditions(
    run: Run, unseen: Mapping[str, tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]]
) -> list[str]:
    """Return a sentence for each camera with recorded pixels of points behind it in the model.

    `unseen` gives for each channel the samples at which the point is behind the camera, and those
    at which it is outside the image.
    """
    cells: dict[str, list[tuple[str, int]]] = {}
    for name, (behind, _) in unseen.items():
        count = int(np.sum(behind & np.isfinite(run.values[name])))
        if count:
            cells.setdefault(run.channels[name].camera or "", []).append((name, count))
    return [
        f"{'camera ' + camera if camera else 'the camera'}: in '{run.name}' "
        f"{sum(count for _, count in found)} recorded pixel coordinates of "
        f"{', '.join(name for name, _ in found)} show points that are behind the camera in the "
        "model: correct the position and rotation of the camera, or the names of the points"
        for camera, found in cells.items()
    ]


Times = Float[Array, " sample"]

Clock = tuple[Scalar | None, Scalar | None]
"""Delay of a clock, s, and its relative rate error (`camera.clock_rate`); None if exact."""


Motion = Callable[[Times, Scalar], Trajectory]
"""Return the motion at increasing times (s), from a simulation that ends at a given time (s)."""


def _true_times(times: Times, clock: Clock) -> Times:
    """Return the true times, s, of samples with time stamps `times` of this clock."""
    delay, rate = clock
    true = times if rate is None else times + rate * (times - times[0])
    return true if delay is None else true - delay


def _seen_by_clocks(
    motion: Motion, times: Times, by: Sequence[Clock]
) -> tuple[list[Trajectory], Bool[Array, ""]]:
    """Return the motions at the samples of each clock, and whether the simulation succeeded.

    All motions come from one simulation. They are interpolated by the integrator, which adds no
    error and gives the derivative with respect to the clock. Before the start of the run the arm
    moves with the rates of its first sample (it rests if it starts at rest). After the end of the
    run its last command continues.
    """
    first = times[0]
    clocks = [_true_times(times, clock) for clock in by]
    within = [jnp.where(moments < first, first, moments) for moments in clocks]
    together = jnp.concatenate(within)
    order = jnp.argsort(jax.lax.stop_gradient(together))
    # The end of the simulation does not affect earlier times, so it needs no derivative.
    end = jax.lax.stop_gradient(jnp.max(jnp.append(together, times[-1])))
    moved = motion(together[order], end)
    place = jnp.argsort(order).reshape(len(by), len(times))
    seen = []
    for row, moments, inside in zip(place, clocks, within, strict=True):
        names = ("angles", "rates", "memory", "pressures", "skin")
        states = {name: getattr(moved, name) for name in names}
        there = jax.tree.map(lambda rows, row=row: rows[row], states)
        there["angles"] = there["angles"] + (moments - inside)[:, None] * there["rates"]
        seen.append(dataclasses.replace(moved, times=inside, **there))
    return seen, moved.successful


def recorded_channels(
    sensors: Sensors, motion: Motion, times: Times, channels: tuple[str, ...]
) -> Prediction:
    """Return channels (SI, px) as recorded by the sensors, and whether the simulation succeeded.

    Times of the samples are in s; names of channels do not include a unit.
    """
    known = [Channel.named(name) for name in channels]
    pictures = sensors.pictures(known)
    # The prefix prevents a conflict between the name of a camera and that of a row.
    shown = sensors.rows({channel.kind for channel in known})
    shown |= {f"camera.{name}": (each.values, each) for name, each in pictures.items()}
    seen, successful = _seen(motion, times, {name: clock for name, (_, clock) in shown.items()})
    # Each required row is computed once, for all of its columns.
    tables = {name: values(seen[name]) for name, (values, _) in shown.items()}
    predicted = {}
    for channel in known:
        if channel.quantity == "pixel":
            name = camera_of(sensors, channel)
            column = tables[f"camera.{name}"][:, pictures[name].place(channel)]
        else:
            table = tables[channel.kind]
            column = table if channel.index is None else table[:, channel.index - 1]
        predicted[channel.name] = (
            column if channel.component is None else column[:, channel.component]
        )
    return predicted, successful


def unseen_channels(
    sensors: Sensors, motion: Motion, times: Times, channels: tuple[str, ...]
) -> dict[str, tuple[Bool[Array, " sample"], Bool[Array, " sample"]]]:
    """Return for each pixel channel the samples behind its camera and those outside the image.

    Other channels are left out.
    """
    known = [Channel.named(name) for name in channels]
    pictures = sensors.pictures(known)
    seen, _ = _seen(motion, times, pictures)
    found = {name: picture.projected(seen[name]) for name, picture in pictures.items()}
    places = {
        channel.name: (camera, pictures[camera].place(channel))
        for channel in known
        if channel.quantity == "pixel"
        for camera in (camera_of(sensors, channel),)
    }
    return {
        name: (
            found[camera].depth[:, place] <= NEAR,
            ~pictures[camera].camera.sees(found[camera])[:, place],
        )
        for name, (camera, place) in places.items()
    }


def _seen(
    motion: Motion, times: Times, shows: Mapping[str, Any]
) -> tuple[dict[str, Trajectory], Bool[Array, ""]]:
    """Return the motion that each sensor sees, by name; a delay is computed only if needed."""
    clocks: dict[str, Clock] = {
        name: (getattr(each, "delay", None), getattr(each, "clock_rate", None))
        for name, each in shows.items()
    }
    # Sensors that share a clock see the same motion.
    known = {tuple(map(id, clock)): clock for clock in clocks.values()}
    if all(part is None for clock in known.values() for part in clock):
        moved = motion(times, times[-1])
        return dict.fromkeys(clocks, moved), moved.successful
    shown, successful = _seen_by_clocks(motion, times, list(known.values()))
    seen = dict(zip(known, shown, strict=True))
    return {name: seen[tuple(map(id, clock))] for name, clock in clocks.items()}, successful
