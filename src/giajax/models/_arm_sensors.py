"""What the sensors of an arm show of its motion, channel by channel."""

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

# What records an arm: a camera with its frame, scale and clock, markers, and angle sensors.
#
# Every parameter is optional; what is left out costs nothing. A camera shows a point p of the
# base frame at scale * R^T (p - origin), R being the turn of the camera frame against the base
# frame.


class Camera(eqx.Module):
    """Frame, scale and clock of recorded positions; and the cameras whose pixels are recorded."""

    rotation: Float[Array, "3"] | None = parameter(CAMERA.rotation)
    origin: Float[Array, "3"] | None = parameter(CAMERA.origin)
    scale: Scalar | None = parameter(CAMERA.scale)
    delay: Scalar | None = parameter(CAMERA.delay)
    clock_rate: Scalar | None = parameter(CAMERA.clock_rate)
    lens_k1: Scalar | None = parameter(CAMERA.lens_k1)
    lens_k2: Scalar | None = parameter(CAMERA.lens_k2)
    # By name, which is part of the paths: `camera.side.position`.
    pinholes: dict[str, Pinhole] = inline(default_factory=dict)

    def sees(self, positions: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Positions (m) of the base frame as they are recorded; the clock apart."""
        if self.origin is not None:
            positions = positions - self.origin.reshape((1,) * (positions.ndim - 1) + (3,))
        if self.rotation is not None:
            back = rotation_vector_to_quaternion(-self.rotation)
            rows = positions.reshape(-1, 3).T
            turned = rotate(jnp.broadcast_to(back[:, None], (4, rows.shape[1])), rows)
            positions = turned.T.reshape(positions.shape)
        return positions if self.scale is None else self.scale * positions

    def through_lens(self, positions: Float[Array, "*point 3"], arm: Arm) -> Array:
        """Positions (m) of the base frame as a lens shows them that points at the middle of an arm.

        How far away that is, and from which side, positions do not say: the lens draws all three
        coordinates to the middle, and its unit of distance is half of the straight arm.
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
    """A point of the room that cameras see."""

    position: Float[Array, "3"] = parameter(LANDMARK.position)


class Marker(eqx.Module):
    """Where the tracked points lie, in the frame of their link."""

    along: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.along)
    left: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.left)
    up: Float[Array, ""] | Float[Array, " link"] | None = parameter(MARKER.up)
    tip: Float[Array, "3"] | None = parameter(MARKER.tip)

    def on_links(self, arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "link 3"]:
        """Positions of the links' markers in the base frame, m."""
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
        """Position of the tip's marker in the base frame, m."""
        here = pose(arm, angles, sideways=self.tip is not None)
        end = scaled(arm.links.length, here.direction).sum(axis=-1)
        if self.tip is None:
            return end
        assert here.left is not None
        frame = jnp.stack([here.direction[:, -1], here.left[:, -1], here.up[:, -1]], axis=1)
        return end + frame @ self.tip


