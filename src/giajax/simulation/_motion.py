"""Equation of motion as used by integrators, and its stiff part."""

import dataclasses
import functools
import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..mechanics.arm import (
    AbstractJointLaw,
    Arm,
    JointLaws,
    JointState,
    Spring,
    Stiffness,
    bodies,
    contact_stiffness,
    forward_dynamics,
    lift,
    mass_matrix,
    touch,
)
from ..runtime.arrays import Array, Float, Scalar
from ..runtime.programs import traced_once
from ._signal import Followed, Pressures, Signal


class Rates(NamedTuple):
    """Rates (1/s) of the fastest motions of an arm: of all, and of those treated explicitly."""

    all: Scalar
    explicit: Scalar


def fastest_rate(
    arm: Arm,
    angles: Float[Array, " joint"],
    command: Float[Array, " joint"] | None = None,
    *,
    pressures: Float[Array, "2 joint"] | None = None,
    springs: bool = True,
    mobility: Float[Array, "joint joint"] | None = None,
) -> Scalar:
    """Return the rate of the fastest motion due to springs, dampers, gravity and lags, 1/s.

    The rate is evaluated at the given angles (rad). The command (rad) defaults to these angles, and
    the pressures (Pa) default to the pressures of the controller. Without `springs`, only gravity
    is considered, without springs, dampers and the lag of muscles. With `mobility`, the inverse of
    the mass matrix, an inexpensive upper bound is returned.
    """
    # Step sizes are not differentiated.
    of_these = (arm, angles, command, pressures)
    arm, angles, command, pressures = jax.lax.stop_gradient(of_these)
    if mobility is None:
        factor = jnp.linalg.cholesky(mass_matrix(arm, angles))

    def largest(strength: Array) -> Array:
        """Return the square root of the largest eigenvalue of M^-1 diag(strength)."""
        roots = jnp.sqrt(jnp.broadcast_to(strength, (arm.count,)))
        if mobility is not None:
            return jnp.sqrt(jnp.max(roots * (jnp.abs(mobility) @ roots)))
        root = jnp.diag(roots)
        return jnp.linalg.norm(jax.scipy.linalg.solve_triangular(factor, root, lower=True), 2)

    # Gravity also causes oscillations of a hanging arm. An upper bound of its stiffness is the sum
    # of the weights times their distances.
    ends = jnp.cumsum(arm.links.length)
    reach = jnp.triu(ends[None, :] - (ends - arm.links.length)[:, None])
    weights = arm.gravity * bodies(arm).mass
    upwards = lift(arm)
    weights = jnp.abs(weights if upwards is None else weights - upwards)
    hanging = reach @ weights
    if not springs:
        return largest(hanging)
    laws = arm.joint_laws
    command = angles if command is None else command
    at = laws.at(angles, jnp.zeros_like(angles), command, pressures=pressures)
    stiffest, (_, damping) = laws.stiffest(at), laws.slopes(at)
    # An instability grows as fast as a stable motion would oscillate.
    rate = jnp.hypot(largest(jnp.abs(stiffest) + hanging), largest(jnp.abs(damping)) ** 2)
    if laws.rows:
        of_muscles = arm.joints.further_laws.rows
        for rows in jnp.split(laws.state_slopes(at)[2], [of_muscles]):
            if len(rows):
                rate = jnp.hypot(rate, jnp.max(rows))
    return rate


class Given(NamedTuple):
    """Values of all inputs of an arm at one time; None for an input that does not exist.

    Attributes:
        command: angles towards which the drives pull, rad.
        pressures: pressures supplied to the muscles, by the run or by their controller, Pa.
        wind: velocity of the air, m/s, and its rate of change, m/s^2.
        torque: torque of the joints' drives, N m.
    """

    command: Float[Array, " joint"]
    pressures: Float[Array, "2 joint"] | None
    wind: tuple[Array, Array] | None
    torque: Float[Array, " joint"] | None


