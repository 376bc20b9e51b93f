"""Laws of joints: torque, stored energy and own states of each. A law of one's own is one more."""

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

_ROUNDING = 16  # of the angles that a strain is the difference of, in units of their last place


class JointState(NamedTuple):
    """The joints of an arm at one moment, as their laws see them.

    Attributes:
        angles: rad.
        rates: rad/s.
        command: commanded angles, rad.
        states: of the law's own, in rows.
        pressures: supplied to both muscles of each joint, Pa; None where no law takes any.
    """

    angles: PerJoint
    rates: PerJoint
    command: PerJoint
    states: States
    pressures: Supply | None = None


class AbstractJointLaw(eqx.Module):
    """What acts in each joint: `torque`, and the `energy` that is stored in it. Laws add.

    All joints are computed at once, and no joint may depend on another one. A law of `rows` states
    has their `rate`, or what they slide by (`return_mapped`), and where they depend on the way of a
    joint alone what they are after one (`travelled`). One that is driven by pressures has
    `commanded`. What solvers need besides follows by derivatives. Its parameters are declared as
    all others (`giajax.schema.parameters.parameter`) and have paths as `joints.laws.CLASS.NAME`.
    `check_joint_law` tests a law.
    """

    registered_as: ClassVar[str] = "joint"
    passive: ClassVar[bool] = True
    """Whether the law claims never to give more energy than it has stored."""
    largest_angle: ClassVar[float] = np.inf
    """Up to where `stiffest` is a bound, rad; beyond, steps are left to the control of errors."""

    @property
    @optional
    def rows(self) -> int:
        """Own states of each joint, a constant."""
        return 0

    @abc.abstractmethod
    def torque(self, at: JointState) -> PerJoint:
        """Torque on each joint, in the direction of its angle, N m."""

    @abc.abstractmethod
    def energy(self, at: JointState) -> PerJoint:
        """Energy that is stored in each joint and given back, whatever its rate, J."""

    @optional
    def unstrained(self, angles: PerJoint) -> States:
        """The states of joints that were never moved from these angles (rad); 0 by default."""
        return jnp.zeros((self.rows, angles.size), angles.dtype)

    @optional
    def settled(self, at: JointState) -> States:
        """The states at the beginning of a motion, at these pressures; `unstrained` by default."""
        return self.unstrained(at.angles)

    @optional
    def commanded(self, command: PerJoint) -> Supply:
        """Pressures (Pa) that a controller supplies for commanded angles (rad).

        A law with this method takes `pressures`, an arm has one at most, and those of a run take
        the place of these. Without a controller they are 0.
        """
        return jnp.zeros((2, command.size), command.dtype)

    @optional
    def inside(self, at: JointState) -> Supply:
        """Pressures in the muscles, Pa: those supplied, unless they lag."""
        assert at.pressures is not None
        return at.pressures

    @property
    def takes_pressures(self) -> bool:
        """Whether pressures drive it."""
        return type(self).commanded is not AbstractJointLaw.commanded

    @optional
    def rate(self, at: JointState) -> States:
        """How fast the states change, 1/s; not at all by default."""
        return jnp.zeros_like(at.states)

    @optional
    def return_mapped(self, angles: PerJoint, states: States) -> States:
        """The states after a motion to these angles (rad) in which no joint turned round."""
        del angles
        return states

    @optional
    def travelled(self, begin: PerJoint, end: PerJoint, states: States) -> States:
        """The states after a motion between these angles (rad) in which no joint turned round.

        Of a law whose states depend on the way alone, however fast it is: solvers follow it then
        from turn to turn, and their steps need not end there. By default `return_mapped`.
        """
        del begin
        return self.return_mapped(end, states)

    @optional
    def along(self, way: Float[Array, "corner joint"], states: States) -> States:
        """The states after a motion by these corners (rad), between which `travelled` holds."""
        for begin, end in itertools.pairwise(way):
            states = self.travelled(begin, end, states)
        return states

    @optional
    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """Stiffness (N m/rad) and damping (N m s/rad), at constant states: how the torque falls."""
        stiffness = slope(lambda x: self.torque(at._replace(angles=x)), at.angles)
        damping = slope(lambda x: self.torque(at._replace(rates=x)), at.rates)
        return -stiffness, -damping

    @optional
    def stiffest(self, at: JointState) -> PerJoint:
        """Largest stiffness at these angles, N m/rad; with what the states add in a motion."""
        torque, filling, _ = self.state_slopes(at)
        return self.slopes(at)[0] + jnp.sum(torque * filling, axis=0)

    @optional
    def dissipation(self, at: JointState) -> PerJoint:
        """Power that becomes heat, W: what of the torque's power is not stored."""

        def energy(angles: Array, states: Array) -> Array:
            return self.energy(at._replace(angles=angles, states=states))

        moved = (at.rates, self.rate(at))
        return -self.torque(at) * at.rates - jax.jvp(energy, (at.angles, at.states), moved)[1]

    @optional
    def state_slopes(self, at: JointState) -> tuple[States, States, States]:
        """How torque and own states depend on each other; what would run away is left out.

        Returns:
            Torque of a unit of each state, against the motion, N m; change of each state with the
            angle of its joint, 1/rad; and rate at which each falls back by itself, 1/s.
        """
        if not self.rows or type(self).rate is AbstractJointLaw.rate:
            # Where such a state slides, the torque does not change.
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
        """Whether states depend on the way alone: those with `travelled`, or without a rate."""
        own, given = type(self), AbstractJointLaw
        mapped = own.return_mapped is not given.return_mapped and own.rate is given.rate
        return own.travelled is not given.travelled or mapped


