"""Statics of one joint: forces that balance its torque, and the corrections alpha and beta."""

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

# An erratum. The angle is negative on the outer side, and the paper prints
#
#     beta = 0.01 (1 - theta / 2)            for -2 <= theta <= 0 (deg),
#     beta = -0.3 (theta - 20)^2 / 1600      for theta <= -20.
#
# As printed, beta jumps from 0.02 N m to 0 at -2 deg and from 0 to -0.3 N m at -20 deg, and reaches
# -1.2 N m at -60 deg. The muscle would then have to balance 0.3 - 1.2 = -0.9 N m, that is, to push.
# With the magnitude of the angle instead, beta decreases from 0.01 N m at 0 to 0 at 2 deg, remains
# 0 up to 20 deg, and reaches -0.3 N m at 60 deg, where the force of the outer muscle becomes 0.
# This function is continuous and agrees with the text of the paper ("connecting the whole
# smoothly"). It is the default. The printed form can be selected by its name.

Reading = Literal["continuous", "printed", "none"]
READINGS: tuple[str, ...] = get_args(Reading)


class Alpha(eqx.Module):
    """Correction on the inner side: a constant, plus the resistance of the balloons.

    alpha = offset + curvature max(angle - threshold, 0)^2.
    """

    offset: Scalar = parameter(ALPHA.offset)
    threshold: Scalar = parameter(ALPHA.threshold)
    curvature: Scalar = parameter(ALPHA.curvature)

    def __call__(self, angle: Shaped) -> Shaped:
        """Return alpha at bending angles (rad), N m."""
        return self.offset + self.curvature * jnp.maximum(angle - self.threshold, 0) ** 2


class Beta(eqx.Module):
    """Correction on the outer side: a wedge near the straight joint, and a fall at large angles.

    beta = offset max(1 - |angle| / width, 0) - curvature max(|angle| - threshold, 0)^2.
    """

    offset: Scalar = parameter(BETA.offset)
    width: Scalar = parameter(BETA.width)
    threshold: Scalar = parameter(BETA.threshold)
    curvature: Scalar = parameter(BETA.curvature)

    def __call__(self, angle: Shaped) -> Shaped:
        """Return beta at bending angles (rad, of either sign), N m, in the continuous reading."""
        size = jnp.abs(angle)
        # `maximum` has the mean of both slopes at the end of the wedge. A blend that ends there
        # uses this slope, and stored results depend on it.
        wedge = self.offset * jnp.maximum(1 - size / self.width, 0)
        return wedge - self.curvature * jnp.maximum(size - self.threshold, 0) ** 2

    def printed(self, angle: Shaped) -> Shaped:
        """Return beta as printed in the paper, for angles <= 0 (rad), N m; 0 where undefined."""
        wedge = self.offset * (1 - angle / self.width)
        fall = -self.curvature * (angle - self.threshold) ** 2
        far = angle <= -self.threshold
        return jnp.where(angle >= -self.width, wedge, jnp.where(far, fall, 0))


class Correction(eqx.Module):
    """Correction that is added to the torque that the muscles balance.

    Arguments:
        alpha, beta: corrections on the inner and on the outer side.
        reading: "continuous", "printed" (the formulae exactly as in the paper; see the erratum in
            this module), or "none" (both corrections are zero, as in fig. 9).
        blend: half-width of the interval about 0 in which a cubic joins alpha and beta, rad. The
            cubic has their values and slopes at the ends of the interval. With 0, which is the
            default and the choice of the paper, the correction jumps at 0 from the offset of beta
            to that of alpha.
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
                "the half-width of the interval in which the correction is blended is "
                f"{np.rad2deg(self.blend):g} deg: give 0 to 30 deg"
            )

    def __call__(self, angle: Shaped, inner: Bool[Array, "*shape"]) -> Shaped:
        """Return the correction of the torque that a muscle balances, N m.

        Arguments:
            angle: bending angle of the muscle, rad; positive if it is the inner muscle.
            inner: whether to use alpha (true) or beta (false); the angle does not determine this
                at 0.
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


# Points of the two-point Gauss rule on the interval from 0 to 1. The rule is exact for a cubic.
_POINTS = (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12))


def resistance(correction: Correction, angle: Shaped, ahead: Bool[Array, "*shape"]) -> Shaped:
    """Return the resisting torque of the corrections of both muscles of a pair, towards 0, N m.

    Arguments:
        correction: the correction.
        angle: bending angles of the pair, rad.
        ahead: whether the first muscle is the inner muscle; needed at an angle of 0.
    """
    return correction(angle, ahead) - correction(-angle, ~ahead)