class Inputs(eqx.Module):
    """The arm and the inputs that move it.

    Attributes:
        arm: the arm.
        command: angles towards which the drives pull over time, rad.
        wind: velocity of the air over time, m/s, for the whole arm or for each link; None for still
            air.
        torque: torque of the joints' drives over time, N m, or None.
        end: last time before the end of the motion, s.
        pressure: pressures supplied to muscles over time; None if their controller supplies them.
        begin: time of a wind field that corresponds to time 0, s; None for 0.
        first: time at which drifting parameters have their initial values, s; None for 0.
        since: start time of the current step, s, and the state at that time, if laws have
            rate-independent states.
        known: values of the inputs at the time of the next calls, if they are known.
    """

    arm: Arm
    command: Followed
    wind: Signal | None
    torque: Signal | None
    end: Scalar
    pressure: Pressures | None = None
    begin: Scalar | None = None
    first: Scalar | None = None
    since: "tuple[Scalar, State] | None" = None
    known: Given | None = None

    def given(self, time: Any) -> Given:
        """Return the values of the inputs at a time."""
        if self.known is not None:
            return self.known
        command = self.command(time)
        pressures, driven = self.supplied(time, command), self.arm.further_laws.driven
        if pressures is None and driven is not None:
            pressures = driven.commanded(command)
        wind = None
        if self.wind is not None:
            air, gust = self.wind(time), self.wind.rate(time)
            wind = along_links(self.arm, air), along_links(self.arm, gust)
        return Given(command, pressures, wind, None if self.torque is None else self.torque(time))

    def arm_at(self, time: Any) -> Arm:
        """Return the arm with the drifted parameters at a time."""
        arm, afloat = self.arm, self.arm.buoyancy
        filled = afloat is None or afloat.imbalance_drift is None
        if filled and arm.joints.stiffness_drift is None:
            return arm
        since = time if self.begin is None else self.begin + time
        since = since if self.first is None else since - self.first
        lifted = None if afloat is None else afloat.at_time(since)
        return dataclasses.replace(arm, joints=arm.joints.at_time(since), buoyancy=lifted)

    def parts(self, state: "State") -> "Parts":
        """Split a state into its parts."""
        memory = 2 + self.arm.further_laws.rows
        return Parts(state[0], state[1], state[2:memory], state[memory:])

    def follows(self, law: AbstractJointLaw) -> bool:
        """Return whether the states of a law follow the path of its joint within the step."""
        return self.since is not None and law.slides

    def followed(self, time: Any, state: "State") -> "State":
        """Return the state with rate-independent states updated along the path within the step.

        The turning points of the joints are computed from the cubic through both ends. The torque
        has no corner in time, because the rate is 0 at a turning point.
        """
        if self.since is None:
            return state
        began, before = self.since
        laws, way = self.arm.further_laws, way_between(time - began, before, state)
        last = 2 + laws.rows
        memory = laws.followed(way, before[2:last], state[2:last])
        return jnp.concatenate([state[:2], memory, state[last:]])

    def at(
        self, laws: JointLaws, time: Any, angles: Array, rates: Array, states: Array | None
    ) -> JointState:
        """Return the joint states seen by laws; by default at the beginning of a motion."""
        given = self.given(time)
        return laws.at(angles, rates, given.command, states, given.pressures)

    def supplied(self, time: Any, command: Array) -> Float[Array, "2 joint"] | None:
        """Return the pressures (Pa) of the run; None if the controller supplies all of them."""
        return None if self.pressure is None else self.pressure.at(self.arm, time, command)

    def inside(self, time: Any, memory: Array) -> Float[Array, "2 joint"] | None:
        """Return the pressures (Pa) in the muscles for given states; None without muscles."""
        laws, still = self.arm.further_laws, jnp.zeros(self.arm.count, memory.dtype)
        parts = laws.each(self.at(laws, time, still, still, memory))
        return next((law.inside(own) for law, own in parts if law.takes_pressures), None)

    def start(self, state: Float[Array, "2 joint"], time: Scalar) -> "State":
        """Return the initial state, in which nothing is strained and the pressures have settled."""
        rows = [state, self.at(self.arm.further_laws, time, state[0], state[1], None).states]
        if self.arm.contact is not None:
            rows.append(jnp.zeros((self.arm.contact.rows, self.arm.count), state.dtype))
        return jnp.concatenate(rows)


State = Float[Array, "row joint"]
"""State of the joints: angles (rad), rates (rad/s), and further states.

These are the states of joint laws with memory and of lagging pressures, and the stretch of the skin
at contacts with friction.
"""