def slope(of: Callable[[Array], Array], at: Array) -> Array:
    # No joint depends on another one, so that one derivative along all at once is the diagonal.
    return jax.jvp(of, (at,), (jnp.ones_like(at),))[1]


T = TypeVar("T")


class JointLaws(AbstractJointLaw):
    """The sum of laws, at least one; its states are theirs, law after law."""

    laws: tuple[AbstractJointLaw, ...]

    @property
    def rows(self) -> int:
        """Own states of each joint, of all laws."""
        return sum(law.rows for law in self.laws)

    @property
    def mapped(self) -> bool:
        """Whether states of one follow the angles of the joints, at least at the end of a step."""
        plain = AbstractJointLaw.return_mapped
        return self.slides or any(type(law).return_mapped is not plain for law in self.laws)

    @property
    def slides(self) -> bool:
        """Whether states of one depend on the way alone."""
        return any(law.slides for law in self.laws if law.rows)

    @property
    def driven(self) -> AbstractJointLaw | None:
        """The one that takes pressures; None where none does."""
        return next((law for law in self.laws if law.takes_pressures), None)

    def at(
        self,
        angles: PerJoint,
        rates: PerJoint,
        command: PerJoint,
        states: States | None = None,
        pressures: Supply | None = None,
    ) -> JointState:
        """Joints at angles (rad), rates (rad/s) and commands (rad).

        By default without strain, and at the pressures (Pa) of the controller.
        """
        if pressures is None and self.driven is not None:
            pressures = self.driven.commanded(command)
        none = jnp.zeros((0, angles.size), angles.dtype)
        at = JointState(angles, rates, command, none if states is None else states, pressures)
        return at._replace(states=self.settled(at)) if states is None else at

    def torque(self, at: JointState) -> PerJoint:
        """Torque on each joint, N m."""
        return self._sum(at, lambda law, own: law.torque(own))

    def energy(self, at: JointState) -> PerJoint:
        """Energy that is stored in each joint, J."""
        return self._sum(at, lambda law, own: law.energy(own))

    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """Stiffness (N m/rad) and damping (N m s/rad) of all together."""
        return self._sum(at, lambda law, own: law.slopes(own))

    def stiffest(self, at: JointState) -> PerJoint:
        """Bound of the stiffness of all together, N m/rad."""
        return self._sum(at, lambda law, own: law.stiffest(own))

    def dissipation(self, at: JointState) -> PerJoint:
        """Power that becomes heat, W."""
        return self._sum(at, lambda law, own: law.dissipation(own))

    def unstrained(self, angles: PerJoint) -> States:
        """The states of joints that were never moved from these angles (rad)."""
        return self._rows(angles, lambda law: law.unstrained(angles))

    def settled(self, at: JointState) -> States:
        """The states at the beginning of a motion."""
        return self._rows(at.angles, lambda law: law.settled(at))

    def rate(self, at: JointState) -> States:
        """How fast the states change, 1/s."""
        rates = [law.rate(own) for law, own in self.each(at) if law.rows]
        return jnp.concatenate(rates) if rates else at.states

    def return_mapped(self, angles: PerJoint, states: States) -> States:
        """The states after a motion to these angles (rad) in which no joint turned round."""
        parts = self.each(JointState(angles, angles, angles, states))
        mapped = [law.return_mapped(angles, own.states) for law, own in parts if law.rows]
        return jnp.concatenate(mapped) if mapped else states

    def followed(self, way: Float[Array, "corner joint"], held: States, states: States) -> States:
        """The states after a way by corners (rad), of those that depend on it alone.

        They are `held` at its beginning; `states` are those of the others, at its end.
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
        """How torques and states depend on each other, law after law."""
        parts = [law.state_slopes(own) for law, own in self.each(at) if law.rows]
        torque, filling, forgetting = map(jnp.concatenate, zip(*parts, strict=True))
        return torque, filling, forgetting

    def each(self, at: JointState) -> Iterator[tuple[AbstractJointLaw, JointState]]:
        """The laws, with the joints as each of them sees them."""
        row = 0
        for law in self.laws:
            # Without an operation where they are all.
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

    That is one whose initial length can change (paper, III.A).

    Attributes:
        stiffness: N m/rad.
    """

    stiffness: Each

    def torque(self, at: JointState) -> PerJoint:
        """Towards the command, N m."""
        return self.stiffness * (at.command - at.angles)

    def energy(self, at: JointState) -> PerJoint:
        """Energy of the deflection, J."""
        return self.stiffness * (at.angles - at.command) ** 2 / 2