def resistance_energy(correction: Correction, angle: Shaped) -> Shaped:
    """Return the energy stored by bending against `resistance`, J; 0 in the straight joint.

    Between two kinks the resistance is a polynomial of the angle of at most third degree, so the
    sum over the pieces is exact. The reading must be "continuous" or "none".

    Arguments:
        correction: the correction.
        angle: bending angles, rad.
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
    """State of a muscle of a joint at rest. All arrays have the shape of the angles.

    Attributes:
        angle: bending angle of the muscle, rad.
        torque: torque that the muscle balances, including its correction, N m.
        path: path of the muscle.
        contraction: contraction epsilon of eq. (2), relative to L_pam.
        lever: lever arm of the muscle force about the centre of the joint, m.
        force: tension F of the muscle, N; negative if the muscle would have to push.
        wire_tension: tension F_w of the wire, N; 0 if the wire is slack.
        push_x, push_y: components of the force F_b of the muscle on the balloon of the right link
            (eq. 9), N; 0 if the muscle touches no balloon.
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
        """Branch: 0 inner, taut; 1 inner, slack; 2 outer, straight; 3 outer, wrapped."""
        inside = jnp.where(self.path.engaged, 0, 1)
        return jnp.where(self.path.inner, inside, jnp.where(self.path.engaged, 3, 2))


class Tension(NamedTuple):
    """Effects of a muscle tension of 1 N. All arrays have the same shape.

    Attributes:
        path: path of the muscle.
        lever: lever arm of the muscle force about the centre of the joint, m.
        wire: tension of the wire, N.
        push: force of the muscle on the balloon of the right link, N.
    """

    path: MusclePath
    lever: Shaped
    wire: Shaped
    push: Point


def inner_tension(geometry: JointGeometry, bend: Bend) -> Tension:
    """Return the effects of a tension of 1 N in an inner muscle (eqs 4 to 6)."""
    path = inner_path(geometry, bend)
    anchor, wire_end, taut = geometry.anchor(bend), geometry.wire_end(bend), path.engaged
    bush = (jnp.zeros_like(path.height), path.height)
    # Force of the muscle on the right link at C. A straight muscle pulls along -x.
    bent = _unit(anchor, bush)
    pull = jnp.where(taut, bent[0], -1), jnp.where(taut, bent[1], 0)
    # Eq. (4): the wire balances the force of the muscle on the bush along the bisector.
    hold = _unit(wire_end, bush)
    wire = jnp.where(taut, -pull[1] / jnp.where(taut, hold[1], 1), 0)
    lever = _moment(anchor, pull) + wire * _moment(wire_end, hold)
    return Tension(path, lever, wire, (jnp.zeros_like(lever), jnp.zeros_like(lever)))


def outer_tension(geometry: JointGeometry, bend: Bend) -> Tension:
    """Return the effects of a tension of 1 N in an outer muscle (eqs 9 to 11)."""
    path = outer_path(geometry, bend)
    anchor, contact, wrapped = geometry.anchor(bend), geometry.contact(bend), path.engaged
    # Force of the muscle on the right link at N.
    bent = _unit(anchor, (contact[0], path.height))
    pull = jnp.where(wrapped, bent[0], -1), jnp.where(wrapped, bent[1], 0)
    # Eq. (9): the force on the balloon's shoulder is the sum of the tensions towards N and P.
    push = jnp.where(wrapped, -pull[0] - 1, 0), jnp.where(wrapped, -pull[1], 0)
    lever = _moment(anchor, pull) + jnp.where(wrapped, _moment(contact, push), 0)
    return Tension(path, lever, jnp.zeros_like(lever), push)


def muscle_balance(
    geometry: JointGeometry,
    angle: Shaped,
    torque: Shaped,
    inner: Bool[Array, "*shape"] | None = None,
) -> MuscleState:
    """Return the forces of a muscle that balance a torque (eqs 4 to 6 and 9 to 11).

    The solution is in closed form, because the equations of the paper are linear in the forces. The
    arguments are not checked.

    Arguments:
        geometry: geometry of the joint.
        angle: bending angles of the muscle, rad.
        torque: torque that the muscle balances, including the correction, N m.
        inner: whether the muscle is the inner one; see `muscle_path`.
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
    """Return the state of a muscle that balances a torque (N m), from the effects of 1 N."""
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
    """One joint: geometry, corrections, and the constant torque that its muscles balance.

    Arguments:
        geometry: positions of muscle, wire and balloon.
        correction: corrections alpha and beta, with parameters such as `alpha.offset` and
            `beta.curvature`.
        torque: torque that each muscle balances in addition to the correction, N m.
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
    """Return contraction and forces of one muscle that balances a torque on the joint at rest.

    The solution is in closed form on every branch and continuous across the branches. At an angle
    of 0, the force jumps because alpha and beta differ, unless the correction is blended.

    Arguments:
        joint: the joint.
        angle: bending angle of the muscle, rad, of any shape: positive if the joint bends towards
            the muscle (inner), negative if it bends away from the muscle (outer).
        torque: torque on the joint without the correction, N m; a number, or an array with the
            shape of the angle; by default the torque of the joint (0.3 N m).
        side: "inner" or "outer", which selects the side at an angle of 0; "inner" by default.

    Raises:
        InputError: the geometry is impossible at one of the angles, an angle is beyond 90 deg, a
            number is not finite, or the side contradicts an angle.

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
    """Return the state of a muscle that balances a torque (N m) and its correction; unchecked."""
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
            "angle with the opposite sign"
        )
    check_geometry(joint.geometry, jax.device_get(angle))
