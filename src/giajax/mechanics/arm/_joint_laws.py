"""Joint laws: torque, stored energy and internal states of the joints.

A user-defined law derives from `AbstractJointLaw`.
"""

import abc
import functools
import itertools
import operator
from collections.abc import Callable, Iterator
from typing import ClassVar, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Bool, Float, Scalar, larger, limited
from ...runtime.plugins import optional, register
from ...runtime.text import InputError
from ...schema import JOINT_MEMORY, JOINT_STOPS
from ...schema.parameters import parameter
from ..hysteresis import bouc_wen_after, bouc_wen_rate

PerJoint = Float[Array, " joint"]
Each = Float[Array, ""] | PerJoint
States = Float[Array, "row joint"]
Supply = Float[Array, "2 joint"]

_ROUNDING = 16  # rounding error of a strain, in units in the last place of the angles


class JointState(NamedTuple):
    """State of the joints of an arm at one time, as passed to a joint law.

    Attributes:
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        command: commanded angles, rad.
        states: internal states of the law, one row for each state.
        pressures: pressures supplied to both muscles of each joint, Pa; None if no law takes
            pressures.
    """

    angles: PerJoint
    rates: PerJoint
    command: PerJoint
    states: States
    pressures: Supply | None = None


class AbstractJointLaw(eqx.Module):
    """A law of the torque in each joint (`torque`) and of the energy stored there (`energy`).

    The torques of all laws of an arm are added. All joints are computed at once, and no joint may
    depend on another joint. A law with `rows` internal states defines their `rate`, or their values
    after a motion in which elements slide (`return_mapped`). If the states depend only on the path
    of the joint angle, the law can define their values after a motion (`travelled`). A law driven
    by pressures defines `commanded`. All other quantities that solvers require are computed by
    differentiation. The parameters of a law are declared like all others
    (`giajax.schema.parameters.parameter`) and have paths of the form `joints.laws.CLASS.NAME`.
    `check_joint_law` tests a law.
    """

    registered_as: ClassVar[str] = "joint"
    passive: ClassVar[bool] = True
    """Whether the law never releases more energy than it has stored."""
    largest_angle: ClassVar[float] = np.inf
    """Angle (rad) up to which `stiffest` is an upper bound of the stiffness.

    At larger angles, error control limits the steps.
    """

    @property
    @optional
    def rows(self) -> int:
        """Number of internal states of each joint, a constant."""
        return 0

    @abc.abstractmethod
    def torque(self, at: JointState) -> PerJoint:
        """Return the torque on each joint in the direction of its angle, N m."""

    @abc.abstractmethod
    def energy(self, at: JointState) -> PerJoint:
        """Return the recoverable energy stored in each joint, J; it must not depend on the rate."""

    @optional
    def unstrained(self, angles: PerJoint) -> States:
        """Return the states of joints that have always been at these angles (rad); 0 by default."""
        return jnp.zeros((self.rows, angles.size), angles.dtype)

    @optional
    def settled(self, at: JointState) -> States:
        """Return the states at the start of a motion, at these pressures; `unstrained` by default.

        The states in `at` are not used.
        """
        return self.unstrained(at.angles)

    @optional
    def commanded(self, command: PerJoint) -> Supply:
        """Return the pressures (Pa) that a controller supplies for commanded angles (rad).

        A law that defines this method takes `pressures`. An arm has at most one such law. The
        pressures of a run replace those of the controller. Without a controller, the pressures are
        0.
        """
        return jnp.zeros((2, command.size), command.dtype)

    @optional
    def inside(self, at: JointState) -> Supply:
        """Return the pressures in the muscles, Pa: the supplied pressures, unless they lag."""
        assert at.pressures is not None
        return at.pressures

    @property
    def takes_pressures(self) -> bool:
        """Whether the law is driven by pressures."""
        return type(self).commanded is not AbstractJointLaw.commanded

    @optional
    def rate(self, at: JointState) -> States:
        """Return the time derivative of the states, 1/s; 0 by default."""
        return jnp.zeros_like(at.states)

    @optional
    def return_mapped(self, angles: PerJoint, states: States) -> States:
        """Return the states after a motion to these angles (rad) in which no joint reversed."""
        del angles
        return states

    @optional
    def travelled(self, begin: PerJoint, end: PerJoint, states: States) -> States:
        """Return the states after a motion between two angles (rad) in which no joint reversed.

        This method is for laws whose states depend only on the path of the joint angle and not on
        its rate. Solvers then compute the states from one reversal to the next, and a time step
        need not end at a reversal. The default is `return_mapped`.
        """
        del begin
        return self.return_mapped(end, states)

    @optional
    def along(self, way: Float[Array, "corner joint"], states: States) -> States:
        """Return the states after a motion along a path of angles (rad).

        Between two neighbouring rows of `way`, no joint reverses, so `travelled` applies.
        """
        for begin, end in itertools.pairwise(way):
            states = self.travelled(begin, end, states)
        return states

    @optional
    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """Return stiffness (N m/rad) and damping (N m s/rad) at constant states.

        They are the negative derivatives of the torque with respect to angle and rate.
        """
        stiffness = slope(lambda x: self.torque(at._replace(angles=x)), at.angles)
        damping = slope(lambda x: self.torque(at._replace(rates=x)), at.rates)
        return -stiffness, -damping

    @optional
    def stiffest(self, at: JointState) -> PerJoint:
        """Return the largest stiffness at these angles, N m/rad.

        It includes the stiffness due to the change of the states in a motion.
        """
        torque, filling, _ = self.state_slopes(at)
        return self.slopes(at)[0] + jnp.sum(torque * filling, axis=0)

    @optional
    def dissipation(self, at: JointState) -> PerJoint:
        """Return the dissipated power, W: the power taken from the joints that is not stored."""

        def energy(angles: Array, states: Array) -> Array:
            return self.energy(at._replace(angles=angles, states=states))

        moved = (at.rates, self.rate(at))
        return -self.torque(at) * at.rates - jax.jvp(energy, (at.angles, at.states), moved)[1]

    @optional
    def state_slopes(self, at: JointState) -> tuple[States, States, States]:
        """Return the derivatives by which torque and internal states depend on each other.

        Terms that would be unstable are set to 0.

        Returns:
            Torque against the motion per unit of each state, N m; change of each state with the
            angle of its joint, 1/rad; and decay rate of each state, 1/s.
        """
        if not self.rows or type(self).rate is AbstractJointLaw.rate:
            # While an element without a rate slides, its torque is constant.
            return (jnp.zeros_like(at.states),) * 3

        def of(states: Array) -> tuple[Array, Array]:
            there = at._replace(states=states)
            return self.torque(there), self.rate(there)

        filling = slope(lambda x: self.rate(at._replace(rates=x)), at.rates)
        units = np.eye(self.rows, dtype=at.states.dtype)[:, :, None]
        slopes = [
            jax.jvp(of, (at.states,), (np.broadcast_to(unit, at.states.shape),))[1]
            for unit in units
        ]
        torque = -jnp.stack([each for each, _ in slopes])
        forgetting = -jnp.stack([each[row] for row, (_, each) in enumerate(slopes)])
        return torque, jnp.where(torque * filling < 0, 0, filling), larger(forgetting, 0)

    @property
    @optional
    def slides(self) -> bool:
        """Whether the states depend only on the path of the joint angle.

        This is the case if the law defines `travelled`, or `return_mapped` but no `rate`.
        """
        own, given = type(self), AbstractJointLaw
        mapped = own.return_mapped is not given.return_mapped and own.rate is given.rate
        return own.travelled is not given.travelled or mapped