class Damper(AbstractJointLaw):
    """Viscous damping.

    Attributes:
        damping: N m s/rad.
    """

    damping: Each

    def torque(self, at: JointState) -> PerJoint:
        """Against the rate, N m."""
        return -(self.damping * at.rates)

    def energy(self, at: JointState) -> PerJoint:
        """None, J."""
        return jnp.zeros_like(at.rates)


class CoulombFriction(AbstractJointLaw):
    """Coulomb friction f tanh(v / v0), smooth at rest.

    Attributes:
        strength: f, N m.
        scale: v0, rad/s.
    """

    strength: Each
    scale: Scalar

    def torque(self, at: JointState) -> PerJoint:
        """Against the rate, N m."""
        return -(self.strength * jnp.tanh(at.rates / self.scale))

    def energy(self, at: JointState) -> PerJoint:
        """None, J."""
        return jnp.zeros_like(at.rates)


_each_joint = functools.partial(parameter, lower=0, each=True, per="joint")


@register
class Hardening(AbstractJointLaw):
    """A spring that becomes stiffer with its deflection d from the commanded angle.

    Its torque is -(k3 d^3 + k5 d^5), beside that of the joint's own spring, which is the linear
    part, and pulls towards the command, too.
    """

    kind: ClassVar[str] = "hardening"

    cubic: Each = _each_joint(
        1.0,
        unit="N m/rad^3",
        upper=1e4,
        frozen=False,
        doc="coefficient of the torque proportional to the cube of the deflection",
    )
    quintic: Each = _each_joint(
        0.0,
        unit="N m/rad^5",
        upper=1e4,
        doc="coefficient of the torque proportional to the fifth power of the deflection",
    )

    def torque(self, at: JointState) -> PerJoint:
        """Towards the command, N m."""
        deflection = at.angles - at.command
        square = deflection**2
        return -deflection * square * (self.cubic + self.quintic * square)

    def energy(self, at: JointState) -> PerJoint:
        """Energy of the deflection, J."""
        square = (at.angles - at.command) ** 2
        return square**2 * (self.cubic / 4 + self.quintic / 6 * square)


