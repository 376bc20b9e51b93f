"""Model predictive control of the tip over a horizon of 30 s, from the estimate of the tracker.

Every half second, the equation of motion of the arm is linearised about the estimate, which
includes the hysteretic torque, the wind and the commands. The controller then finds the rates of
the commands, within their limits, that keep the tip nearest to its reference over the next 30 s.
This is linear model predictive control with re-linearisation (Rawlings, Mayne and Diehl, Model
predictive control, 2nd ed. 2017, chapters 1 and 8). The first half second of the plan is executed.
"""

import dataclasses
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...mechanics.arm import Arm, acceleration, pose, tip_position
from ...models import ArmModel, parameter_values
from ...runtime.arrays import Array, Bool, Float, Int, Scalar, safe_norm
from ...schema import MissionSection
from ..tracking import Air, Gaussian, Held, TrackedArm, measured, moved, tracked_arm, usual_torque
from ..wind import first_guess
from ._controller import METRES, AbstractController, Opening, Picture, Scene, number, within_limits
from ._operator import Operator

# Lengths of the intervals (pieces) of a plan, in each of which all rates are constant, s.
_PIECES = np.array([1, 1, 2, 2, 3, 3, 4, 4, 5, 5])
_HORIZON = int(_PIECES.sum())
# Iterations of the quadratic program, which starts from the last plan. If it starts from zero, the
# sum of squares is within a fifth of its minimum after this number.
_ITERATIONS = 60
_RELAXED = 1.6  # over-relaxation of its steps (Boyd et al. 2011, section 3.4.3)

# Assumptions of the tracker about an arm in a mission: standard deviations of the initial angles
# and rates, rad and rad/s, relative standard deviations of the stiffness, and properties of the
# wind: mean flow relative to the wind speed, gust intensity, length scale, m, and decay
# coefficient.
_AT_REST = np.deg2rad([0.3, 0.05])
_STIFFNESS = {"joints.pitch_stiffness": 0.2, "joints.yaw_stiffness": 0.2}
_MEAN, _INTENSITY, _LENGTH_SCALE, _DECAY = 0.3, 2.0, 2.0, 12.0
# Factor of the usual disturbance torque, because the tracker does not know the contacts of the arm
# and knows its hysteresis only roughly.
_TORQUES = 20.0
_PLACES = 3  # number of places along the arm between which gusts are interpolated linearly


class SteeringMemory(NamedTuple):
    """Internal state of a steering controller.

    Attributes:
        state: estimate of the arm, the wind and the stiffness at the time of the last picture.
        commands: commands from the interval before that picture until now, rad, the oldest first.
        plan: last plan, as the rates of the commands in each piece, rad/s.
        blind: time since the opening was last visible, s.
        decisions: number of decisions so far.
        believed: estimated position of the camera at the time of the last picture, m.
    """

    state: Gaussian
    commands: Float[Array, "late joint"]
    plan: Float[Array, "piece joint"]
    blind: Scalar
    decisions: Int[Array, ""]
    believed: Float[Array, "3"]


class _Ahead(NamedTuple):
    """Predicted motion of the arm over the next 30 s, in steps of 1 s, as a function of the plan.

    Attributes:
        alone: change of angles and rates without a plan, shape (second, 2 joint).
        by_plan: derivatives of this change with respect to the rates of the plan.
    """

    alone: Float[Array, "second state"]
    by_plan: Float[Array, "second state piece joint"]


