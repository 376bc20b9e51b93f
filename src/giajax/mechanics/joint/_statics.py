"""One joint at rest: the forces that balance its torque, and the corrections alpha and beta."""

import functools
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...runtime.arrays import Array, Bool, Scalar, hypotenuse, smaller
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import ALPHA, BETA, LOAD
from ...schema.parameters import inline, is_concrete, parameter
from ._geometry import (
    Bend,
    JointGeometry,
    MusclePath,
    Point,
    Shaped,
    check_geometry,
    inner_bend,
    inner_path,
    outer_bend,
    outer_path,
)

# An erratum. With the angle negative on the outer side, the paper prints
#
#     beta = 0.01 (1 - theta / 2)            for -2 <= theta <= 0 (deg),
#     beta = -0.3 (theta - 20)^2 / 1600      for theta <= -20.
#
# Read so, beta jumps from 0.02 N m to 0 at -2 deg, from 0 to -0.3 N m at -20 deg, and reaches
# -1.2 N m at -60 deg: the muscle would have to balance 0.3 - 1.2 = -0.9 N m, that is to push.
# With the magnitude of the angle instead, beta falls from 0.01 N m at 0 to 0 at 2 deg, stays there
# to 20 deg, and reaches -0.3 N m at 60 deg, where the force of the outer muscle is then 0: it is
# continuous, and "connecting the whole smoothly", as the text says. This reading is the default;
# the printed one is kept by name.

Reading = Literal["continuous", "printed", "none"]
READINGS: tuple[str, ...] = get_args(Reading)


class Alpha(eqx.Module):
    """Correction on the inner side: a constant, and beyond a threshold the balloons' resistance.

    alpha = offset + curvature max(angle - threshold, 0)^2.
    """

    offset: Scalar = parameter(ALPHA.offset)
    threshold: Scalar = parameter(ALPHA.threshold)
    curvature: Scalar = parameter(ALPHA.curvature)

    def __call__(self, angle: Shaped) -> Shaped:
        """Alpha at bending angles (rad), N m."""
        return self.offset + self.curvature * jnp.maximum(angle - self.threshold, 0) ** 2


class Beta(eqx.Module):
    """Correction on the outer side: a wedge at the straight joint, and a fall beyond a threshold.

    With the magnitude of the angle,
    beta = offset max(1 - |angle| / width, 0) - curvature max(|angle| - threshold, 0)^2.
    """

    offset: Scalar = parameter(BETA.offset)
    width: Scalar = parameter(BETA.width)
    threshold: Scalar = parameter(BETA.threshold)
    curvature: Scalar = parameter(BETA.curvature)

    def __call__(self, angle: Shaped) -> Shaped:
        """Beta at bending angles (rad, of either sign), N m, in the continuous reading."""
        size = jnp.abs(angle)
        # A blend that ends where the wedge does has half of the slope there, as results have it.
        wedge = self.offset * jnp.maximum(1 - size / self.width, 0)
        return wedge - self.curvature * jnp.maximum(size - self.threshold, 0) ** 2

    def printed(self, angle: Shaped) -> Shaped:
        """Beta as the paper prints it, for angles <= 0 (rad), N m; 0 where it says nothing."""
        wedge = self.offset * (1 - angle / self.width)
        fall = -self.curvature * (angle - self.threshold) ** 2
        far = angle <= -self.threshold
        return jnp.where(angle >= -self.width, wedge, jnp.where(far, fall, 0))