@register
class EndStops(AbstractJointLaw):
    """Ends of the range of a joint: springs that it meets at an angle below and one above.

    They come on smoothly, over `blend`, and take energy as contacts do (`Contact.damping`): a
    closing stop presses (1 + damping times rate) times as hard, an opening one softer, and none
    pulls.
    """

    kind: ClassVar[str] = "end_stops"

    lower: Each = _each_joint(
        -1.05, unit="rad", lower=-np.pi, upper=0, doc="angle of the lower stop"
    )
    upper: Each = _each_joint(1.05, unit="rad", upper=np.pi, doc="angle of the upper stop")
    stiffness: Each = _each_joint(100.0, unit="N m/rad", upper=1e5, doc="stiffness of the stops")
    damping: Each = _each_joint(
        0.0,
        unit="s/rad",
        upper=1e3,
        doc="relative increase of the torque of the stops per closing rate",
    )
    blend: Each = _each_joint(
        0.02,
        unit="rad",
        lower=1e-6,
        upper=1,
        doc="range of angle over which the stops reach their full stiffness",
    )

    def torque(self, at: JointState) -> PerJoint:
        """Back into the range, N m."""
        return self._force(self.lower - at.angles, -at.rates) - self._force(
            at.angles - self.upper, at.rates
        )

    def energy(self, at: JointState) -> PerJoint:
        """Energy of both stops, J."""
        return self._stored(self.lower - at.angles) + self._stored(at.angles - self.upper)

    def _force(self, beyond: Array, closing: Array) -> Array:
        entering = limited(beyond, 0, self.blend)
        way = entering**2 / (2 * self.blend) + larger(beyond - self.blend, 0)
        return self.stiffness * way * larger(1 + self.damping * closing, 0)

    def _stored(self, beyond: Array) -> Array:
        entering, rest = limited(beyond, 0, self.blend), larger(beyond - self.blend, 0)
        return self.stiffness * (entering**3 / (6 * self.blend) + rest * (self.blend + rest) / 2)


class Memory(AbstractJointLaw):
    """A Bouc-Wen element in each joint: it resists with strength z, where z is its state.

        dz/dt = (v - (1 - delta) |v| |z|^(nu - 1) z - delta v |z|^nu) / yield_angle

    of the joint's rate v, so that |z| never passes 1. With nu = 1 and delta = 0, the defaults, it
    is Dahl's model of friction; with a large nu and delta = 1/2 an elastic spring that slides.

    References: Y.-K. Wen, J. Eng. Mech. Div. 102 (1976) 249-263; P. R. Dahl, AIAA J. 14 (1976)
    1675-1682; M. Ismail et al., Arch. Comput. Methods Eng. 16 (2009) 161-188.

    Arguments:
        strength: largest torque, N m; None where joints have no such element.
        yield_angle: strength over the stiffness at the beginning of a motion, rad.
        nu: sharpness of the knee.
        delta: shape of the loop; at most 1/2, where unloading is elastic: an element with more
            would give energy away.
        initial: z at the beginning of a motion; None: 0.
    """

    strength: Each | None = parameter(JOINT_MEMORY.strength)
    yield_angle: Each = parameter(JOINT_MEMORY.yield_angle)
    nu: Scalar = parameter(JOINT_MEMORY.nu)
    delta: Scalar = parameter(JOINT_MEMORY.delta)
    initial: Each | None = parameter(JOINT_MEMORY.initial)

    @property
    def rows(self) -> int:
        """States of each joint."""
        return 0 if self.strength is None else 1

    def settled(self, at: JointState) -> States:
        """The states at the beginning of a motion: what was before may have strained a joint."""
        if self.initial is None:
            return self.unstrained(at.angles)
        return jnp.broadcast_to(self.initial, (self.rows, at.angles.size))

    def torque(self, at: JointState) -> PerJoint:
        """Torque against the strain, N m."""
        return -(self._strength * at.states[0])

    def energy(self, at: JointState) -> PerJoint:
        """Energy of the strain, J."""
        return self._strength * self.yield_angle * at.states[0] ** 2 / 2

    def rate(self, at: JointState) -> States:
        """How fast the states change, 1/s."""
        one, gamma = jnp.ones(()), 1 - self.delta
        rate = bouc_wen_rate(at.rates, at.states[0], one, one, gamma, self.delta, self.nu)
        return (rate / self.yield_angle)[None]

    def travelled(self, begin: PerJoint, end: PerJoint, states: States) -> States:
        """The states after a motion between these angles (rad) in one direction."""
        return self.along(jnp.stack([begin, end]), states)

    def along(self, way: Float[Array, "corner joint"], states: States) -> States:
        """The states after a motion by these corners (rad)."""
        legs = jnp.diff(way, axis=0) / self.yield_angle
        return bouc_wen_after(legs, states[0], self.nu, self.delta)[None]

    def stiffest(self, at: JointState) -> PerJoint:
        """That of an element which slid, at the turn, N m/rad."""
        largest = 2 * (1 - self.delta) * self._strength / self.yield_angle
        return jnp.broadcast_to(largest, at.angles.shape)

    @property
    def _strength(self) -> Each:
        assert self.strength is not None
        return self.strength