class Encoder(eqx.Module):
    """Zero, scale and clock of the joints' sensors; angles of links are the sums of theirs."""

    offset: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.offset)
    scale: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.scale)
    delay: Scalar | None = parameter(ENCODER.delay)
    clock_rate: Scalar | None = parameter(ENCODER.clock_rate)
    rate_offset: Float[Array, ""] | Float[Array, " joint"] | None = parameter(ENCODER.rate_offset)

    def shows(self, angles: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        """Recorded joint angles, rad; the clock apart."""
        shown = self._scaled(angles)
        return shown if self.offset is None else shown + per_row(self.offset, shown)

    def shows_rates(self, rates: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        """Recorded joint rates, rad/s; the clock apart."""
        shown = self._scaled(rates)
        return shown if self.rate_offset is None else shown + per_row(self.rate_offset, shown)

    def _scaled(self, values: Float[Array, "sample joint"]) -> Float[Array, "sample joint"]:
        return values if self.scale is None else values * per_row(self.scale, values)

    def true_angles(self, shown: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Joint angles (rad) that are shown so: the inverse of `shows`; the clock apart."""
        shown = shown if self.offset is None else shown - self.offset
        return shown if self.scale is None else shown / self.scale

    def true_rates(self, shown: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Joint rates (rad/s) that are shown so: the inverse of `shows_rates`."""
        shown = shown if self.rate_offset is None else shown - self.rate_offset
        return shown if self.scale is None else shown / self.scale


def per_row(value: Array, table: Array) -> Array:
    return jnp.broadcast_to(value, table.shape[1:])[None]


_SENSORS: dict[str, str] = {}  # names of the classes by their rows of the column table


class AbstractSensor(eqx.Module):
    """What a sensor on an arm shows: the columns of one row of the column table.

    Its parameters are declared as all others (`giajax.schema.parameters.parameter`) and have paths
    as `sensor.NAME.gain`. Where it has one that is called `delay`, s, it shows the motion of so
    much earlier; `clock_rate` is that of `camera.clock_rate`. `check_sensor` tests a sensor.
    """

    registered_as: ClassVar[str] = "sensor"
    channel: ClassVar[ChannelKind]
    """Its row: name, column (`gaugeNN`, `tip_gauge`), quantity, "output", and key of noise."""

    @classmethod
    def on_registration(cls) -> None:
        """Add its row to those of an arm.

        Raises:
            InputError: it has no row, or one that another has.
        """
        row, arm, name = getattr(cls, "channel", None), KINDS["arm"], name_of(cls)
        if not isinstance(row, ChannelKind) or row.part != "output" or row.quantity == "pixel":
            raise InputError(
                f"{name}.channel is {row!r}: make it a "
                'giajax.schema.ChannelKind with the part "output" and no pixels'
            )
        # A cell of a notebook that is run again may have another row.
        former = {each for each, owner in _SENSORS.items() if owner == name and each != row.name}
        others = tuple(each for each in arm.channels if each.name not in {row.name, *former})
        owner = _SENSORS.get(row.name, "giajax")
        there = row.name in {each.name for each in arm.channels}
        if there and owner != name and not cls.__module__.startswith("giajax."):
            raise InputError(
                f"the channel '{row.name}' of {name} is already that of {owner}: give the channel "
                f"another name"
            )
        if former or row not in arm.channels:
            add_kind(dataclasses.replace(arm, channels=(*others, row)))
        for each in former:
            del _SENSORS[each]
        _SENSORS[row.name] = name

    @abc.abstractmethod
    def values(self, motion: Trajectory) -> Float[Array, "sample *place"]:
        """What it shows of a motion at its samples, SI.

        Arguments:
            motion: with times, angles, rates, accelerations and torques of the joints, and the arm.

        Returns:
            Shape (sample,); with an axis more for the links or joints where the column has a
            number, and one for the components where it ends in `_x` or `_u`.
        """


def sensor_named(name: str) -> AbstractSensor:
    """The sensor of a name as its class makes it.

    Raises:
        InputError: none is registered, or it has no default.
    """
    if (found := registered(AbstractSensor.registered_as, name)) is None:
        raise InputError(f"there is no registered sensor '{name}': register its class")
    made: AbstractSensor = made_by_default(found, f"the sensor {name}")
    return made


def own_sensors() -> tuple[type[AbstractSensor], ...]:
    """The registered classes that are not giajax's, on which a program depends by default."""
    return tuple(each for _, each in sorted(classes_of_others("sensor").items()))


def check_sensor(sensor: AbstractSensor, arm: Arm) -> None:
    """Try a sensor on an arm that is straight and at rest.

    While a program is traced nothing is checked.

    Raises:
        InputError: naming the method and what is wrong: an exception, a shape, or a value or a
            derivative that is not finite.
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
            f"return "
            f"{(1, *places)}, as {row.column} requires"
        )
    for each, found in {"value": shown, "derivative": slope}.items():
        if not bool(jnp.all(jnp.isfinite(found))):
            raise InputError(
                f"{what} has a {each} that is not finite at rest: correct it (safe_norm of "
                "giajax.runtime.arrays is a norm that can be differentiated at rest)"
            )


@program
def _shown_at_rest(sensor: AbstractSensor, arm: Arm) -> tuple[Any, Any]:
    """What it shows, and how that changes with all that moves and with its parameters."""

    def shown(sensor: AbstractSensor, angles: Array, rates: Array) -> Any:
        motion = at_rest(arm, angles)
        return sensor.values(dataclasses.replace(motion, rates=motion.rates + rates[None]))

    still = jnp.zeros(arm.count)
    given = (sensor, still, still)
    return eqx.filter_jvp(shown, given, jax.tree.map(_one, given))


def _one(leaf: Any) -> Any:
    return jnp.ones_like(leaf) if eqx.is_inexact_array(leaf) else None


class Picture(AbstractSensor):
    """What a camera shows of chosen points: pixels, with both coordinates of all points at once.

    Attributes:
        camera, marker, landmark: by which points appear: those of `Sensors`.
        delay, clock_rate: of its clock.
        points: rows of the column table, with the number of the link or landmark, or 0.
    """

    camera: Pinhole
    marker: Marker
    landmark: dict[str, Landmark]
    delay: Scalar | None
    clock_rate: Scalar | None
    points: tuple[tuple[str, int], ...] = eqx.field(static=True)

    def values(self, motion: Trajectory) -> Float[Array, "sample point 2"]:
        """Pixels of the points."""
        return self.projected(motion).pixels

    def projected(self, motion: Trajectory) -> Projection:
        """Pixels and depths (m) of the points at the samples of a motion."""
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
        """Which of its points a channel is of."""
        return self.points.index((channel.kind, channel.index or 0))


class Sensors(eqx.Module):
    """All that stands between the motion of an arm and its recording."""

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
                    f"its class, which links its columns to it: rename it"
                )

    def of_row(self, kind: str) -> AbstractSensor | None:
        """The sensor that shows a row of the column table, by default as its class makes it.

        None of what camera, markers and angle sensors show.
        """
        if (name := _SENSORS.get(kind)) is None:
            return None
        return self.sensor[name] if name in self.sensor else sensor_named(name)

    def rows(self, kinds: Iterable[str]) -> dict[str, tuple[Callable[[Trajectory], Array], Any]]:
        """What makes the columns of these rows of a motion, and by whose clock; not of pixels."""

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
        """What each camera shows of channels that are of a picture, by its name.

        Raises:
            InputError: as `camera_of`.
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
                # In an order of their own: both coordinates of a point are computed together.
                tuple(sorted(points)),
            )
            for name, points in shown.items()
        }

    def without_clocks(self) -> "Sensors":
        """The same camera, markers and angle sensors, with clocks that are right."""
        lenses = self.camera.pinholes.items()
        on_time = {name: dataclasses.replace(each, delay=None) for name, each in lenses}
        right: dict[str, Any] = {"delay": None, "clock_rate": None}
        camera = dataclasses.replace(self.camera, **right, pinholes=on_time)
        encoder = dataclasses.replace(self.encoder, **right)
        return dataclasses.replace(self, camera=camera, encoder=encoder)

    def with_rows(self, kinds: Iterable[str]) -> "Sensors":
        """With the sensors of these rows of the column table, as far as rows are of some."""
        asked = [_SENSORS[kind] for kind in kinds if kind in _SENSORS]
        new = {name: sensor_named(name) for name in asked if name not in self.sensor}
        # In its order, as JAX has it.
        return dataclasses.replace(self, sensor=dict(sorted((self.sensor | new).items())))

    def check(self, joints: int) -> None:
        """Refuse values for another number of links or joints.

        Raises:
            InputError: naming the parameter and both numbers.
        """
        for name, known in declared(self).items():
            shape = known.value(self).shape
            if known.declaration.per and shape not in ((), (joints,)):
                raise InputError(
                    f"{name} has {np.prod(shape)} values for an arm of {joints} links: give one "
                    "number, or one for each joint"
                )


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
            f"channel {channel.name!r} contains image coordinates, but no camera is described: "
            f"add {section} "
            "with mount, size_px, focal_length_px, position_m and rotation_deg"
        )
    if name is not None and name not in cameras:
        raise InputError(
            f"channel {channel.name!r} belongs to the camera '{name}', which is not described: it "
            f"must "
            f"be {known}, so correct the name or give [camera.{name}]"
        )
    if name is None and len(cameras) > 1:
        raise InputError(
            f"channel {channel.name!r} does not state its camera: begin the name of the channel "
            f"with the name of a camera"
            f", {known}, as in '{next(iter(cameras))}.{channel.name}'"
        )
    if channel.kind == "mark_pixel" and mark_of(channel) not in sensors.landmark:
        raise InputError(
            f"channel {channel.name!r} belongs to a landmark that is not described: state its "
            f"position in "
            f"[landmark.{mark_of(channel)}]"
        )
    return name or next(iter(cameras))