class Correction(eqx.Module):
    """What is added to the torque that the muscles balance.

    Arguments:
        alpha, beta: the families of the inner and the outer side.
        reading: "continuous", "printed" (the paper's formulae to the letter; see the erratum in
            this module), or "none" for both zero (fig. 9).
        blend: half-width of the range about 0 in which alpha and beta are joined by a cubic with
            their values and slopes at its ends, rad. With 0, the default and the paper's, the
            correction jumps at 0 from beta's offset to alpha's.
    """

    alpha: Alpha = eqx.field(default_factory=Alpha)
    beta: Beta = eqx.field(default_factory=Beta)
    reading: str = eqx.field(default="continuous", static=True)
    blend: float = eqx.field(default=0.0, converter=float, static=True)

    def __check_init__(self) -> None:
        if self.reading not in READINGS:
            raise InputError(
                f"there is no correction '{self.reading}': use one of {', '.join(READINGS)}"
            )
        if not 0 <= self.blend <= np.pi / 6:
            raise InputError(
                f"the correction is blended over {np.rad2deg(self.blend):g} deg about 0: give a "
                "half-width of 0 to 30 deg"
            )

    def __call__(self, angle: Shaped, inner: Bool[Array, "*shape"]) -> Shaped:
        """Correction of a muscle's balanced torque, N m.

        Arguments:
            angle: bending angle of the muscle, rad; positive where it is the inner one.
            inner: whether alpha holds, or beta: what decides at 0.
        """
        if self.reading == "none":
            return jnp.zeros_like(angle)
        outside = self.beta.printed(angle) if self.reading == "printed" else self.beta(angle)
        correction = jnp.where(inner, self.alpha(angle), outside)
        if self.blend == 0:
            return correction
        return jnp.where(jnp.abs(angle) < self.blend, self._bridge(angle), correction)

    def _bridge(self, angle: Shaped) -> Shaped:
        width = jnp.asarray(self.blend, dtype=angle.dtype)
        start, start_slope = eqx.filter_jvp(self.beta, (-width,), (jnp.ones_like(width),))
        end, end_slope = eqx.filter_jvp(self.alpha, (width,), (jnp.ones_like(width),))
        s = (angle + width) / (2 * width)
        return (
            (1 + 2 * s) * (1 - s) ** 2 * start
            + s**2 * (3 - 2 * s) * end
            + 2 * width * s * (1 - s) * ((1 - s) * start_slope - s * end_slope)
        )


# Of the Gauss rule of two points, on an interval from 0 to 1; exact for a cubic.
_POINTS = (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12))


def resistance(correction: Correction, angle: Shaped, ahead: Bool[Array, "*shape"]) -> Shaped:
    """Torque with which the corrections of both muscles of a pair resist, towards 0, N m.

    At angles (rad); `ahead`, whether the first muscle is the inner one, decides at 0.
    """
    return correction(angle, ahead) - correction(-angle, ~ahead)


def resistance_energy(correction: Correction, angle: Shaped) -> Shaped:
    """Energy that bending to angles (rad) stores against `resistance`, J; 0 in the straight joint.

    Between two kinks the resistance is a cubic of the angle, so that the sum over the pieces is
    exact. The reading must be the continuous one, or none.
    """
    size = jnp.abs(angle)
    beta = correction.beta
    bends = [jnp.asarray(correction.blend), beta.width, beta.threshold, correction.alpha.threshold]
    kinks = jnp.sort(jnp.stack([jnp.asarray(x, size.dtype) for x in bends]))
    ends = [jnp.zeros_like(size), *(smaller(size, kink) for kink in kinks), size]
    energy = jnp.zeros_like(size)
    for start, end in pairwise(ends):
        width = end - start
        for point in _POINTS:
            at = start + point * width
            energy = energy + width / 2 * resistance(correction, at, jnp.ones(at.shape, bool))
    return energy


class MuscleState(eqx.Module):
    """A muscle of a joint at rest; arrays of one shape, that of the angles.

    Attributes:
        angle: bending angle of the muscle, rad.
        torque: that the muscle balances, its correction included, N m.
        path: its path.
        contraction: epsilon of eq. (2), relative to L_pam.
        lever: of the muscle's force about the joint's centre, m.
        force: tension F of the muscle, N. Negative where it would have to push.
        wire_tension: F_w, N; 0 where the wire is slack.
        push_x, push_y: push F_b of the muscle on the balloon of the right link (eq. 9), N; 0
            where it touches no balloon.
    """

    angle: Shaped
    torque: Shaped
    path: MusclePath
    contraction: Shaped
    lever: Shaped
    force: Shaped
    wire_tension: Shaped
    push_x: Shaped
    push_y: Shaped

    @property
    def branch(self) -> Array:
        """0 inner and taut, 1 inner and slack, 2 outer and straight, 3 outer and wrapped."""
        inside = jnp.where(self.path.engaged, 0, 1)
        return jnp.where(self.path.inner, inside, jnp.where(self.path.engaged, 3, 2))


