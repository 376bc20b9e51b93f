"""Model predictive control: the tracker's estimate, a plan of half a minute, and its beginning.

Every half second the arm is linearised about the estimate (with the torque of its memory, its air
and its commands), and rates of the commands are found that bring the tip nearest to where it shall
be over the next 30 s, within their limits: linear model predictive control with re-linearisation
(Rawlings, Mayne and Diehl, Model predictive control, 2nd ed. 2017, chapters 1 and 8). The first
half second of the plan is carried out.
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

# Lengths of the pieces of a plan, in each of which the rates of all commands are constant, s.
_PIECES = np.array([1, 1, 2, 2, 3, 3, 4, 4, 5, 5])
_HORIZON = int(_PIECES.sum())
# Of the quadratic program, which begins with the last plan; from nothing the sum of squares is then
# within a fifth of the least.
_ITERATIONS = 60
_RELAXED = 1.6  # of its steps (Boyd et al. 2011, section 3.4.3)

# What is taken for granted of an arm in a mission, for the tracker: its first state, rad and rad/s,
# how well its stiffness is known, and how much of the air is a mean flow.
_AT_REST = np.deg2rad([0.3, 0.05])
_STIFFNESS = {"joints.pitch_stiffness": 0.2, "joints.yaw_stiffness": 0.2}
_MEAN, _INTENSITY, _LENGTH_SCALE, _DECAY = 0.3, 2.0, 2.0, 12.0
# Of an arm that remembers and leans on things, of which the tracker knows little.
_TORQUES = 20.0
_PLACES = 3  # along the arm, between which gusts are linear


class SteeringMemory(NamedTuple):
    """What a steering controller remembers.

    Attributes:
        state: of the arm, the air and the stiffness at the time of the last picture.
        commands: from the interval before that picture until now, rad, the oldest first.
        plan: the last one, rates of the commands in each of its pieces, rad/s.
        blind: for how long the opening was not seen, s.
        decisions: so far.
        believed: where the camera was then, m.
    """

    state: Gaussian
    commands: Float[Array, "late joint"]
    plan: Float[Array, "piece joint"]
    blind: Scalar
    decisions: Int[Array, ""]
    believed: Float[Array, "3"]


class _Ahead(NamedTuple):
    """Where the arm goes in the next half minute, second by second, as a plan has it.

    Attributes:
        alone: change of angles and rates without a plan, shape (second, 2 joint).
        by_plan: its derivatives by the rates of the plan.
    """

    alone: Float[Array, "second state"]
    by_plan: Float[Array, "second state piece joint"]


class Steering(AbstractController):
    """Model predictive control of the tip over the estimate of a tracker.

    The tracker has the drawn arm without obstacles, with angles, rates, memory, a mean flow and
    gusts, and the stiffness as states; corners of the opening are what it sees. The tip goes
    towards a place before the opening at a speed, and through it once it is near its axis, so that
    the arm is as far from one side of the frame as from the other.

    **Safe state.** Where the opening has not been seen for `patience`, nothing is aimed at any
    more: the plan is that which brings the commands to the approach with the least swing, and they
    stay there. The arm then moves with the air, held back by its damping and its stiffness alone.
    In the opening commands stay as they are. An estimate that is not a number stops all commands at
    once.

    Attributes:
        tracked: the arm as the tracker has it.
        start_at: what is known at the start.
        approach: commanded angles from which the opening is in view, rad.
        rate_limit, angle_limit: of the command of a joint, rad/s and rad.
        pixel: standard deviation of a corner in the picture, px.
        speed: of the tip towards where it shall be, m/s.
        stand_off: distance before the opening at which the tip goes to its axis, m.
        near: distance from the axis within which the tip goes in, m.
        deep: how far inside it goes, m; negative: it stays so far before the opening.
        sure: standard deviation of the tip beyond which it does not go in, m.
        patience: without a picture of the opening, s.
        tip_weight: of a metre off for a second, squared; the unit of the other weights.
        stop_weight: of a speed of 1 m/s of the tip at the end of the plan.
        aim_weight: of the direction of the camera, a radian of which is 2 m.
        posture_weight: of a radian that a command is off the approach at the end of the plan.
        rate_weight: of a command that moves by 1 rad/s for a second.
        every: intervals between two plans.
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
        """Who a `[mission]` says, with the arm as it is drawn.

        Raises:
            InputError: an arm that is not tracked.
        """
        by_hand, stated = Operator.from_section(section, model.arm.count), section.steering
        # Neither what it leans on nor what blows is told.
        air_of_arm: Any = dataclasses.replace(model.arm.air, wind=None, wind_field=None)
        free: Any = dataclasses.replace(model.arm, contact=None, air=air_of_arm)
        model = dataclasses.replace(model, arm=free)
        speed = stated.air_m_per_s
        flow = _MEAN * speed
        # Drag has no slope about still air: some direction to begin with.
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
        """The straight arm at rest, in air that is not known."""
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
        """The estimate by one more picture; a plan where it is time for one; and its beginning."""
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
        """The memory after one more picture, as of `decide`, with the plan as it was."""
        commands = jnp.concatenate([memory.commands[1:], command[None]])
        held = _still_air(scene.interval, commands[:2])
        state = moved(memory.state, *self.tracked.moved(memory.state.mean, held))
        # The first picture that arrives is of the start.
        begun = memory.decisions > len(commands) - 2
        state = jax.tree.map(lambda new, old: jnp.where(begun, new, old), state, memory.state)
        state = self._corrected(scene, state, picture)
        view = scene.camera.view(self.tracked.model.arm, self.tracked.arm_state(state.mean)[0])
        blind = picture.blind(memory.blind, scene.interval)
        decisions = memory.decisions + 1
        return SteeringMemory(state, commands, memory.plan, blind, decisions, view.centre)

    def now(self, scene: Scene, memory: SteeringMemory) -> Gaussian:
        """What the commands since the last picture make of the estimate, which stays as sure."""

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
        """The same, at the stand-off."""
        return dataclasses.replace(self, deep=-self.stand_off)

    def believed(self, scene: Scene, memory: SteeringMemory) -> Float[Array, "3"]:
        """The camera at the time of the last picture."""
        del scene
        return memory.believed

    def _corrected(self, scene: Scene, state: Gaussian, picture: Picture) -> Gaussian:
        """The estimate with the corners of a picture, linearised about it and once more."""
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
            # A corner behind the camera has no pixel.
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
        """Rates of the commands in each piece of a plan that begins now, rad/s.

        Arguments:
            now: what is known of the arm and the air, as of `TrackedArm`.
            command: so far, rad.
            last: the plan before.
            lost: whether it is to lead to the safe state.
        """
        tracked = self.tracked
        arm, rows = tracked.with_parameters(now.mean).arm, tracked.arm_state(now.mean)
        ahead = _looked_ahead(arm, rows, command, tracked.wind(now.mean))
        joints = command.shape[0]

        def shown(angles: Array) -> tuple[Array, Array]:
            """Place of the tip and direction of the camera, in metres."""
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
        # What is lost aims at nothing but the approach.
        aimed = jnp.where(lost, 0.0, 1.0)
        posture = jnp.where(lost, _SAFE, 1.0) * self.posture_weight
        weights = aimed * jnp.repeat(jnp.stack([self.tip_weight, self.aim_weight]), 3)

        angles, by_plan = ahead.alone[:, :joints], ahead.by_plan[:, :joints]
        wanted = jnp.concatenate([places, aims], axis=1) - here[None] - angles @ slope.T
        # At the end of the plan the tip goes on, or stands still.
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
        """Where the tip shall be: before the opening, or the nearer to its axis the deeper.

        The arm comes in at an angle. So that it keeps clear of the frame, the tip goes to a line
        beside the axis: where the tip is at its deepest, the middle of what is inside is on it.

        Arguments:
            local: the tip, as of `Opening.local`, m.
            heading: the direction of the last link along the axes of that.
            spread: standard deviation of the tip, m.
        """
        beside = jnp.maximum(self.deep, 0) / 2 * heading[1:] / jnp.maximum(-heading[0], 0.5)
        most = opening.half / 2
        line = jnp.zeros(3, local.dtype).at[1:].set(jnp.clip(beside, -most, most))
        outside = opening.outside(
            local - line, near=self.near, stand_off=self.stand_off, deep=self.deep
        )
        outside = jnp.where(spread > self.sure, self.stand_off, outside)
        # Where it is inside it stays inside.
        outside = jnp.where(opening.holds(local), -self.deep, outside)
        return opening.centre + opening.frame @ line.at[0].set(outside)

    def _limits(self, command: Array) -> tuple[Array, Array]:
        """Of the rates of a plan; in its first piece also by what is left of the angles."""
        whole = jnp.broadcast_to(self.rate_limit, (len(_PIECES), *command.shape))
        left = [
            jnp.clip(sign * self.angle_limit - command, -self.rate_limit, self.rate_limit)
            for sign in (-1, 1)
        ]
        low, high = (-whole).at[0].set(left[0]), whole.at[0].set(left[1])
        return low.ravel(), high.ravel()