class Parts(NamedTuple):
    """Parts of a `State`."""

    angles: Float[Array, " joint"]
    rates: Float[Array, " joint"]
    memory: Float[Array, "memory joint"]
    skin: Float[Array, "skin joint"]


@traced_once
def motion(time: Any, state: State, inputs: Inputs) -> State:
    """Return the rates and accelerations of the joints, and the derivatives of the other states."""
    # A jump exactly at the end does not belong to the motion, and the step-size control must not
    # bisect it.
    time = jnp.minimum(time, inputs.end)
    angles, rates, memory, skin = inputs.parts(inputs.followed(time, state))
    arm, given = inputs.arm_at(time), inputs.given(time)
    laws = arm.joint_laws
    at = laws.at(angles, rates, given.command, memory, given.pressures)
    air, gust = (None, None) if given.wind is None else given.wind
    torque = laws.torque(at)
    if given.torque is not None:
        torque = torque + given.torque
    met = None if arm.contact is None else touch(arm, angles, rates, skin if skin.size else None)
    if met is not None:
        torque = torque + met.torque
    clock = time if inputs.begin is None else inputs.begin + time
    moved = forward_dynamics(arm, angles, rates, torque, air, gust, clock)
    rows = [rates[None], moved[None], laws.rate(at)]
    if met is not None and skin.size:
        rows.append(met.slip)
    return jnp.concatenate(rows)


def turns(
    step: Any, y0: Float[Array, "row joint"], y1: Float[Array, "row joint"]
) -> Float[Array, "2 joint"]:
    """Return the fractions of a step (s) after which joints reverse, in order; 1 for no reversal.

    They are computed from the cubic through angles (rad) and rates (rad/s), the first two rows of
    the states at both ends. A cubic has at most two turning points.
    """
    a, b, v0, _ = slopes(step, y0, y1)
    square = b * b - a * v0
    two = square > 0
    root = jnp.sqrt(jnp.where(two, square, 1))
    far = -(b + jnp.where(b < 0, -root, root))
    parts = []
    # Both roots are computed without subtracting numbers of similar size.
    for above, below in ((far, a), (v0, far)):
        part = above / jnp.where(below == 0, 1, below)
        parts.append(jnp.where(two & (below != 0) & (part > 0) & (part < 1), part, 1))
    first, second = parts
    return jnp.stack([jnp.minimum(first, second), jnp.maximum(first, second)])


def angle_after(
    part: Float[Array, " joint"], step: Any, y0: Float[Array, "row joint"], y1: Any
) -> Float[Array, " joint"]:
    """Return the angles (rad) after a fraction of a step; other arguments are as for `turns`."""
    a, b, v0, _ = slopes(step, y0, y1)
    return y0[0] + part * (v0 + part * (b + part * a / 3))


def slopes(step: Any, y0: Any, y1: Any) -> tuple[Array, Array, Array, Array]:
    """Return the cubic's coefficients: slope v0 + 2 b x + a x^2 at fraction x, and v1 at 1."""
    moved, v0, v1 = y1[0] - y0[0], step * y0[1], step * y1[1]
    return 3 * (v0 + v1 - 2 * moved), 3 * moved - 2 * v0 - v1, v0, v1


def way_between(step: Any, y0: "State", y1: "State") -> Float[Array, "4 joint"]:
    """Return the angles (rad) between which joints move monotonically; arguments as in `turns`."""
    # At a turning point the angle does not depend on the time to first order.
    parts = jax.lax.stop_gradient(turns(step, y0, y1))
    corners = [jnp.where(part < 1, angle_after(part, step, y0, y1), y1[0]) for part in parts]
    return jnp.stack([y0[0], *corners, y1[0]])


def along_links(arm: Arm, wind: Float[Array, " width"]) -> Array:
    """Return the wind of a signal with one row per link if it differs between links."""
    return wind if wind.size == 3 else wind.reshape(arm.count, 3)