class Tension(NamedTuple):
    """What one newton of a muscle's tension does; arrays of one shape.

    Attributes:
        path: of the muscle.
        lever: of its force about the joint's centre, m.
        wire: tension of the wire.
        push: of the muscle on the balloon of the right link.
    """

    path: MusclePath
    lever: Shaped
    wire: Shaped
    push: Point


def inner_tension(geometry: JointGeometry, bend: Bend) -> Tension:
    """The tension of an inner muscle (eqs 4 to 6)."""
    path = inner_path(geometry, bend)
    anchor, wire_end, taut = geometry.anchor(bend), geometry.wire_end(bend), path.engaged
    bush = (jnp.zeros_like(path.height), path.height)
    # Force of the muscle on the right link at C. A straight muscle pulls along -x.
    bent = _unit(anchor, bush)
    pull = jnp.where(taut, bent[0], -1), jnp.where(taut, bent[1], 0)
    # Eq. (4): the wire takes what the muscle pushes the bush along the bisector.
    hold = _unit(wire_end, bush)
    wire = jnp.where(taut, -pull[1] / jnp.where(taut, hold[1], 1), 0)
    lever = _moment(anchor, pull) + wire * _moment(wire_end, hold)
    return Tension(path, lever, wire, (jnp.zeros_like(lever), jnp.zeros_like(lever)))


def outer_tension(geometry: JointGeometry, bend: Bend) -> Tension:
    """The tension of an outer muscle (eqs 9 to 11)."""
    path = outer_path(geometry, bend)
    anchor, contact, wrapped = geometry.anchor(bend), geometry.contact(bend), path.engaged
    # Force of the muscle on the right link at N.
    bent = _unit(anchor, (contact[0], path.height))
    pull = jnp.where(wrapped, bent[0], -1), jnp.where(wrapped, bent[1], 0)
    # Eq. (9): the push on the balloon's shoulder; the muscle leaves it towards N and towards P.
    push = jnp.where(wrapped, -pull[0] - 1, 0), jnp.where(wrapped, -pull[1], 0)
    lever = _moment(anchor, pull) + jnp.where(wrapped, _moment(contact, push), 0)
    return Tension(path, lever, jnp.zeros_like(lever), push)


def muscle_balance(
    geometry: JointGeometry,
    angle: Shaped,
    torque: Shaped,
    inner: Bool[Array, "*shape"] | None = None,
) -> MuscleState:
    """Forces that balance a torque (N m), the correction already in it (eqs 4 to 6, 9 to 11).

    Everything is in closed form: the paper's equations are linear in the forces. Bending angles are
    those of the muscle, rad; `inner` is the side, as in `muscle_path`. Nothing is checked.
    """
    inner = angle >= 0 if inner is None else inner
    unit = jax.tree.map(
        functools.partial(jnp.where, inner),
        inner_tension(geometry, inner_bend(angle, inner)),
        outer_tension(geometry, outer_bend(angle, inner)),
    )
    return balance_of(unit, geometry, angle, torque)


def balance_of(
    unit: Tension, geometry: JointGeometry, angle: Shaped, torque: Shaped
) -> MuscleState:
    """State of a muscle that balances a torque (N m), from what a newton of it does."""
    force = torque / unit.lever
    return MuscleState(
        angle=angle,
        torque=torque,
        path=unit.path,
        contraction=1 - unit.path.length / geometry.muscle_length,
        lever=unit.lever,
        force=force,
        wire_tension=force * unit.wire,
        push_x=force * unit.push[0],
        push_y=force * unit.push[1],
    )


def _unit(tail: Point, head: Point) -> Point:
    x, y = head[0] - tail[0], head[1] - tail[1]
    length = hypotenuse(x, y)
    return x / length, y / length


