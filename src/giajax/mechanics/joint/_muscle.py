"""Muscle laws: force as a function of pressure and contraction, and the inverse."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...runtime.arrays import Array, Bool, Float, Int, Scalar, larger, limited
from ...runtime.text import InputError
from ...schema import BRAIDED, EMPIRICAL, FRICTION, PISTON
from ...schema.parameters import is_concrete, parameter
from ..hysteresis import stop
from ._geometry import Shaped

REACHED, NEEDS_PUSH, NEEDS_PRESSURE, TOO_SHORT, PULLS_ANYWAY = range(5)

_MEANING = {
    REACHED: "reached",
    NEEDS_PUSH: "the muscle would have to push, which is impossible: increase the "
    "co-contraction torque",
    NEEDS_PRESSURE: "the required pressure exceeds the pressure limit: give a smaller force or a "
    "muscle of larger diameter",
    TOO_SHORT: "the muscle does not reach this contraction at any pressure: give a smaller "
    "contraction",
    PULLS_ANYWAY: "the force of the muscle exceeds the required force even at zero pressure: "
    "give a larger force",
}


class PressureAnswer(eqx.Module):
    """Pressure that produces a required force. All arrays have the same shape.

    Attributes:
        pressure: pressure between 0 and the limit of the muscle, Pa; if the force is out of reach,
            the pressure whose force is nearest to it.
        force: force of the muscle at this pressure, N.
        code: 0: the force is reached; 1: the muscle would have to push; 2: the required pressure
            exceeds the limit; 3: the muscle does not contract this far at any pressure; 4: the
            force of the muscle is larger even at zero pressure.
    """

    pressure: Shaped
    force: Shaped
    code: Int[Array, "*shape"]

    @property
    def reached(self) -> Bool[Array, "*shape"]:
        """Whether the muscle produces the required force."""
        return self.code == REACHED

    def message(self, index: int | tuple[int, ...] = ()) -> str:
        """Return the meaning of the code of one element, and what to do."""
        return _MEANING[int(self.code[index])]


PressureAndGain = tuple[Shaped, Shaped]
"""Pressure (Pa) for a force, and the derivative of the force with respect to pressure (N/Pa)."""

_NO_FORCE = 1e-9  # N; a smaller negative force is a rounding error of zero


class AbstractMuscle(eqx.Module):
    """Statics of a muscle or another actuator without friction.

    Its methods take gauge pressures (Pa), forces (N), contractions relative to the rest length, and
    the rest length (m).
    """

    name: ClassVar[str]
    own_motion: ClassVar[int]
    """Sign of the recorded displacement due to the actuator's own force: +1 for a shortening."""
    pushes: ClassVar[bool]
    """Whether the force may be negative. If not, the actuator is slack beyond its reach."""
    pressure_limit: eqx.AbstractVar[Scalar]
    """Highest pressure, Pa."""

    @abc.abstractmethod
    def signed_force(self, pressure: Shaped, contraction: Shaped, length: Scalar) -> Shaped:
        """Return the force according to the law, N; negative where a slack muscle has no force."""

    @abc.abstractmethod
    def pressure_for(self, force: Shaped, contraction: Shaped, length: Scalar) -> PressureAndGain:
        """Return the pressure for a force >= 0 according to the law, Pa, and the gain, N/Pa.

        The gain is the derivative of the force with respect to the pressure. If it is not positive,
        no such pressure exists, and the returned pressure has no meaning.
        """

    def force(self, pressure: Shaped, contraction: Shaped, length: Scalar) -> Shaped:
        """Return the force, N: that of the law, or 0 if the actuator is slack."""
        force = self.signed_force(pressure, contraction, length)
        return force if self.pushes else larger(force, 0)

    def answer(self, force: Shaped, contraction: Shaped, length: Scalar) -> PressureAnswer:
        """Return the pressure for a force at a contraction, or the pressure nearest to it.

        The code of the answer gives the reason if the force is out of reach. The arguments are not
        checked.
        """
        needed, gain = self.pressure_for(larger(force, 0), contraction, length)
        able = gain > 0
        pressure = jnp.where(able, limited(needed, 0, self.pressure_limit), self.pressure_limit)
        push, nothing = force < -_NO_FORCE, ~able & (force <= _NO_FORCE)
        # Zero pressure gives the force that is nearest to a push, or to zero where the muscle
        # cannot pull.
        pressure = jnp.where(push | nothing, 0, pressure)
        code = jnp.select(
            [push, nothing, ~able, needed > self.pressure_limit, needed * gain < -_NO_FORCE],
            [NEEDS_PUSH, REACHED, TOO_SHORT, NEEDS_PRESSURE, PULLS_ANYWAY],
            REACHED,
        )
        return PressureAnswer(pressure, self.force(pressure, contraction, length), code)


