"""The paper's empirical corrections alpha and beta of the balanced torque (section III.B).

An erratum. With the angle negative on the outer side, the paper prints

    beta = 0.01 (1 - theta / 2)            for -2 <= theta <= 0 (deg),
    beta = -0.3 (theta - 20)^2 / 1600      for theta <= -20.

Read so, beta jumps from 0.02 N m to 0 at -2 deg, from 0 to -0.3 N m at -20 deg, and reaches
-1.2 N m at -60 deg: the muscle would have to balance 0.3 - 1.2 = -0.9 N m, that is to push.
With the magnitude of the angle instead, beta falls from 0.01 N m at 0 to 0 at 2 deg, stays there
to 20 deg, and reaches -0.3 N m at 60 deg, where the force of the outer muscle is then 0: it is
continuous, and "connecting the whole smoothly", as the text says. This reading is the default; the
printed one is kept by name.
"""

from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..parameters import parameter
from ..quantities import ALPHA, BETA

Reading = Literal["continuous", "printed", "none"]
READINGS: tuple[str, ...] = get_args(Reading)


class Alpha(eqx.Module):
    """Correction on the inner side: a constant, and beyond a threshold the balloons' resistance.

    alpha = offset + curvature max(angle - threshold, 0)^2.
    """

    offset: Scalar = parameter(ALPHA.offset)
    threshold: Scalar = parameter(ALPHA.threshold)
    curvature: Scalar = parameter(ALPHA.curvature)

    def __call__(self, angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Alpha at bending angles (rad), N m."""
        return self.offset + self.curvature * _beyond(angle, self.threshold) ** 2


class Beta(eqx.Module):
    """Correction on the outer side: a wedge at the straight joint, and a fall beyond a threshold.

    With the magnitude of the angle,
    beta = offset max(1 - |angle| / width, 0) - curvature max(|angle| - threshold, 0)^2.
    """

    offset: Scalar = parameter(BETA.offset)
    width: Scalar = parameter(BETA.width)
    threshold: Scalar = parameter(BETA.threshold)
    curvature: Scalar = parameter(BETA.curvature)

    def __call__(self, angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Beta at bending angles (rad, of either sign), N m, in the continuous reading."""
        size = jnp.abs(angle)
        wedge = self.offset * jnp.maximum(1 - size / self.width, 0)
        return wedge - self.curvature * _beyond(size, self.threshold) ** 2

    def printed(self, angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
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

    def __call__(
        self, angle: Float[Array, "*shape"], inner: Bool[Array, "*shape"]
    ) -> Float[Array, "*shape"]:
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

    def _bridge(self, angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        width = jnp.asarray(self.blend, dtype=angle.dtype)
        start, start_slope = eqx.filter_jvp(self.beta, (-width,), (jnp.ones_like(width),))
        end, end_slope = eqx.filter_jvp(self.alpha, (width,), (jnp.ones_like(width),))
        s = (angle + width) / (2 * width)
        return (
            (1 + 2 * s) * (1 - s) ** 2 * start
            + s**2 * (3 - 2 * s) * end
            + 2 * width * s * (1 - s) * ((1 - s) * start_slope - s * end_slope)
        )


def _beyond(angle: Array, threshold: Array) -> Array:
    return jnp.maximum(angle - threshold, 0)