class Steering(AbstractController):
    """Model predictive control of the tip from the estimate of a tracker.

    The tracker uses the nominal arm without obstacles. Its states are angles, rates, hysteresis, a
    mean flow, gusts and the stiffness. Its measurements are the corners of the opening. The tip
    moves at a given speed to a point in front of the opening. Near the axis it enters, along a line
    that keeps the arm in the middle of the frame.

    **Safe state.** If the opening has been out of view for `patience`, the controller abandons the
    target: its plans bring the commands to the approach with the least swing, and keep them there.
    The arm then moves with the air, and only its damping and stiffness restrain it. Inside the
    opening, all commands are held constant instead. An estimate that is not a number stops all
    commands immediately.

    Attributes:
        tracked: arm as modelled by the tracker.
        start_at: estimate at the start.
        approach: commanded angles from which the opening is in view, rad.
        rate_limit, angle_limit: largest rate and angle of the command of a joint, rad/s and rad.
        pixel: standard deviation of a corner in the picture, px.
        speed: speed of the reference of the tip, m/s.
        stand_off: distance in front of the opening at which the tip moves to its axis, m.
        near: distance from the axis within which the tip enters, m.
        deep: depth to which the tip enters, m; if negative, distance at which it stays in front of
            the opening.
        sure: largest standard deviation of the tip position at which it enters, m.
        patience: longest time without the opening in view, s.
        tip_weight: weight of a squared tip error of 1 m^2 for 1 s; unit of the other weights.
        stop_weight: weight of a squared error of the tip velocity of 1 m^2/s^2 at the end of the
            plan.
        aim_weight: weight of the direction of the camera, for which one radian equals 2 m.
        posture_weight: weight of a squared distance of a command from the approach of 1 rad^2 at
            the end of the plan.
        rate_weight: weight of a squared rate of a command of 1 rad^2/s^2 for 1 s.
        every: number of intervals between two plans.
    """

    tracked: TrackedArm
    start_at: Gaussian
    approach: Float[Array, " joint"]
    rate_limit: Scalar = number(np.deg2rad(2.0))
    angle_limit: Scalar = number(np.deg2rad(60.0))
    pixel: Scalar = number(1.5)
    speed: Scalar = number(0.4)
    stand_off: Scalar = number(2.5)
    near: Scalar = number(0.5)
    deep: Scalar = number(1.0)
    sure: Scalar = number(0.5)
    patience: Scalar = number(20.0)
    tip_weight: Scalar = number(1.0)
    stop_weight: Scalar = number(20.0)
    aim_weight: Scalar = number(0.05)
    posture_weight: Scalar = number(0.3)
    rate_weight: Scalar = number(3.0)
    every: int = eqx.field(static=True, default=5)

    @classmethod
    def from_section(cls, section: MissionSection, model: ArmModel) -> Self:
        """Return the controller of a `[mission]` table, for the nominal arm.

        Raises:
            InputError: the tracker does not support the arm.
        """
        by_hand, stated = Operator.from_section(section, model.arm.count), section.steering
        # The controller knows neither the contacts nor the wind.
        air_of_arm: Any = dataclasses.replace(model.arm.air, wind=None, wind_field=None)
        free: Any = dataclasses.replace(model.arm, contact=None, air=air_of_arm)
        model = dataclasses.replace(model, arm=free)
        speed = stated.air_m_per_s
        flow = _MEAN * speed
        # The derivative of the drag is zero in still air, so start with a flow in some direction.
        guess = first_guess((flow, flow, 0.0), _INTENSITY, _LENGTH_SCALE, _DECAY)
        air = Air(guess, flow, places=min(_PLACES, model.arm.count))
        torque = _TORQUES * usual_torque(model)
        values = parameter_values(model)
        paths = tuple(path for path in _STIFFNESS if np.ndim(values.get(path, [0])) == 0)
        tracked = tracked_arm(model, (), {}, air=air, paths=paths, torque=torque)
        return cls(
            tracked=tracked,
            start_at=_known_at_first(tracked, air, {path: float(values[path]) for path in paths}),
            approach=by_hand.approach,
            rate_limit=by_hand.largest_rate,
            angle_limit=by_hand.largest_angle,
            patience=by_hand.patience,
            deep=by_hand.deep,
            pixel=jnp.asarray(_PIXELS * section.operator.pixel_px),
            speed=jnp.asarray(stated.speed_m_per_s),
            stand_off=jnp.asarray(stated.stand_off_m),
        )

    def start(self, scene: Scene, late: int) -> SteeringMemory:
        """Return the memory of a straight arm at rest in an unknown wind."""
        zero = jnp.zeros_like(self.approach)
        return SteeringMemory(
            self.start_at,
            jnp.zeros((late + 2, zero.shape[0]), zero.dtype),
            jnp.zeros((len(_PIECES), zero.shape[0]), zero.dtype),
            jnp.zeros_like(scene.interval),
            jnp.zeros((), int),
            scene.camera.view(self.tracked.model.arm, zero).centre,
        )

    def decide(
        self, scene: Scene, memory: SteeringMemory, picture: Picture, command: Array
    ) -> tuple[SteeringMemory, Float[Array, " joint"]]:
        """Update the estimate with a picture, plan again if due, and apply the plan."""
        again = memory.decisions % self.every == 0
        memory = self.estimate(scene, memory, picture, command)
        plan = jax.lax.cond(
            again,
            lambda: self.plan(
                scene, self.now(scene, memory), command, memory.plan, memory.blind > self.patience
            ),
            lambda: memory.plan,
        )
        sound = jnp.all(jnp.isfinite(memory.state.mean)) & jnp.all(jnp.isfinite(memory.state.root))
        rates = jnp.where(sound, plan[0], 0)
        limits = self.rate_limit, self.angle_limit
        after = within_limits(command, rates, scene.interval, *limits)
        return memory._replace(plan=plan), after

    def estimate(
        self, scene: Scene, memory: SteeringMemory, picture: Picture, command: Array
    ) -> SteeringMemory:
        """Return the memory after one more picture, with an unchanged plan; see `decide`."""
        commands = jnp.concatenate([memory.commands[1:], command[None]])
        held = _still_air(scene.interval, commands[:2])
        state = moved(memory.state, *self.tracked.moved(memory.state.mean, held))
        # The first picture that arrives was taken at the start.
        begun = memory.decisions > len(commands) - 2
        state = jax.tree.map(lambda new, old: jnp.where(begun, new, old), state, memory.state)
        state = self._corrected(scene, state, picture)
        view = scene.camera.view(self.tracked.model.arm, self.tracked.arm_state(state.mean)[0])
        blind = picture.blind(memory.blind, scene.interval)
        decisions = memory.decisions + 1
        return SteeringMemory(state, commands, memory.plan, blind, decisions, view.centre)

    def now(self, scene: Scene, memory: SteeringMemory) -> Gaussian:
        """Propagate the mean with the commands since the last picture; the covariance is kept."""

        def moved_on(vector: Array, given: tuple[Array, Array]) -> tuple[Array, None]:
            command, begun = given
            after = self.tracked.expected(vector, _still_air(scene.interval, command))
            return jnp.where(begun, after, vector), None

        since = jnp.stack([memory.commands[1:-1], memory.commands[2:]], axis=1)
        # Nothing moved before the start.
        begun = jnp.arange(len(since)) > len(since) - memory.decisions
        mean = jax.lax.scan(moved_on, memory.state.mean, (since, begun))[0]
        return Gaussian(mean, memory.state.root)

    def keeping_station(self) -> Self:
        """Return the same controller with the stand-off as its target."""
        return dataclasses.replace(self, deep=-self.stand_off)

    def believed(self, scene: Scene, memory: SteeringMemory) -> Float[Array, "3"]:
        """Return the estimated position of the camera at the time of the last picture, m."""
        del scene
        return memory.believed

    def _corrected(self, scene: Scene, state: Gaussian, picture: Picture) -> Gaussian:
        """Correct the estimate with the corners of a picture, by two linearisations."""
        tracked = self.tracked

        def pixels(vector: Array) -> tuple[Array, Array]:
            view = scene.camera.view(tracked.model.arm, tracked.arm_state(vector)[0])
            shown = scene.camera.project_from(view, scene.opening.corners).pixels.reshape(-1)
            return shown, shown

        there = jnp.repeat(picture.seen, 2, total_repeat_length=8)
        noise = jnp.broadcast_to(self.pixel, (8,))
        every = jnp.ones(state.mean.shape[0], bool)
        after = state
        for _ in range(2):
            at = after.mean
            slope, shown = jax.jacfwd(pixels, has_aux=True)(at)
            # A corner behind the camera has no pixel position.
            slope = jnp.where(there[:, None], slope, 0)
            off = jnp.where(there, picture.pixels.reshape(-1) - shown, 0)
            off = off - slope @ (state.mean - at)
            after = measured(state, off, slope, noise, there=there, used=there, estimated=every)[0]
        return after

    def plan(
        self,
        scene: Scene,
        now: Gaussian,
        command: Float[Array, " joint"],
        last: Float[Array, "piece joint"],
        lost: Bool[Array, ""],
    ) -> Float[Array, "piece joint"]:
        """Return the rates of the commands in each piece of a plan that begins now, rad/s.

        Arguments:
            scene: information from before the start.
            now: estimate of the arm and the wind, with the states of `TrackedArm`.
            command: current commands, rad.
            last: previous plan.
            lost: whether the plan must lead to the safe state.
        """
        tracked = self.tracked
        arm, rows = tracked.with_parameters(now.mean).arm, tracked.arm_state(now.mean)
        ahead = _looked_ahead(arm, rows, command, tracked.wind(now.mean))
        joints = command.shape[0]

        def shown(angles: Array) -> tuple[Array, Array]:
            """Return the position of the tip and the scaled direction of the camera, m."""
            view = scene.camera.view(arm, angles)
            found = jnp.concatenate([tip_position(arm, angles), METRES * view.axes[:, 2]])
            return found, found

        slope, here = jax.jacfwd(shown, has_aux=True)(rows[0])
        tip = here[:3]
        spread = safe_norm((slope[:3] @ now.root[:joints]).ravel())
        local = scene.opening.local(tip)
        inside = scene.opening.holds(local)
        heading = scene.opening.frame.T @ pose(arm, rows[0]).direction[:, -1]
        gap = self._target(scene.opening, local, heading, spread) - tip
        far = safe_norm(gap)
        towards = gap / jnp.maximum(far, 1e-9)
        seconds = jnp.arange(1, _HORIZON + 1, dtype=tip.dtype)[:, None]
        places = tip[None] + jnp.minimum(self.speed * seconds, far) * towards[None]
        aim = scene.opening.ahead - tip
        aims = jnp.broadcast_to(METRES * aim / safe_norm(aim), places.shape)
        # If the opening is lost, the only target is the approach.
        aimed = jnp.where(lost, 0.0, 1.0)
        posture = jnp.where(lost, _SAFE, 1.0) * self.posture_weight
        weights = aimed * jnp.repeat(jnp.stack([self.tip_weight, self.aim_weight]), 3)

        angles, by_plan = ahead.alone[:, :joints], ahead.by_plan[:, :joints]
        wanted = jnp.concatenate([places, aims], axis=1) - here[None] - angles @ slope.T
        # At the end of the plan, the tip continues at its speed or is at rest.
        goes_on = aimed * jnp.where(far > self.speed * _HORIZON, self.speed, 0) * towards
        last_rates = rows[1] + ahead.alone[-1, joints:]
        lengths = jnp.asarray(_PIECES, tip.dtype)
        each = jnp.eye(joints, dtype=tip.dtype)
        rows_of = (
            (weights[None], wanted, jnp.einsum("oj,sjpk->sopk", slope, by_plan)),
            (
                self.stop_weight, goes_on - slope[:3] @ last_rates,
                jnp.einsum("oj,jpk->opk", slope[:3], ahead.by_plan[-1, joints:]),
            ),
            (
                posture, self.approach - command,
                jnp.einsum("p,jk->jpk", lengths, each),
            ),
            (
                self.rate_weight * lengths[:, None], jnp.zeros_like(last),
                jnp.einsum("pq,jk->pjqk", jnp.eye(len(_PIECES), dtype=tip.dtype), each),
            ),
        )  # fmt: skip
        matrix, values = [], []
        for weight, wants, by in rows_of:
            root = jnp.broadcast_to(jnp.sqrt(weight), wants.shape).ravel()
            matrix.append(root[:, None] * by.reshape(-1, last.size))
            values.append(root * wants.ravel())
        low, high = self._limits(command)
        found = box_least_squares(
            jnp.concatenate(matrix), jnp.concatenate(values), low, high, last.ravel(), _ITERATIONS
        ).reshape(last.shape)
        stopped = (lost & inside) | ~jnp.all(jnp.isfinite(found))
        return jnp.where(stopped, 0, found)

    def _target(
        self,
        opening: Opening,
        local: Float[Array, "3"],
        heading: Float[Array, "3"],
        spread: Scalar,
    ) -> Float[Array, "3"]:
        """Return the target of the tip: in front of the opening, or deeper, nearer to its axis.

        The arm enters at an angle. To keep clear of the frame, the tip moves along a line beside
        the axis. At the largest depth, the middle of the part inside is then on the axis.

        Arguments:
            opening: opening to enter.
            local: position of the tip from `Opening.local`, m.
            heading: direction of the last link along the axes of the opening.
            spread: standard deviation of the tip position, m.
        """
        beside = jnp.maximum(self.deep, 0) / 2 * heading[1:] / jnp.maximum(-heading[0], 0.5)
        most = opening.half / 2
        line = jnp.zeros(3, local.dtype).at[1:].set(jnp.clip(beside, -most, most))
        outside = opening.outside(
            local - line, near=self.near, stand_off=self.stand_off, deep=self.deep
        )
        outside = jnp.where(spread > self.sure, self.stand_off, outside)
        # A tip that is inside the opening stays inside it.
        outside = jnp.where(opening.holds(local), -self.deep, outside)
        return opening.centre + opening.frame @ line.at[0].set(outside)

    def _limits(self, command: Array) -> tuple[Array, Array]:
        """Return the bounds of the rates; those of the first piece also limit the angles."""
        whole = jnp.broadcast_to(self.rate_limit, (len(_PIECES), *command.shape))
        left = [
            jnp.clip(sign * self.angle_limit - command, -self.rate_limit, self.rate_limit)
            for sign in (-1, 1)
        ]
        low, high = (-whole).at[0].set(left[0]), whole.at[0].set(left[1])
        return low.ravel(), high.ravel()