class Friction(eqx.Module):
    """Coulomb friction whose half-width depends on the pressure.

    If the motion is recorded, friction is a stop operator of the displacement. After a reversal,
    the force changes linearly from one side of the loop to the other over a distance of twice
    `presliding`. The sign of the velocity would not be suitable, because it changes with the noise
    and is not differentiable.

    Arguments:
        half_width: half of the force difference between the two directions at each of `pressures`,
            N.
        presliding: displacement from rest to full friction, m.
        pressures: increasing pressures, Pa; half-widths are interpolated linearly between them and
            constant beyond them.
    """

    half_width: Float[Array, " node"] = parameter(FRICTION.half_width)
    presliding: Scalar = parameter(FRICTION.presliding)
    pressures: tuple[float, ...] = eqx.field(default=(0.0,), static=True)

    def __check_init__(self) -> None:
        if np.any(np.diff(self.pressures) <= 0) or not self.pressures:
            raise InputError(
                "the friction pressures do not increase: sort them, and give each pressure once"
            )

    @classmethod
    def at_pressures(cls, pressures: tuple[float, ...]) -> "Friction":
        """Create the default friction with one half-width for each pressure (Pa)."""
        default = cls()
        return cls(
            half_width=jnp.full(len(pressures), default.half_width),
            presliding=default.presliding,
            pressures=pressures,
        )

    def width(self, pressure: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """Return the half-width at pressures (Pa), N."""
        nodes = jnp.asarray(self.pressures, dtype=pressure.dtype)
        return jnp.interp(pressure, nodes, self.half_width)

    def engagement(self, displacement: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """Return the fraction of the friction that acts at each sample, from -1 to 1.

        The fraction is +1 after a long increase in the displacement. The first sample is at rest.

        Arguments:
            displacement: history of displacements, m.
        """
        thresholds = jnp.atleast_1d(self.presliding)
        return stop(displacement - displacement[0], thresholds)[:, 0] / self.presliding


class BraidedMuscle(AbstractMuscle):
    """Law of a braided (McKibben) muscle.

    F = eta (p - p_0) A [a (1 - k epsilon)^2 - b], a = 3 / tan^2(theta), b = 1 / sin^2(theta).

    A is the cross-section and theta the braid angle (measured from the axis) at rest. The ideal law
    (eta = k = 1, p_0 = 0) follows from the virtual work of the gas in a cylinder of inextensible
    threads. It predicts a contraction of 39 % for thin muscles with a braid angle of 18 deg, but
    they contract by 20 to 25 %, because their ends do not widen and the tube bears a part of the
    pressure. The end correction k decreases the contraction (k = 1.6 gives 24.6 %). Within the dead
    band p_0, the tube does not yet press on the braid. The effectiveness eta accounts for the
    remaining deviations. From the force alone, A and eta cannot be separated.

    References: Chou, Hannaford, IEEE Trans. Robotics and Automation 12 (1996) 90; Tondu, Lopez,
    IEEE Control Systems 20 (2000) 15.
    """

    name: ClassVar[str] = "braided"
    own_motion: ClassVar[int] = 1
    pushes: ClassVar[bool] = False

    diameter: Scalar = parameter(BRAIDED.diameter)
    braid_angle: Scalar = parameter(BRAIDED.braid_angle)
    end_correction: Scalar = parameter(BRAIDED.end_correction)
    effectiveness: Scalar = parameter(BRAIDED.effectiveness)
    dead_band: Scalar = parameter(BRAIDED.dead_band)
    pressure_limit: Scalar = parameter(BRAIDED.pressure_limit)

    @property
    def largest_contraction(self) -> Float[Array, ""]:
        """Contraction at which the force is 0 at any pressure."""
        return (1 - 1 / (jnp.sqrt(3.0) * jnp.cos(self.braid_angle))) / self.end_correction

    def _per_pascal(self, contraction: Shaped) -> Shaped:
        area = jnp.pi / 4 * self.diameter**2
        # Beyond k epsilon = 1, the square would increase again, but the muscle must not pull.
        left = larger(1 - self.end_correction * contraction, 0)
        shrunk = 3 / jnp.tan(self.braid_angle) ** 2 * left**2
        return self.effectiveness * area * (shrunk - 1 / jnp.sin(self.braid_angle) ** 2)

    def signed_force(self, pressure: Shaped, contraction: Shaped, length: Scalar) -> Shaped:
        """Return the force according to the law, N."""
        return larger(pressure - self.dead_band, 0) * self._per_pascal(contraction)

    def pressure_for(self, force: Shaped, contraction: Shaped, length: Scalar) -> PressureAndGain:
        """Return the pressure for a force, Pa, and the gain, N/Pa."""
        gain = self._per_pascal(contraction)
        return self.dead_band + force / jnp.where(gain > 0, gain, 1), gain


class EmpiricalMuscle(AbstractMuscle):
    """Empirical law of a muscle.

    F = F_max(L) f(e, q), e = epsilon / contraction_limit, q = p / pressure_limit.

    F_max(L) = force_limit (2 / pi) atan((L - end_length) / length_scale) increases with the rest
    length L of the muscle, because the ends do not pull, and saturates. The shape function

        f(e, q) = q exp(-(bell e)^2) - exp(-bell^2) (1 - exp(-decay e)) / (1 - exp(-decay))

    consists of an active part that is proportional to the pressure and a passive part that does not
    depend on it. By construction, f(0, 1) = 1 and f(1, 1) = 0: at the pressure limit, the muscle
    pulls with F_max at its rest length and contracts by contraction_limit without a load.

    The law follows Hunt, Graber-Tilton, Quinn, "Modeling length effects of braided pneumatic
    actuators", ASME IDETC 2017, but the condition f(1, 1) = 0 ties the coefficients of the shape.
    """

    name: ClassVar[str] = "empirical"
    own_motion: ClassVar[int] = 1
    pushes: ClassVar[bool] = False

    force_limit: Scalar = parameter(EMPIRICAL.force_limit)
    contraction_limit: Scalar = parameter(EMPIRICAL.contraction_limit)
    bell: Scalar = parameter(EMPIRICAL.bell)
    decay: Scalar = parameter(EMPIRICAL.decay)
    end_length: Scalar = parameter(EMPIRICAL.end_length)
    length_scale: Scalar = parameter(EMPIRICAL.length_scale)
    pressure_limit: Scalar = parameter(EMPIRICAL.pressure_limit)

    def largest_force(self, length: Scalar) -> Scalar:
        """Return F_max of a muscle with this rest length (m), N."""
        reach = larger(length - self.end_length, 0) / self.length_scale
        return self.force_limit * (2 / jnp.pi) * jnp.arctan(reach)

    def _passive(self, strain: Shaped) -> Shaped:
        rise = jnp.expm1(-self.decay * strain) / jnp.expm1(-self.decay)
        return jnp.exp(-(self.bell**2)) * rise

    def signed_force(self, pressure: Shaped, contraction: Shaped, length: Scalar) -> Shaped:
        """Return the force according to the law, N; 0 or negative without pressure."""
        strain = contraction / self.contraction_limit
        active = pressure / self.pressure_limit * jnp.exp(-((self.bell * strain) ** 2))
        return self.largest_force(length) * (active - self._passive(strain))

    def pressure_for(self, force: Shaped, contraction: Shaped, length: Scalar) -> PressureAndGain:
        """Return the pressure for a force, Pa, and the gain, N/Pa."""
        strain = contraction / self.contraction_limit
        largest = self.largest_force(length)
        gain = largest * jnp.exp(-((self.bell * strain) ** 2)) / self.pressure_limit
        lacking = force + largest * self._passive(strain)
        return lacking / jnp.where(gain > 0, gain, 1), gain


class Piston(AbstractMuscle):
    """Law of a piston: F = p A + offset, A = pi bore^2 / 4.

    The force pushes outwards and can have either sign, as a load cell records it. The recorded
    position increases when the piston is pushed in.
    """

    name: ClassVar[str] = "piston"
    own_motion: ClassVar[int] = -1
    pushes: ClassVar[bool] = True

    bore: Scalar = parameter(PISTON.bore)
    offset: Scalar = parameter(PISTON.offset)
    pressure_limit: Scalar = parameter(PISTON.pressure_limit)

    @property
    def area(self) -> Float[Array, ""]:
        """Cross-section of the bore, m^2."""
        return jnp.pi / 4 * self.bore**2

    def signed_force(self, pressure: Shaped, contraction: Shaped, length: Scalar) -> Shaped:
        """Return the force according to the law, N."""
        return pressure * self.area + self.offset

    def pressure_for(self, force: Shaped, contraction: Shaped, length: Scalar) -> PressureAndGain:
        """Return the pressure for a force, Pa, and the gain, N/Pa."""
        return (force - self.offset) / self.area, jnp.broadcast_to(self.area, force.shape)


MUSCLE_LAWS: dict[str, type[BraidedMuscle | EmpiricalMuscle | Piston]] = {
    law.name: law for law in (BraidedMuscle, EmpiricalMuscle, Piston)
}
"""Muscle laws by their names in files."""


def muscle_force(
    muscle: AbstractMuscle,
    pressure: npt.ArrayLike | Array,
    contraction: npt.ArrayLike | Array,
    length: npt.ArrayLike | Array = 1.96,
) -> Shaped:
    """Return the force of a muscle without friction, N; 0 if the muscle is slack.

    Arguments:
        muscle: law of the muscle.
        pressure: gauge pressure, Pa, of any shape.
        contraction: contraction relative to the rest length, of the same shape or one number.
        length: rest length of the muscle, m.

    Raises:
        InputError: a number is not finite, a pressure is negative, or a contraction is 1 or more.

    Example:
        >>> from giajax.mechanics.joint import BraidedMuscle, muscle_force
        >>> float(muscle_force(BraidedMuscle(dead_band=0.0), 100e3, 0.0)) > 17
        True
    """
    pressure, contraction, length = _arrays(pressure, contraction, length)
    _check(contraction, length, pressure=pressure)
    return muscle.force(pressure, contraction, length)


def muscle_pressure(
    muscle: AbstractMuscle,
    force: npt.ArrayLike | Array,
    contraction: npt.ArrayLike | Array,
    length: npt.ArrayLike | Array = 1.96,
) -> PressureAnswer:
    """Return the pressure at which a muscle has a force at a contraction, in closed form.

    Arguments:
        muscle: law of the muscle.
        force: required force, N, of any shape.
        contraction: contraction relative to the rest length, of the same shape or one number.
        length: rest length of the muscle, m.

    Raises:
        InputError: a number is not finite, or a contraction is 1 or more.

    Example:
        >>> from giajax.mechanics.joint import BraidedMuscle, muscle_pressure
        >>> answer = muscle_pressure(BraidedMuscle(), 2.0, 0.35)
        >>> bool(answer.reached), answer.message().partition(": ")[2]
        (False, 'give a smaller contraction')
    """
    force, contraction, length = _arrays(force, contraction, length)
    _check(contraction, length, force=force)
    return muscle.answer(force, contraction, length)


def _arrays(
    first: npt.ArrayLike | Array, contraction: npt.ArrayLike | Array, length: npt.ArrayLike | Array
) -> tuple[Array, Array, Array]:
    dtype = jnp.result_type(float)
    first, contraction, length = (
        jnp.asarray(item, dtype=dtype) for item in (first, contraction, length)
    )
    if length.ndim or (first.ndim and contraction.ndim and first.shape != contraction.shape):
        raise InputError(
            f"values have the shapes {first.shape}, {contraction.shape} and {length.shape}: give "
            "arrays of the same shape, or single numbers, and one length"
        )
    shape = first.shape or contraction.shape
    return jnp.broadcast_to(first, shape), jnp.broadcast_to(contraction, shape), length


def _check(contraction: Array, length: Array, **others: Array) -> None:
    if not is_concrete((contraction, length, *others.values())):
        return
    for what, values in {"contraction": contraction, "length": length, **others}.items():
        if not bool(jnp.all(jnp.isfinite(values))):
            raise InputError(f"a {what} is not finite: give finite numbers")
    if bool(jnp.any(contraction >= 1)):
        raise InputError(
            f"a contraction is {float(jnp.max(contraction)):g}, but must be less than 1: give the "
            "contraction as a fraction of the length at rest, not in percent"
        )
    if "pressure" in others and bool(jnp.any(others["pressure"] < 0)):
        raise InputError(
            f"a pressure is {float(jnp.min(others['pressure'])):g} Pa: give the gauge pressure, "
            "which is at least 0"
        )