def slope(of: Callable[[Array], Array], at: Array) -> Array:
    # No joint depends on another joint, so one directional derivative gives the whole diagonal.
    return jax.jvp(of, (at,), (jnp.ones_like(at),))[1]


T = TypeVar("T")


class JointLaws(AbstractJointLaw):
    """The sum of one or more laws. Its states are the states of the laws, stacked in order."""

    laws: tuple[AbstractJointLaw, ...]

    @property
    def rows(self) -> int:
        """Number of internal states of each joint, summed over the laws."""
        return sum(law.rows for law in self.laws)

    @property
    def mapped(self) -> bool:
        """Whether a law has states that are updated from the joint angles at the end of a step."""
        plain = AbstractJointLaw.return_mapped
        return self.slides or any(type(law).return_mapped is not plain for law in self.laws)

    @property
    def slides(self) -> bool:
        """Whether a law has states that depend only on the path of the joint angle."""
        return any(law.slides for law in self.laws if law.rows)

    @property
    def driven(self) -> AbstractJointLaw | None:
        """The law that takes pressures, or None."""
        return next((law for law in self.laws if law.takes_pressures), None)

    def at(
        self,
        angles: PerJoint,
        rates: PerJoint,
        command: PerJoint,
        states: States | None = None,
        pressures: Supply | None = None,
    ) -> JointState:
        """Return the state of joints at angles (rad), rates (rad/s) and commands (rad).

        Arguments:
            angles, rates, command: joint angles, joint rates and commanded angles.
            states: internal states of all laws; by default those at the start of a motion.
            pressures: pressures supplied to the muscles, Pa; by default those of the controller.
        """
        if pressures is None and self.driven is not None:
            pressures = self.driven.commanded(command)
        none = jnp.zeros((0, angles.size), angles.dtype)
        at = JointState(angles, rates, command, none if states is None else states, pressures)
        return at._replace(states=self.settled(at)) if states is None else at

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque on each joint, N m."""
        return self._sum(at, lambda law, own: law.torque(own))

    def energy(self, at: JointState) -> PerJoint:
        """Return the energy stored in each joint, J."""
        return self._sum(at, lambda law, own: law.energy(own))

    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """Return the total stiffness (N m/rad) and damping (N m s/rad)."""
        return self._sum(at, lambda law, own: law.slopes(own))

    def stiffest(self, at: JointState) -> PerJoint:
        """Return an upper bound of the total stiffness, N m/rad."""
        return self._sum(at, lambda law, own: law.stiffest(own))

    def dissipation(self, at: JointState) -> PerJoint:
        """Return the dissipated power, W."""
        return self._sum(at, lambda law, own: law.dissipation(own))

    def unstrained(self, angles: PerJoint) -> States:
        """Return the states of joints that have always been at these angles (rad)."""
        return self._rows(angles, lambda law: law.unstrained(angles))

    def settled(self, at: JointState) -> States:
        """Return the states at the start of a motion."""
        return self._rows(at.angles, lambda law: law.settled(at))

    def rate(self, at: JointState) -> States:
        """Return the time derivative of the states, 1/s."""
        rates = [law.rate(own) for law, own in self.each(at) if law.rows]
        return jnp.concatenate(rates) if rates else at.states

    def return_mapped(self, angles: PerJoint, states: States) -> States:
        """Return the states after a motion to these angles (rad) in which no joint reversed."""
        parts = self.each(JointState(angles, angles, angles, states))
        mapped = [law.return_mapped(angles, own.states) for law, own in parts if law.rows]
        return jnp.concatenate(mapped) if mapped else states

    def followed(self, way: Float[Array, "corner joint"], held: States, states: States) -> States:
        """Return the states after a motion along a path of angles.

        Arguments:
            way: angles of the path, rad; no joint reverses between two neighbouring rows.
            held: states at the start of the path, used for laws whose states depend only on it.
            states: states at the end of the path, used for all other laws.
        """
        mapped, row = [states[:0]], 0
        for law, own in self.each(JointState(way[-1], way[-1], way[-1], states)):
            after = law.return_mapped(way[-1], own.states)
            if law.slides:
                after = law.along(way, held[row : row + law.rows])
            mapped.append(after)
            row += law.rows
        return jnp.concatenate(mapped)

    def state_slopes(self, at: JointState) -> tuple[States, States, States]:
        """Return the derivatives of torques and states, stacked in the order of the laws."""
        parts = [law.state_slopes(own) for law, own in self.each(at) if law.rows]
        torque, filling, forgetting = map(jnp.concatenate, zip(*parts, strict=True))
        return torque, filling, forgetting

    def each(self, at: JointState) -> Iterator[tuple[AbstractJointLaw, JointState]]:
        """Yield each law with the joint state that contains only its own states."""
        row = 0
        for law in self.laws:
            # No slice is needed if all states belong to this law.
            own = slice(row, row + law.rows)
            yield law, at if law.rows == self.rows else at._replace(states=at.states[own])
            row += law.rows

    def _rows(self, angles: PerJoint, of: Callable[[AbstractJointLaw], States]) -> States:
        none = jnp.zeros((0, angles.size), angles.dtype)
        return jnp.concatenate([none, *(of(law) for law in self.laws if law.rows)])

    def _sum(self, at: JointState, of: Callable[[AbstractJointLaw, JointState], T]) -> T:
        parts = [of(law, own) for law, own in self.each(at)]
        added: T = jax.tree.map(lambda *each: functools.reduce(operator.add, each), *parts)
        return added


class Spring(AbstractJointLaw):
    """A spring that pulls towards the commanded angle.

    It is the spring of section III.A of the paper, whose initial length can change.

    Attributes:
        stiffness: stiffness, N m/rad.
    """

    stiffness: Each

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque towards the command, N m."""
        return self.stiffness * (at.command - at.angles)

    def energy(self, at: JointState) -> PerJoint:
        """Return the energy of the deflection, J."""
        return self.stiffness * (at.angles - at.command) ** 2 / 2