class Springs(NamedTuple):
    """Implicit part of the joint torques in one state.

    Attributes:
        mass: mass matrix, kg m^2.
        stiffness: stiffness of the joints, N m/rad.
        damping: damping of the joints, N m s/rad.
        memory: derivatives of the states of the joint laws, or None.
        contact: derivatives of the contact torques with respect to the angles and rates of all
            joints, or None.
        borne: angle by which a joint bears a unit of each rate-independent state, rad; NaN for
            other states.
    """

    mass: Float[Array, "joint joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]
    memory: "Strain | None"
    contact: Stiffness | None
    borne: Float[Array, "row joint"]


class Strain(NamedTuple):
    """Mutual dependence of the torques and the states of the joint laws.

    Attributes:
        torque: torque against the motion per unit of each state, N m.
        filling: change of each state with the angle of its joint, 1/rad.
        forgetting: rate at which each state relaxes by itself, 1/s.
    """

    torque: Float[Array, "row joint"]
    filling: Float[Array, "row joint"]
    forgetting: Float[Array, "row joint"]


@traced_once
def springs(time: Any, state: State, inputs: Inputs) -> Springs:
    """Return the mass matrix and the derivatives of the torques of the joints in one state."""
    angles, rates, memory, skin = inputs.parts(state)
    time = jnp.minimum(time, inputs.end)
    arm = inputs.arm_at(time)
    laws = arm.joint_laws
    at = inputs.at(laws, time, angles, rates, memory)
    none = (jnp.zeros_like(angles),) * 2
    slopes: Any = [none if inputs.follows(law) else law.slopes(own) for law, own in laws.each(at)]
    # Unstable parts are explicit, because the matrix of a pair of muscles, or of a user-defined
    # law, need not be positive definite.
    if further := len(arm.joints.laws) + (arm.pneumatics is not None):
        slopes[-further:] = jax.tree.map(lambda x: jnp.maximum(x, 0), slopes[-further:])
    stiffness, damping = (
        functools.reduce(operator.add, each) for each in zip(*slopes, strict=True)
    )
    rows, borne = [], [jnp.zeros((0, arm.count), angles.dtype)]
    for law, own in laws.each(at):
        if law.rows:
            zero, slopes = jnp.zeros_like(own.states), law.state_slopes(own)
            rows.append((zero,) * 3 if inputs.follows(law) else slopes)
            of_all = stiffness + law.stiffest(own)
            angle = jnp.abs(slopes[0]) / of_all[None]
            borne.append(angle if inputs.follows(law) else jnp.full_like(zero, jnp.nan))
    strain = Strain(*map(jnp.concatenate, zip(*rows, strict=True))) if rows else None
    contact = None
    if arm.contact is not None:
        contact = contact_stiffness(arm, angles, rates, skin if skin.size else None)
    mass = mass_matrix(arm, angles)
    return Springs(mass, stiffness, damping, strain, contact, jnp.concatenate(borne))


def pull(time: Any, state: State, inputs: Inputs) -> Float[Array, " joint"]:
    """Return the torque of the joints and drives in one state; time affects only the command."""
    time = jnp.minimum(time, inputs.end)
    # The state and the arm belong to the matrices of the step and are constants like these. In a
    # derivative with respect to a stiffness, spring and command are then combined in one small
    # term, the deflection.
    arm, state = jax.lax.stop_gradient((inputs.arm_at(time), state))
    angles, rates, memory, _ = inputs.parts(state)
    # Only laws that a command may affect are included: the springs, user-defined laws and muscles.
    laws, given = arm.further_laws, dataclasses.replace(inputs, arm=arm).given(time)
    at = laws.at(angles, rates, given.command, memory, given.pressures)
    torque = Spring(arm.spring_stiffness).torque(at)
    for law, own in tuple(laws.each(at))[len(arm.joints.hysteresis.laws) :]:
        torque = torque if inputs.follows(law) else torque + law.torque(own)
    return torque if given.torque is None else torque + given.torque


def resistance(time: Any, state: State, inputs: Inputs) -> Float[Array, " joint"] | None:
    """Return the torque of the rate-independent laws, N m; None if there are none."""
    laws = inputs.arm.further_laws
    if not inputs.follows(laws):
        return None
    time = jnp.minimum(time, inputs.end)
    angles, rates, memory, _ = inputs.parts(inputs.followed(time, state))
    at = inputs.at(laws, time, angles, rates, memory)
    torques = (law.torque(own) for law, own in laws.each(at) if inputs.follows(law))
    return functools.reduce(operator.add, torques)