class Stops(AbstractJointLaw):
    """Elastic springs in parallel that slide, each from its own angle on: Iwan's model.

    The state of each is the angle at which it is without strain. It moves with the joint where
    the element slides, which is the play operator of `giajax.mechanics.hysteresis`.

    Reference: W. D. Iwan, J. Appl. Mech. 33 (1966) 893-900.

    Arguments:
        strength: torque at which each slides, N m; None where joints have none.
        yield_angle: strain at which each slides, rad; one for all or one for each.

    Raises:
        InputError: another number of angles than of strengths.
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
                f"element"
            )

    @property
    def rows(self) -> int:
        """States of each joint."""
        return 0 if self.strength is None else max(self.strength.size, self.yield_angle.size)

    def unstrained(self, angles: PerJoint) -> States:
        """The states of a joint that was never moved from these angles (rad), rad."""
        return jnp.broadcast_to(angles, (self.rows, angles.size))

    def return_mapped(self, angles: PerJoint, states: States) -> States:
        """The states (rad) after a motion to these angles (rad) in one direction."""
        width = self._yield_angles
        return limited(states, angles[None] - width, angles[None] + width)

    def torque(self, at: JointState) -> PerJoint:
        """Torque against the strain, N m."""
        return -jnp.sum(self._strengths * self._strain(at), axis=0)

    def energy(self, at: JointState) -> PerJoint:
        """Energy of the strain, J."""
        stored = self._strengths * self._yield_angles * self._strain(at) ** 2 / 2
        return jnp.sum(stored, axis=0)

    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """The stiffness of those that do not slide on, N m/rad; no damping."""
        stiffness = self._strengths / self._yield_angles
        stiffness = jnp.sum(jnp.where(self._slide(at), 0, stiffness), axis=0)
        return stiffness, jnp.zeros_like(stiffness)

    def dissipation(self, at: JointState) -> PerJoint:
        """Power that becomes heat where elements slide, W."""
        heat = self._strengths * jnp.abs(at.rates)[None]
        return jnp.sum(jnp.where(self._slide(at), heat, 0), axis=0)

    def _strain(self, at: JointState) -> States:
        """Strain of each over its yield angle, between -1 and 1."""
        return limited((at.angles[None] - at.states) / self._yield_angles, -1, 1)

    def _slide(self, at: JointState) -> Bool[Array, "row joint"]:
        strain, width = at.angles[None] - at.states, self._yield_angles
        # One that slides is at its limit but for rounding.
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
    """Hysteresis of the joints, beside their springs; by default there is none.

    It depends on the way of a joint and not on its rate: after a motion to and fro the joint does
    not come back to where it was, however slowly it moves. Its states are those of `memory`, and
    then those of `stops`.
    """

    memory: Memory = eqx.field(default_factory=Memory)
    stops: Stops = eqx.field(default_factory=Stops)

    @property
    def laws(self) -> tuple[AbstractJointLaw, ...]:
        """Those that joints have."""
        return tuple(law for law in (self.memory, self.stops) if law.rows)