_SAFE = 30.0  # factor of the weight of the posture on the way to the safe state
_PIXELS = 1.5  # factor of the given standard deviation of a corner, because the lens is linearised


def _still_air(interval: Scalar, command: Float[Array, "2 joint"]) -> Held:
    return Held(jnp.zeros_like(interval), interval, command, jnp.zeros((2, 3), command.dtype))


def _known_at_first(tracked: TrackedArm, air: Air, values: dict[str, float]) -> Gaussian:
    """Return the initial estimate of a straight arm at rest in an unknown wind.

    `values` are the nominal values of the estimated parameters.
    """
    assert tracked.gusts is not None
    where, joints = tracked.slices(), tracked.joints
    mean, size = np.zeros(tracked.size), np.zeros(tracked.size)
    size[: 2 * joints] = np.repeat(_AT_REST, joints)
    mean[where["parameters"]] = list(values.values())
    size[where["parameters"]] = [_STIFFNESS[path] * value for path, value in values.items()]
    size[where["mean flow"]] = air.mean_deviation
    root = np.diag(size)
    root[where["gusts"], where["gusts"]] = tracked.gusts.roots()
    return Gaussian(jnp.asarray(mean), jnp.asarray(root))


def _looked_ahead(arm: Arm, rows: Array, command: Array, wind: Array | None) -> _Ahead:
    """Predict the motion over 30 s, linearised about the state of the joints, in steps of 1 s."""
    angles, rates, memory = rows[0], rows[1], rows[2:]
    joints = angles.shape[0]

    def pushed(x: Array) -> tuple[Array, Array]:
        strained = memory if memory.shape[0] else None
        found = acceleration(arm, x[0], x[1], x[2], wind, memory=strained)
        return found, found

    now = jnp.stack([angles, rates, command])
    slopes, begun = jax.jacfwd(pushed, has_aux=True)(now)
    # Time derivatives of the changes of angles and rates since now, as a linear function of these
    # changes, of the changes of the commands, and of 1.
    flow = jnp.zeros((3 * joints + 1, 3 * joints + 1), angles.dtype)
    flow = flow.at[:joints, joints : 2 * joints].set(jnp.eye(joints, dtype=angles.dtype))
    flow = flow.at[joints : 2 * joints, :-1].set(slopes.reshape(joints, -1))
    flow = flow.at[: 2 * joints, -1].set(jnp.concatenate([rates, begun]))
    step = jax.scipy.linalg.expm(flow)[: 2 * joints]
    of_state, of_command, alone = jnp.split(step, [2 * joints, 3 * joints], axis=1)
    ends = np.cumsum(_PIECES)
    middle = np.arange(_HORIZON)[:, None] + 0.5
    # Contribution of the rate of each piece to the commands in the middle of each second.
    shares = np.clip(middle - (ends - _PIECES)[None], 0, _PIECES[None])

    def second(before: _Ahead, share: Array) -> tuple[_Ahead, _Ahead]:
        after = _Ahead(
            of_state @ before.alone + alone[:, 0],
            jnp.einsum("ij,jpk->ipk", of_state, before.by_plan)
            + of_command[:, None, :] * share[None, :, None],
        )
        return after, after

    still = _Ahead(
        jnp.zeros(2 * joints, angles.dtype),
        jnp.zeros((2 * joints, len(_PIECES), joints), angles.dtype),
    )
    return jax.lax.scan(second, still, jnp.asarray(shares, angles.dtype))[1]