def mark_of(channel: Channel) -> str:
    """The name of the landmark that a channel shows."""
    return f"mark{channel.index or 0:02d}"


def clock_of(sensors: Sensors, name: str) -> Float[Array, ""] | None:
    """How late a camera is, s: as all cameras are, and by itself; None: it is not late."""
    delays = [sensors.camera.delay, sensors.camera.pinholes[name].delay]
    late = [delay for delay in delays if delay is not None]
    return sum(late[1:], late[0]) if late else None


def behind_conditions(
    run: Run, unseen: Mapping[str, tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]]
) -> list[str]:
    """That pixels were recorded of points that the model has behind the camera: a sentence for
    each.

    `unseen` is by channel, at which samples the point is behind the camera, and out of the picture.
    """
    cells: dict[str, list[tuple[str, int]]] = {}
    for name, (behind, _) in unseen.items():
        count = int(np.sum(behind & np.isfinite(run.values[name])))
        if count:
            cells.setdefault(run.channels[name].camera or "", []).append((name, count))
    return [
        f"{'camera ' + camera if camera else 'the camera'}: in '{run.name}' "
        f"{sum(count for _, count in found)} recorded pixels of "
        f"{', '.join(name for name, _ in found)} belong to points that are behind the camera in "
        f"the model: correct the position and rotation of the camera, or the names of the points"
        for camera, found in cells.items()
    ]


