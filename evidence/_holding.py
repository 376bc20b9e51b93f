"""Other controllers that hold the tip, for comparison with those of `giajax mission`."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from giajax.apps.mission import (
    AbstractController,
    Picture,
    Scene,
    Steering,
    within_limits,
)
from giajax.apps.tracking import Gaussian
from giajax.mechanics.arm import Arm, tip_position
from giajax.runtime.arrays import Array
from giajax.runtime.programs import program
from giajax.simulation import Moment, Stepper


class Still(AbstractController):
    """Command a fixed pose, and hold it."""

    rest: Array
    rate: Array

    def start(self, scene: Scene, late: int) -> Any:
        return scene.opening.centre

    def decide(self, scene: Scene, memory: Any, picture: Picture, command: Array) -> Any:
        rates = (self.rest - command) / scene.interval
        return memory, within_limits(command, rates, scene.interval, self.rate, jnp.asarray(jnp.pi))

    def believed(self, scene: Scene, memory: Any) -> Array:
        return memory


class Scaled(AbstractController):
    """Control joints that move by a multiple of the command, unknown to the controller."""

    steering: Steering
    factor: Array

    def start(self, scene: Scene, late: int) -> Any:
        return self.steering.start(scene, late), jnp.zeros_like(self.steering.approach)

    def decide(self, scene: Scene, memory: Any, picture: Picture, command: Array) -> Any:
        inner, told = memory
        inner, wanted = self.steering.decide(scene, inner, picture, told)
        return (inner, wanted), self.factor * wanted

    def believed(self, scene: Scene, memory: Any) -> Array:
        return self.steering.believed(scene, memory[0])


BEGINS = 60.0  # s, after which the tip is near enough for a linear controller


class AbstractFeedback(AbstractController):
    """Add feedback from the estimate of the tracker to the commands at rest.

    Attributes:
        rest: commands with which the tip of the resting arm is at its target, rad.
    """

    steering: eqx.AbstractVar[Steering]
    rest: eqx.AbstractVar[Array]

    @abc.abstractmethod
    def offset(self, scene: Scene, angles: Array, rates: Array) -> Array:
        """Return the change of the commands, rad, for angles and rates of the joints."""

    def start(self, scene: Scene, late: int) -> Any:
        return self.steering.start(scene, late)

    def decide(self, scene: Scene, memory: Any, picture: Picture, command: Array) -> Any:
        memory = self.steering.estimate(scene, memory, picture, command)
        angles, rates = self.steering.tracked.arm_state(self.steering.now(scene, memory).mean)[:2]
        held = memory.decisions * scene.interval > BEGINS
        offset = jnp.where(held, self.offset(scene, angles, rates), 0)
        moves = (self.rest + offset - command) / scene.interval
        limits = self.steering.rate_limit, self.steering.angle_limit
        return memory, within_limits(command, moves, scene.interval, *limits)

    def believed(self, scene: Scene, memory: Any) -> Array:
        return memory.believed


class ProportionalDerivative(AbstractFeedback):
    """Feedback proportional to the position error and the velocity of the tip."""

    steering: Steering
    rest: Array
    gain: Array
    rate_gain: Array

    def offset(self, scene: Scene, angles: Array, rates: Array) -> Array:
        target = scene.opening.centre + self.steering.stand_off * scene.opening.frame[:, 0]
        tip = tip_position(scene.arm, angles)
        slope = jax.jacfwd(lambda q: tip_position(scene.arm, q))(angles)
        wanted = self.gain * (target - tip) - self.rate_gain * (slope @ rates)
        return slope.T @ jnp.linalg.solve(slope @ slope.T + 1e-3 * jnp.eye(3), wanted)


class LinearQuadraticGaussian(AbstractFeedback):
    """Feedback with a constant gain on angles and rates."""

    steering: Steering
    rest: Array
    gain: Array

    def offset(self, scene: Scene, angles: Array, rates: Array) -> Array:
        return -self.gain @ jnp.concatenate([angles - self.rest, rates])


@program
def flown_knowing(arm: Arm, steering: Steering, scene: Scene, wind: Array, late: int) -> Array:
    """Return tip positions, m, if the controller receives the delayed true state and wind.

    The wind at the links is given as in the tracker: it is linear between the points of the
    tracker.
    """
    tracked, interval = steering.tracked, scene.interval
    stepper = Stepper(arm, interval, tolerance=jnp.asarray(1e-3))
    where, joints = tracked.slices(), arm.count
    gusts = tracked.gusts
    assert gusts is not None
    to_places = jnp.linalg.pinv(gusts.along)

    def vector(moment: Moment) -> Array:
        assert moment.wind is not None
        known = steering.start_at.mean
        known = known.at[where["arm"]].set(moment.state[: tracked.rows].ravel())
        local = gusts.frame.T @ (to_places @ moment.wind.reshape(joints, 3)).T
        return known.at[where["gusts"]].set(local.ravel())

    def row(now: Any, blowing: Array) -> Any:
        moment, vectors, memory = now
        vectors = jnp.concatenate([vectors[1:], vector(moment)[None]])
        commands = jnp.concatenate([memory.commands[1:], moment.command[None]])
        told = Gaussian(vectors[0], jnp.zeros_like(steering.start_at.root))
        memory = memory._replace(state=told, commands=commands, decisions=memory.decisions + 1)
        plan = jax.lax.cond(
            (memory.decisions - 1) % steering.every == 0,
            lambda: steering.plan(
                scene, steering.now(scene, memory), moment.command, memory.plan, jnp.asarray(False)
            ),
            lambda: memory.plan,
        )
        limits = steering.rate_limit, steering.angle_limit
        command = within_limits(moment.command, plan[0], interval, *limits)
        moment = stepper.advance(moment, command, blowing)
        return (moment, vectors, memory._replace(plan=plan)), tip_position(arm, moment.angles)

    begun = stepper.start(wind=wind[0])
    vectors = jnp.broadcast_to(vector(begun), (late + 1, tracked.size))
    return jax.lax.scan(row, (begun, vectors, steering.start(scene, late)), wind[1:])[1]