_SAFE = 30.0  # times the weight of the posture, on the way to the safe state
_PIXELS = 1.5  # of the stated deviation of a corner, as the lens is linearised


def _still_air(interval: Scalar, command: Float[Array, "2 joint"]) -> Held:
    return Held(jnp.zeros_like(interval), interval, command, jnp.zeros((2, 3), command.dtype))


def _known_at_first(tracked: TrackedArm, air: Air, values: dict[str, float]) -> Gaussian:
    """Of the straight arm at rest, in air that is not known; values are those of parameters."""
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
    """The motion of half a minute, linearised about the state of the joints, in steps of 1 s."""
    angles, rates, memory = rows[0], rows[1], rows[2:]
    joints = angles.shape[0]

    def pushed(x: Array) -> tuple[Array, Array]:
        strained = memory if memory.shape[0] else None
        found = acceleration(arm, x[0], x[1], x[2], wind, memory=strained)
        return found, found

    now = jnp.stack([angles, rates, command])
    slopes, begun = jax.jacfwd(pushed, has_aux=True)(now)
    # d/dt of how angles and rates differ from those of now, by themselves, the commands and 1.
    flow = jnp.zeros((3 * joints + 1, 3 * joints + 1), angles.dtype)
    flow = flow.at[:joints, joints : 2 * joints].set(jnp.eye(joints, dtype=angles.dtype))
    flow = flow.at[joints : 2 * joints, :-1].set(slopes.reshape(joints, -1))
    flow = flow.at[: 2 * joints, -1].set(jnp.concatenate([rates, begun]))
    step = jax.scipy.linalg.expm(flow)[: 2 * joints]
    of_state, of_command, alone = jnp.split(step, [2 * joints, 3 * joints], axis=1)
    ends = np.cumsum(_PIECES)
    middle = np.arange(_HORIZON)[:, None] + 0.5
    # What each piece's rate adds to the commands in the middle of each second.
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
    """The least |matrix x - values|^2 with low <= x <= high, in a fixed number of iterations.

    The alternating direction method of multipliers (Boyd et al., Foundations and Trends in Machine
    Learning 3 (2011) 1): one decomposition, then two products each. What is returned is within the
    bounds in any case.
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