Times = Float[Array, " sample"]

Clock = tuple[Scalar | None, Scalar | None]
"""How late a clock is, s, and how slow (`camera.clock_rate`); None: not at all."""


Motion = Callable[[Times, Scalar], Trajectory]
"""The motion at increasing times (s) from the first sample on, simulated until a time (s)."""


def _true_times(times: Times, clock: Clock) -> Times:
    """When samples were taken that a clock stamps with these times, s."""
    delay, rate = clock
    true = times if rate is None else times + rate * (times - times[0])
    return true if delay is None else true - delay


def _seen_by_clocks(
    motion: Motion, times: Times, by: Sequence[Clock]
) -> tuple[list[Trajectory], Bool[Array, ""]]:
    """Motions at the samples of each clock, from one simulation.

    The integrator's own interpolation gives them, at no more error than it has anyway, and with
    the derivative by the clock. Where a clock reaches back before the run, the arm has the rates
    of its first sample (it rests, if it starts at rest); where it reaches beyond the end, the run
    goes on with its last command. Also whether the simulation succeeded.
    """
    first = times[0]
    clocks = [_true_times(times, clock) for clock in by]
    within = [jnp.where(moments < first, first, moments) for moments in clocks]
    together = jnp.concatenate(within)
    order = jnp.argsort(jax.lax.stop_gradient(together))
    # Where the simulation ends changes nothing before it.
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
    """Channels (SI, px) as the sensors show them, and whether the simulation succeeded.

    Times of the samples are in s; names of channels are without unit.
    """
    known = [Channel.named(name) for name in channels]
    pictures = sensors.pictures(known)
    # A camera may be called as a row is.
    shown = sensors.rows({channel.kind for channel in known})
    shown |= {f"camera.{name}": (each.values, each) for name, each in pictures.items()}
    seen, successful = _seen(motion, times, {name: clock for name, (_, clock) in shown.items()})
    # All columns of a row at once, and none of a row that no channel asks for.
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
    """At which samples what a channel is of is behind its camera, and at which out of its picture.

    Channels that are of no picture are left out.
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
    """What each sensor sees, by name; a clock that no channel needs costs nothing."""
    clocks: dict[str, Clock] = {
        name: (getattr(each, "delay", None), getattr(each, "clock_rate", None))
        for name, each in shows.items()
    }
    # Sensors that share a clock see the same.
    known = {tuple(map(id, clock)): clock for clock in clocks.values()}
    if all(part is None for clock in known.values() for part in clock):
        moved = motion(times, times[-1])
        return dict.fromkeys(clocks, moved), moved.successful
    shown, successful = _seen_by_clocks(motion, times, list(known.values()))
    seen = dict(zip(known, shown, strict=True))
    return {name: seen[tuple(map(id, clock))] for name, clock in clocks.items()}, successful