class Damper(AbstractJointLaw):
    """Viscous damping.

    Attributes:
        damping: damping coefficient, N m s/rad.
    """

    damping: Each

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque against the rate, N m."""
        return -(self.damping * at.rates)

    def energy(self, at: JointState) -> PerJoint:
        """Return zero, because the law stores no energy, J."""
        return jnp.zeros_like(at.rates)


class CoulombFriction(AbstractJointLaw):
    """Coulomb friction f tanh(v / v0), which is smooth at rest.

    Attributes:
        strength: friction torque f, N m.
        scale: rate v0, rad/s.
    """

    strength: Each
    scale: Scalar

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque against the rate, N m."""
        return -(self.strength * jnp.tanh(at.rates / self.scale))

    def energy(self, at: JointState) -> PerJoint:
        """Return zero, because the law stores no energy, J."""
        return jnp.zeros_like(at.rates)


_each_joint = functools.partial(parameter, lower=0, each=True, per="joint")


@register
class Hardening(AbstractJointLaw):
    """A spring whose stiffness increases with its deflection d from the commanded angle.

    Its torque is -(k3 d^3 + k5 d^5). It acts in addition to the linear spring of the joint, which
    also pulls towards the command.
    """

    kind: ClassVar[str] = "hardening"

    cubic: Each = _each_joint(
        1.0,
        unit="N m/rad^3",
        upper=1e4,
        frozen=False,
        doc="coefficient of the joint torque that is proportional to the cube of the deflection",
    )
    quintic: Each = _each_joint(
        0.0,
        unit="N m/rad^5",
        upper=1e4,
        doc="coefficient of the joint torque that is proportional to the fifth power of the "
        "deflection",
    )

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque towards the command, N m."""
        deflection = at.angles - at.command
        square = deflection**2
        return -deflection * square * (self.cubic + self.quintic * square)

    def energy(self, at: JointState) -> PerJoint:
        """Return the energy of the deflection, J."""
        square = (at.angles - at.command) ** 2
        return square**2 * (self.cubic / 4 + self.quintic / 6 * square)


@register
class EndStops(AbstractJointLaw):
    """End stops of a joint: springs that act beyond a lower and an upper angle.

    Their stiffness increases smoothly over the range `blend`. They dissipate energy like contacts
    (`Contact.damping`): the torque is multiplied by (1 + damping times closing rate), which makes
    it smaller while the stop opens, and it never becomes negative.
    """

    kind: ClassVar[str] = "end_stops"

    lower: Each = _each_joint(
        -1.05,
        unit="rad",
        lower=-np.pi,
        upper=0,
        doc="joint angle beyond which the lower end stop acts",
    )
    upper: Each = _each_joint(
        1.05, unit="rad", upper=np.pi, doc="joint angle beyond which the upper end stop acts"
    )
    stiffness: Each = _each_joint(
        100.0, unit="N m/rad", upper=1e5, doc="full stiffness of the end stops"
    )
    damping: Each = _each_joint(
        0.0,
        unit="s/rad",
        upper=1e3,
        doc="relative increase in the torque of the end stop per unit of penetration rate",
    )
    blend: Each = _each_joint(
        0.02,
        unit="rad",
        lower=1e-6,
        upper=1,
        doc="range of joint angles over which the end stops reach their full stiffness",
    )

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque back into the range, N m."""
        return self._force(self.lower - at.angles, -at.rates) - self._force(
            at.angles - self.upper, at.rates
        )

    def energy(self, at: JointState) -> PerJoint:
        """Return the energy of both stops, J."""
        return self._stored(self.lower - at.angles) + self._stored(at.angles - self.upper)

    def _force(self, beyond: Array, closing: Array) -> Array:
        entering = limited(beyond, 0, self.blend)
        way = entering**2 / (2 * self.blend) + larger(beyond - self.blend, 0)
        return self.stiffness * way * larger(1 + self.damping * closing, 0)

    def _stored(self, beyond: Array) -> Array:
        entering, rest = limited(beyond, 0, self.blend), larger(beyond - self.blend, 0)
        return self.stiffness * (entering**3 / (6 * self.blend) + rest * (self.blend + rest) / 2)


