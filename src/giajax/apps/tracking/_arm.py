"""State-space model of an arm for the filter: state vector, motion and measurements."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...fitting import Tie, resolved_ties, tied
from ...mechanics.arm import link_centres, mass_matrix
from ...models import ArmModel, recorded_channels
from ...recordings import Channel
from ...runtime.arrays import Array, Float, Scalar, inverse_of_positive, on_device
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import CAMERA, ENCODER
from ...schema.parameters import elements, replace
from ...simulation import RESULTS, Moment, Stepper, Trajectory, check_muscles, constant
from ..synthetic import gust_coherence, gust_spectrum, wind_frame
from ..wind import Turbulence

_DRIVE = ("drive_gain", "drive_lag", "drive_saturation")
_DELAYS = (CAMERA.delay.path, ENCODER.delay.path)


@dataclasses.dataclass(frozen=True)
class Air:
    """Unknown wind: a mean flow with von Karman gusts.

    Attributes:
        wind: initial guess of the mean flow, and standard deviation, length scale and decay
            coefficient of the gusts.
        mean_deviation: initial standard deviation of each component of the mean flow, m/s.
        drift: standard deviation of the drift of each component of the mean flow in 100 s, m/s.
        places: number of places along the arm between which gusts are interpolated linearly; 1 for
            the same gusts along the whole arm.
    """

    wind: Turbulence
    mean_deviation: float
    drift: float = 0.02
    places: int = 1


@dataclasses.dataclass(frozen=True)
class Bias:
    """Constant or slowly varying bias of a sensor.

    Attributes:
        channels: channels that all have the same bias.
        deviation: standard deviation, SI units.
        lasting: correlation time, s; infinite for a constant bias.
    """

    channels: tuple[str, ...]
    deviation: float
    lasting: float = np.inf


class Held(NamedTuple):
    """Known inputs of an interval.

    Attributes:
        time: time of its beginning, s.
        length: length, s.
        command: commanded angles at its beginning and end, rad, shape (2, joint).
        wind: known velocity of the air at its beginning and end, m/s, for the whole arm or for each
            link, shape (2, width).
    """

    time: Scalar
    length: Scalar
    command: Float[Array, "2 joint"]
    wind: Float[Array, "2 width"]


class _Gusts(eqx.Module):
    """Mean flow and gusts as states.

    Attributes:
        along: interpolation weight of each place for each link, shape (link, place).
        frame: directions along the mean flow and across it, as columns.
        lasting: correlation time of the gusts in each direction, s.
        root: square root of the covariance of the gusts at all places, m/s, for each direction.
        walk: random-walk intensity of the mean flow, (m/s)/sqrt(s).
    """

    along: Float[Array, "link place"]
    frame: Float[Array, "3 3"]
    lasting: Float[Array, "3"]
    root: Float[Array, "3 place place"]
    walk: Scalar

    @property
    def places(self) -> int:
        return self.along.shape[1]

    def roots(self) -> np.ndarray:
        """Return the root of the covariance of the gusts, in the order of their states."""
        return np.asarray(jax.scipy.linalg.block_diag(*self.root))

    def of_links(self, mean: Array, gusts: Array) -> Array:
        """Return the velocity at each link, flattened; gusts have the shape (direction, place)."""
        local = self.frame @ gusts + mean[:, None]
        return (self.along @ local.T).ravel()


class TrackedArm(eqx.Module):
    """State-space model of an arm.

    The state vector contains, in this order: angles, rad, rates, rad/s, and hysteresis states of
    the joints; angles reached by lagging drives, rad; mean flow and gusts, m/s; parameters; biases.

    Attributes:
        model: arm and its sensors, without clock errors.
        channels: measured channels.
        noise: standard deviations of the noise of the channels, SI units.
        rows: number of states per joint.
        paths: paths of the parameters in the state vector.
        gusts: mean flow and gusts; None if the wind is not tracked.
        torque: unmodelled torque of each joint, as white noise, N m sqrt(s).
        bias_of: 1 for each channel that a bias is added to, else 0, shape (channel, bias).
        bias_lasting: correlation times of the biases, s.
        bias_deviation: standard deviations of the biases, SI units.
        late: nominal values of `camera.delay` and `encoder.delay`, s, which are already included in
            the times of the measurements.
        ties: ties of parameters that depend on others.
    """

    model: ArmModel
    channels: tuple[str, ...] = eqx.field(static=True)
    noise: Float[Array, " channel"]
    rows: int = eqx.field(static=True)
    paths: tuple[str, ...] = eqx.field(static=True)
    gusts: _Gusts | None
    torque: Scalar
    bias_of: Float[Array, "channel bias"]
    bias_lasting: Float[Array, " bias"]
    bias_deviation: Float[Array, " bias"]
    late: Float[Array, "2"]
    ties: tuple[Tie, ...] = eqx.field(static=True, default=())

    # --- layout of the state vector ---

    @property
    def joints(self) -> int:
        return self.model.arm.count

    @property
    def lags(self) -> bool:
        return self.model.arm.joints.drive_lag is not None

    def sizes(self) -> dict[str, int]:
        """Return the number of states of each part, in the order of the state vector."""
        places = 0 if self.gusts is None else self.gusts.places
        return {
            "arm": self.rows * self.joints,
            "drive": self.joints * self.lags,
            "mean flow": 3 * (places > 0),
            "gusts": 3 * places,
            "parameters": len(self.paths),
            "biases": self.bias_of.shape[1],
        }

    def slices(self) -> dict[str, slice]:
        """Return the position of each part in the state vector."""
        found, begin = {}, 0
        for name, size in self.sizes().items():
            found[name] = slice(begin, begin + size)
            begin += size
        return found

    @property
    def size(self) -> int:
        return sum(self.sizes().values())

    def delay_of(self, path: str) -> float | None:
        """Return the nominal delay, s, if a path is that of a delay; else None."""
        return float(self.late[_DELAYS.index(path)]) if path in _DELAYS else None

    def memory_at(self, vector: np.ndarray, command: np.ndarray) -> Array:
        """Return the arm's state for the angles and rates of a vector, with unstrained joints."""
        count = self.joints
        stepper = Stepper(_without_drives(self.model), on_device(1.0, float))
        check_muscles(stepper.arm, constant(command), None)
        given = (vector[:count], vector[count : 2 * count], command)
        return _begun(stepper, *(on_device(each, float) for each in given))

    def followed(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the angles that drives reach for a constant command, rad.

        The second result is the same angles after the saturation, to which the springs pull.
        """
        gain = self.model.arm.joints.drive_gain
        reached = command if gain is None else command * np.asarray(gain)
        return reached, np.asarray(_saturated(self.model.arm.joints, jnp.asarray(reached)))

    def arm_state(self, vector: Array) -> Array:
        """Return the angles, rates and hysteresis states of a vector, shape (row, joint)."""
        return vector[self.slices()["arm"]].reshape(self.rows, self.joints)

    def wind(self, vector: Array) -> Array | None:
        """Return the unknown velocity of the air at each link, m/s, shape (link, 3)."""
        if self.gusts is None:
            return None
        where = self.slices()
        gusts = vector[where["gusts"]].reshape(3, self.gusts.places)
        return self.gusts.of_links(vector[where["mean flow"]], gusts).reshape(-1, 3)

    def with_parameters(self, vector: Array) -> ArmModel:
        """Return the model with the parameters of a state vector."""
        values = vector[self.slices()["parameters"]]
        known = {
            path: values[index] for index, path in enumerate(self.paths) if path not in _DELAYS
        }
        return tied(replace(self.model, known), self.ties) if known else self.model

    # --- motion ---

    def moved(self, vector: Array, held: Held) -> tuple[Array, Array, Array]:
        """Return the vector after an interval, its derivatives, and the root of the added noise."""
        where, size = self.slices(), self.size
        biases = where["biases"]
        moving = biases.start
        chance = 0 if self.gusts is None else 3 + 3 * self.gusts.places

        def together(both: Array) -> tuple[Array, Array]:
            moved = self._moved(both[:moving], both[moving:], held)
            return moved, moved

        both = jnp.concatenate([vector[:moving], jnp.zeros(chance, vector.dtype)])
        slopes, mean = jax.jacfwd(together, has_aux=True)(both)
        kept = jnp.where(
            jnp.isfinite(self.bias_lasting), jnp.exp(-held.length / self.bias_lasting), 1.0
        )
        slope = jnp.zeros((size, size), vector.dtype)
        slope = slope.at[:moving, :moving].set(slopes[:, :moving])
        slope = slope.at[biases, biases].set(jnp.diag(kept))
        pushed = jnp.zeros((size, self.joints), vector.dtype)
        count = self.joints
        arm = self.with_parameters(vector).arm
        mobility = inverse_of_positive(mass_matrix(arm, vector[:count]))
        push = self.torque * jnp.sqrt(held.length) * mobility
        pushed = pushed.at[count : 2 * count].set(push)
        blown = jnp.zeros((size, chance), vector.dtype).at[:moving].set(slopes[:, moving:])
        spread = jnp.diag(self.bias_deviation * jnp.sqrt(1 - kept**2))
        drifted = jnp.zeros((size, len(kept)), vector.dtype).at[biases].set(spread)
        moved = jnp.concatenate([mean, kept * vector[biases]])
        return moved, slope, jnp.concatenate([pushed, blown, drifted], axis=1)

    def expected(self, vector: Array, held: Held) -> Array:
        """Return the vector after an interval without noise; the biases are not changed."""
        moving = self.slices()["biases"].start
        chance = 0 if self.gusts is None else 3 + 3 * self.gusts.places
        after = self._moved(vector[:moving], jnp.zeros(chance, vector.dtype), held)
        return jnp.concatenate([after, vector[moving:]])

    def _moved(self, vector: Array, chance: Array, held: Held) -> Array:
        where = self.slices()
        model = self.with_parameters(vector)
        joints = model.arm.joints
        command, drive = held.command, vector[where["drive"]]
        if joints.drive_gain is not None:
            command = command * jnp.broadcast_to(joints.drive_gain, (self.joints,))[None]
        if joints.drive_lag is not None:
            lag = jnp.broadcast_to(joints.drive_lag, (self.joints,))
            slope = (command[1] - command[0]) / held.length
            left = jnp.exp(-held.length / jnp.maximum(lag, 1e-3))
            reached = command[1] - lag * slope + (drive - command[0] + lag * slope) * left
            command = jnp.stack([drive, reached])
            drive = reached
        command = _saturated(joints, command)
        flow, gusts = vector[where["mean flow"]], vector[where["gusts"]]
        wind = held.wind
        if self.gusts is not None:
            air = self.gusts
            before = gusts.reshape(3, air.places)
            kept = jnp.exp(-held.length / air.lasting)
            some = jnp.einsum("dij,dj->di", air.root, chance[3:].reshape(3, air.places))
            after = kept[:, None] * before + jnp.sqrt(1 - kept**2)[:, None] * some
            drifted = flow + air.walk * jnp.sqrt(held.length) * chance[:3]
            unknown = jnp.stack([air.of_links(flow, before), air.of_links(drifted, after)])
            known = jnp.tile(wind, (1, self.joints)) if wind.shape[1] == 3 else wind
            wind = known + unknown
            flow, gusts = drifted, after.ravel()
        arm = _without_drives(model)
        state = vector[where["arm"]].reshape(self.rows, self.joints)
        blows = wind.shape[1] > 0
        moment = Moment(held.time, state, command[0], wind[0] if blows else None)
        stepper = Stepper(arm, held.length)
        later = stepper.advance(moment, command[1], wind[1] if blows else None)
        parameters = vector[where["parameters"]]
        return jnp.concatenate([later.state.ravel(), drive, flow, gusts, parameters])

    # --- measurements ---

    def shown(self, vector: Array, held: Held) -> tuple[Array, Array]:
        """Return the channels at the end of an interval, and their derivatives."""

        def both(vector: Array) -> tuple[Array, Array]:
            seen = self._shown(vector, held)
            return seen, seen

        slope, seen = jax.jacfwd(both, has_aux=True)(vector)
        return seen, slope

    def _shown(self, vector: Array, held: Held) -> Array:
        where, model = self.slices(), self.with_parameters(vector)
        motion = self.motion(vector, held, model)
        parameters = vector[where["parameters"]]
        shift = {
            path: parameters[self.paths.index(path)] - nominal
            for path, nominal in zip(_DELAYS, self.late, strict=True)
            if path in self.paths
        }
        sensors = model.sensors
        groups: dict[str, list[str]] = {}
        for name in self.channels:
            groups.setdefault(delay_path(name), []).append(name)
        found: dict[str, Array] = {}
        for path, names in groups.items():
            seen = _earlier(motion, shift[path]) if path in shift else motion
            given = (sensors, lambda times, end, seen=seen: seen, seen.times, tuple(names))
            found |= recorded_channels(*given)[0]
        values = jnp.stack([found[name][0] for name in self.channels])
        return values + self.bias_of @ vector[where["biases"]]

    def motion(self, vector: Array, held: Held, model: ArmModel | None = None) -> Trajectory:
        """Return the motion of the arm at the end of an interval, as one sample."""
        model = self.with_parameters(vector) if model is None else model
        state, wind = self.arm_state(vector), self.wind(vector)
        flow = held.wind[1]
        if wind is not None:
            flow = jnp.tile(flow, self.joints) if flow.shape == (3,) else flow
            flow = flow + wind.ravel()
        joints, drive = model.arm.joints, vector[self.slices()["drive"]]
        if not drive.size:
            gain = 1.0 if joints.drive_gain is None else joints.drive_gain
            drive = held.command[1] * gain
        command = _saturated(joints, drive)
        memory = state[2:]
        return Trajectory(
            times=(held.time + held.length)[None],
            angles=state[0][None],
            rates=state[1][None],
            memory=memory[None] if len(memory) else None,
            pressures=None,
            skin=None,
            arm=_without_drives(model),
            command=constant_signal(command),
            wind=constant_signal(flow) if flow.size else None,
            result=RESULTS.successful,  # type: ignore[arg-type]
            steps=jnp.zeros(2, dtype=int),
        )


@program
def _begun(stepper: Stepper, angles: Array, rates: Array, command: Array) -> Array:
    return stepper.start(angles, rates, command=command).state


def _saturated(joints: Any, angle: Array) -> Array:
    """Return an angle after the saturation of the drives, rad."""
    saturation = joints.drive_saturation
    if saturation is None:
        return angle
    return angle / jnp.sqrt(1 + jnp.broadcast_to(saturation, angle.shape) * angle**2)


def constant_signal(value: Array) -> Any:
    """Return a constant signal; the value can be traced."""
    still = constant(np.zeros(value.shape))
    return dataclasses.replace(still, values=value[None])


def _earlier(motion: Trajectory, by: Scalar) -> Trajectory:
    """Return a motion shifted to an earlier time by some tenths of a second, to second order."""
    slope = motion.accelerations
    return dataclasses.replace(
        motion,
        angles=motion.angles - by * motion.rates + by**2 / 2 * slope,
        rates=motion.rates - by * slope,
    )


def delay_path(name: str) -> str:
    """Return the path of the common delay of a channel; empty if it has its own delay or none."""
    channel = Channel.named(name)
    if channel.quantity in ("length", "pixel"):
        return _DELAYS[0]
    return _DELAYS[1] if channel.kind in ("joint_angle", "joint_rate", "link_angle") else ""


def tracked_arm(
    model: ArmModel,
    channels: Sequence[str],
    noise: Mapping[str, float],
    *,
    air: Air | None = None,
    biases: Sequence[Bias] = (),
    paths: Sequence[str] = (),
    torque: float,
    ties: Mapping[str, str] | None = None,
) -> TrackedArm:
    """Return the state-space model of an arm.

    Arguments:
        model: arm and its sensors.
        channels: measured channels.
        noise: standard deviation of the noise of each channel, SI units.
        air: unknown wind, if any.
        biases: unknown biases of sensors.
        paths: paths of the uncertain parameters, each a single number.
        torque: unmodelled torque of each joint, as white noise, N m sqrt(s).
        ties: path of a parameter that depends on others -> expression, as in a fit.

    Raises:
        InputError: a clock has a rate, a parameter has several elements, a channel belongs to a
            link that the arm does not have, or the arm has obstacles.
    """
    if model.arm.contact is not None:
        raise InputError("the arm has obstacles, which tracking does not support: remove them")
    for name in channels:
        if (Channel.named(name).index or 0) > model.arm.count and "mark" not in name:
            raise InputError(
                f"{name} is measured, but the arm has only {model.arm.count} links: omit the "
                "channel, or give a longer arm"
            )
    sensors = model.sensors
    for path, rate in (
        (CAMERA.clock_rate.path, sensors.camera.clock_rate),
        (ENCODER.clock_rate.path, sensors.encoder.clock_rate),
    ):
        if rate is not None and float(rate):
            raise InputError(
                f"{path} is {float(rate):g}, but tracking needs exact clocks: correct time_s, and "
                "remove this parameter"
            )
    for path in paths:
        if path not in _DELAYS and len(elements(model, path)) != 1:
            raise InputError(f"{path} has several elements: give one of them, such as {path}[0]")
    late = [0.0 if each is None else float(each) for each in _delays(model)]
    bias_of, deviations, lasting = _bias_columns(channels, biases)
    model = dataclasses.replace(model, sensors=sensors.without_clocks())
    begun = eqx.filter_eval_shape(Stepper(_without_drives(model), on_device(1.0, float)).start)
    return TrackedArm(
        model=model,
        channels=tuple(channels),
        noise=jnp.asarray([noise[name] for name in channels], float),
        rows=begun.state.shape[0],
        paths=tuple(paths),
        gusts=None if air is None else _gusts_along(model, air),
        torque=jnp.asarray(torque, float),
        bias_of=jnp.asarray(bias_of, float),
        bias_lasting=jnp.asarray(lasting, float),
        bias_deviation=jnp.asarray(deviations, float),
        late=jnp.asarray(late, float),
        ties=resolved_ties(model, ties or {}) if paths else (),
    )


def _delays(model: ArmModel) -> tuple[Any, Any]:
    return model.sensors.camera.delay, model.sensors.encoder.delay


def _without_drives(model: ArmModel) -> Any:
    without: Any = dict.fromkeys(_DRIVE)
    return dataclasses.replace(model.arm, joints=dataclasses.replace(model.arm.joints, **without))


def _bias_columns(
    channels: Sequence[str], biases: Sequence[Bias]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    columns, deviations, lasting = [], [], []
    for bias in biases:
        column = np.array([name in bias.channels for name in channels], float)
        if not np.any(column):
            raise InputError(
                f"a bias is given for {', '.join(bias.channels)}, which is not measured: remove "
                "this bias"
            )
        columns.append(column)
        deviations.append(bias.deviation)
        lasting.append(bias.lasting)
    table = np.stack(columns, axis=1) if columns else np.zeros((len(channels), 0))
    return table, np.array(deviations, float), np.array(lasting, float)


def _gusts_along(model: ArmModel, air: Air) -> _Gusts:
    """Return the model of the gusts at places along the straight arm, with their covariance."""
    wind, count = air.wind, model.arm.count
    centres = np.asarray(link_centres(model.arm, jnp.zeros(count)))
    along = np.linalg.norm(centres - centres[0], axis=1)
    if air.places < 1 or air.places > count:
        raise InputError(
            f"the number of places at which gusts are tracked is {air.places}: give a number from "
            f"1 to {count}"
        )
    if air.places == 1:
        share, where = np.ones((count, 1)), centres[count // 2][None]
    else:
        ends = np.linspace(along[0], along[-1], air.places)
        share = np.stack([np.interp(along, ends, row) for row in np.eye(air.places)], axis=1)
        where = np.stack([np.interp(ends, along, axis) for axis in centres.T], axis=1)
    direction = wind.mean / wind.speed
    carried: dict[str, Any] = {"speed": wind.speed, "length_scale": wind.length_scale}
    lasts = wind.length_scale / wind.speed
    frequencies = np.geomspace(1e-3, 1e2, 301) / lasts
    together = gust_coherence(where, frequencies, along=direction, decay=wind.decay, **carried)
    roots, lasting = [], []
    for component in range(3):
        deviation = max(wind.deviation * wind.shares[component], 1e-6)
        spectrum = gust_spectrum(frequencies, deviation=1.0, along=component == 0, **carried)
        weights = spectrum * np.gradient(frequencies)
        common = np.tensordot(weights / np.sum(weights), together, axes=1)
        roots.append(deviation * np.linalg.cholesky(common + 1e-9 * np.eye(len(where))))
        # The correlation time gives the von Karman spectrum at zero frequency.
        lasting.append(lasts if component == 0 else lasts / 2)
    return _Gusts(
        along=jnp.asarray(share),
        frame=jnp.asarray(np.stack(wind_frame(direction), axis=1)),
        lasting=jnp.asarray(lasting),
        root=jnp.asarray(np.stack(roots)),
        walk=jnp.asarray(air.drift / np.sqrt(100.0)),
    )