def box_least_squares(
    matrix: Float[Array, "row x"],
    values: Float[Array, " row"],
    low: Float[Array, " x"],
    high: Float[Array, " x"],
    start: Float[Array, " x"],
    iterations: int,
) -> Float[Array, " x"]:
    """Minimise |matrix x - values|^2 with low <= x <= high, in a fixed number of iterations.

    This is the alternating direction method of multipliers (Boyd et al., Foundations and Trends in
    Machine Learning 3 (2011) 1), with one matrix factorisation. The result is always within the
    bounds.
    """
    hessian, slope = matrix.T @ matrix, matrix.T @ values
    penalty = jnp.exp(jnp.mean(jnp.log(jnp.diag(hessian))))
    factor = jnp.linalg.cholesky(hessian + penalty * jnp.eye(len(slope), dtype=slope.dtype))

    def step(_: Any, before: tuple[Array, Array]) -> tuple[Array, Array]:
        inside, dual = before
        x = jax.scipy.linalg.cho_solve((factor, True), slope + penalty * (inside - dual))
        x = _RELAXED * x + (1 - _RELAXED) * inside
        inside = jnp.clip(x + dual, low, high)
        return inside, dual + x - inside

    begun = jnp.clip(start, low, high), jnp.zeros_like(slope)
    return jax.lax.fori_loop(0, iterations, step, begun)[0]