class Memory(AbstractJointLaw):
    """A Bouc-Wen element in each joint, which resists the motion with the torque strength times z.

    The state z depends on the rate v of the joint:

        dz/dt = (v - (1 - delta) |v| |z|^(nu - 1) z - delta v |z|^nu) / yield_angle

    |z| never exceeds 1. With the default values nu = 1 and delta = 0, this is the Dahl model of
    friction. With a large nu and delta = 1/2, it is an elastic spring that slides beyond its yield
    angle.

    References: Y.-K. Wen, J. Eng. Mech. Div. 102 (1976) 249-263; P. R. Dahl, AIAA J. 14 (1976)
    1675-1682; M. Ismail et al., Arch. Comput. Methods Eng. 16 (2009) 161-188.

    Arguments:
        strength: largest torque, N m; None if the joints have no such element.
        yield_angle: strength divided by the stiffness at the start of a motion, rad.
        nu: sharpness of the knee.
        delta: shape of the loop, at most 1/2. With 1/2, unloading is elastic. With a larger value,
            the element would generate energy.
        initial: z at the start of a motion; None means 0.
    """

    strength: Each | None = parameter(JOINT_MEMORY.strength)
    yield_angle: Each = parameter(JOINT_MEMORY.yield_angle)
    nu: Scalar = parameter(JOINT_MEMORY.nu)
    delta: Scalar = parameter(JOINT_MEMORY.delta)
    initial: Each | None = parameter(JOINT_MEMORY.initial)

    @property
    def rows(self) -> int:
        """Number of states of each joint."""
        return 0 if self.strength is None else 1

    def settled(self, at: JointState) -> States:
        """Return the states at the start of a motion, which an earlier motion may have strained."""
        if self.initial is None:
            return self.unstrained(at.angles)
        return jnp.broadcast_to(self.initial, (self.rows, at.angles.size))

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque against the strain, N m."""
        return -(self._strength * at.states[0])

    def energy(self, at: JointState) -> PerJoint:
        """Return the energy of the strain, J."""
        return self._strength * self.yield_angle * at.states[0] ** 2 / 2

    def rate(self, at: JointState) -> States:
        """Return the time derivative of the states, 1/s."""
        one, gamma = jnp.ones(()), 1 - self.delta
        rate = bouc_wen_rate(at.rates, at.states[0], one, one, gamma, self.delta, self.nu)
        return (rate / self.yield_angle)[None]

    def travelled(self, begin: PerJoint, end: PerJoint, states: States) -> States:
        """Return the states after a motion between two angles (rad) in one direction."""
        return self.along(jnp.stack([begin, end]), states)

    def along(self, way: Float[Array, "corner joint"], states: States) -> States:
        """Return the states after a motion along a path of angles (rad)."""
        legs = jnp.diff(way, axis=0) / self.yield_angle
        return bouc_wen_after(legs, states[0], self.nu, self.delta)[None]

    def stiffest(self, at: JointState) -> PerJoint:
        """Return the stiffness of a sliding element directly after a reversal, N m/rad."""
        largest = 2 * (1 - self.delta) * self._strength / self.yield_angle
        return jnp.broadcast_to(largest, at.angles.shape)

    @property
    def _strength(self) -> Each:
        assert self.strength is not None
        return self.strength


class Stops(AbstractJointLaw):
    """Parallel elastic springs, each of which slides beyond its own yield angle (Iwan model).

    The state of each element is the joint angle at which its strain is zero. While the element
    slides, this angle moves with the joint. The state is therefore the play operator of
    `giajax.mechanics.hysteresis`.

    Reference: W. D. Iwan, J. Appl. Mech. 33 (1966) 893-900.

    Arguments:
        strength: torque at which each element slides, N m; None if the joints have no elements.
        yield_angle: strain at which each element slides, rad; one value for all, or one for each.

    Raises:
        InputError: the numbers of strengths and yield angles differ.
    """

    strength: Float[Array, ""] | Float[Array, " stop"] | None = parameter(JOINT_STOPS.strength)
    yield_angle: Float[Array, ""] | Float[Array, " stop"] = parameter(JOINT_STOPS.yield_angle)

    def __check_init__(self) -> None:
        if self.strength is None:
            return
        shapes = {self.strength.shape, self.yield_angle.shape} - {()}
        if len(shapes) > 1 or any(len(shape) != 1 or not shape[0] for shape in shapes):
            raise InputError(
                f"joints.stops has strengths of shape {self.strength.shape} and yield angles of "
                f"shape {self.yield_angle.shape}: give one strength and one yield angle for each "
                "element"
            )

    @property
    def rows(self) -> int:
        """Number of states of each joint."""
        return 0 if self.strength is None else max(self.strength.size, self.yield_angle.size)

    def unstrained(self, angles: PerJoint) -> States:
        """Return the states of joints that have always been at these angles (rad), rad."""
        return jnp.broadcast_to(angles, (self.rows, angles.size))

    def return_mapped(self, angles: PerJoint, states: States) -> States:
        """Return the states (rad) after a motion to these angles (rad) in one direction."""
        width = self._yield_angles
        return limited(states, angles[None] - width, angles[None] + width)

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque against the strain, N m."""
        return -jnp.sum(self._strengths * self._strain(at), axis=0)

    def energy(self, at: JointState) -> PerJoint:
        """Return the energy of the strain, J."""
        stored = self._strengths * self._yield_angles * self._strain(at) ** 2 / 2
        return jnp.sum(stored, axis=0)

    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """Return the stiffness of the elements that do not slide, N m/rad, and zero damping."""
        stiffness = self._strengths / self._yield_angles
        stiffness = jnp.sum(jnp.where(self._slide(at), 0, stiffness), axis=0)
        return stiffness, jnp.zeros_like(stiffness)

    def dissipation(self, at: JointState) -> PerJoint:
        """Return the power dissipated by sliding elements, W."""
        heat = self._strengths * jnp.abs(at.rates)[None]
        return jnp.sum(jnp.where(self._slide(at), heat, 0), axis=0)

    def _strain(self, at: JointState) -> States:
        """Return the strain of each element divided by its yield angle, between -1 and 1."""
        return limited((at.angles[None] - at.states) / self._yield_angles, -1, 1)

    def _slide(self, at: JointState) -> Bool[Array, "row joint"]:
        strain, width = at.angles[None] - at.states, self._yield_angles
        # The strain of a sliding element equals the yield angle except for rounding.
        size = jnp.abs(at.angles)[None] + width
        rounding = _ROUNDING * jnp.finfo(at.angles.dtype).eps * size
        return (jnp.abs(strain) > width - rounding) & (strain * at.rates[None] > 0)

    @property
    def _strengths(self) -> Float[Array, "row 1"]:
        strength = jnp.zeros(()) if self.strength is None else self.strength
        return jnp.broadcast_to(strength, (self.rows,))[:, None]

    @property
    def _yield_angles(self) -> Float[Array, "row 1"]:
        width = jnp.ones(()) if self.strength is None else self.yield_angle
        return jnp.broadcast_to(width, (self.rows,))[:, None]


class JointHysteresis(eqx.Module):
    """Hysteresis of the joints, in parallel with their springs; disabled by default.

    Hysteresis depends on the path of the joint angle and not on its rate. After a motion in one
    direction and back, a joint does not return to its initial angle, even if it moves slowly. The
    states are those of `memory`, followed by those of `stops`.
    """

    memory: Memory = eqx.field(default_factory=Memory)
    stops: Stops = eqx.field(default_factory=Stops)

    @property
    def laws(self) -> tuple[AbstractJointLaw, ...]:
        """The hysteresis laws that are enabled."""
        return tuple(law for law in (self.memory, self.stops) if law.rows)