def _moment(at: Point, force: Point) -> Array:
    return at[0] * force[1] - at[1] * force[0]


class Joint(eqx.Module):
    """One joint: its geometry, the corrections, and the torque that is on it at all times.

    Arguments:
        geometry: where muscle, wire and balloon are.
        correction: alpha and beta; their parameters are `alpha.offset`, `beta.curvature`, ...
        torque: what each muscle balances beside the correction, N m.
    """

    geometry: JointGeometry = eqx.field(default_factory=JointGeometry)
    correction: Correction = eqx.field(default_factory=Correction, metadata=dict(inline().metadata))
    torque: Scalar = parameter(LOAD.torque)


def muscle_state(
    joint: Joint,
    angle: npt.ArrayLike | Array,
    torque: npt.ArrayLike | Array | None = None,
    side: str | None = None,
) -> MuscleState:
    """Contraction and forces of one muscle that balances a torque on the joint at rest.

    The state is in closed form on every branch. It is continuous across the branches; at 0 the
    force steps by the difference of alpha and beta, unless the correction is blended.

    Arguments:
        angle: bending angle of the muscle, rad, of any shape: positive where the joint bends
            towards it (inner), negative where it bends away (outer).
        torque: on the joint, without the correction, N m, a number or of the angle's shape; that
            of the joint (0.3 N m) by default.
        side: "inner" or "outer" at an angle of 0, where both hold; "inner" by default.

    Raises:
        InputError: the geometry is impossible at one of the angles, an angle beyond 90 deg, a
            number that is not finite, or a side that contradicts an angle.

    Example:
        >>> import numpy as np
        >>> from giajax.mechanics.joint import Joint, muscle_state
        >>> state = muscle_state(Joint(), np.deg2rad([40.0, -60.0]))
        >>> [round(float(force), 2) for force in state.force]
        [1.56, 0.0]
    """
    dtype = jnp.result_type(float)
    angle = jnp.asarray(angle, dtype=dtype)
    torque = joint.torque if torque is None else jnp.asarray(torque, dtype=dtype)
    if torque.shape not in ((), angle.shape):
        raise InputError(
            f"the torque has the shape {torque.shape} and the angle {angle.shape}: give one "
            "torque, or one for each angle"
        )
    torque = jnp.broadcast_to(torque, angle.shape)
    if side not in (None, "inner", "outer"):
        raise InputError(f"the side is {side!r}: use 'inner' or 'outer'")
    if is_concrete((joint, angle, torque)):
        _check(joint, angle, torque, side)
    inner = angle >= 0 if side is None else jnp.full(angle.shape, side == "inner")
    return _muscle_state(joint, angle, torque, inner)


def balanced(joint: Joint, angle: Array, torque: Array, inner: Array) -> MuscleState:
    """State of a muscle at angles (rad) with its correction beside a torque (N m); unchecked."""
    corrected = torque + joint.correction(angle, inner)
    return muscle_balance(joint.geometry, angle, corrected, inner)


_muscle_state = program(balanced)


def _check(joint: Joint, angle: Array, torque: Array, side: str | None) -> None:
    if not bool(jnp.all(jnp.isfinite(angle)) & jnp.all(jnp.isfinite(torque))):
        raise InputError("an angle or a torque is not finite: give finite numbers")
    if bool(jnp.any(jnp.abs(angle) > jnp.pi / 2)):
        worst = float(jnp.rad2deg(angle.ravel()[jnp.argmax(jnp.abs(angle))]))
        raise InputError(
            f"the bending angle is {worst:.4g} deg, but a joint bends by at most 90 deg: give "
            "radians, not degrees"
        )
    wrong = {"inner": angle < 0, "outer": angle > 0}.get(side or "")
    if wrong is not None and bool(jnp.any(wrong)):
        at = float(jnp.rad2deg(angle.ravel()[jnp.argmax(wrong)]))
        raise InputError(
            f"at {at:.4g} deg the muscle is not on the {side} side: omit the side, or give the "
            f"angle with "
            "the opposite sign"
        )
    check_geometry(joint.geometry, jax.device_get(angle))
