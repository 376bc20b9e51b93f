"""The Preisach operator on a triangular mesh, with exact memory and a parametric density.

Each relay has the thresholds s + r and s - r, where r is its half-width and s its centre. In these
coordinates, the line that separates the relays in the upper state from those in the lower state is
s = w(r), the play of threshold r. The memory therefore needs neither smoothing nor a list of
extrema: it consists of the plays of the rows of the mesh. Along each row, the density is integrated
exactly up to w.

References: I. D. Mayergoyz, "Mathematical Models of Hysteresis", Springer 1991; M. Brokate,
J. Sprekels, "Hysteresis and Phase Transitions", Springer 1996, ch. 2.
"""

import equinox as eqx
import jax.numpy as jnp

from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError
from ...schema import PREISACH
from ...schema.parameters import parameter
from ._operator import AbstractPlays, clip


class Preisach(AbstractPlays):
    """The Preisach operator: y = slope u + saturation times the weighted mean of all relays.

    The weight is the density: a log-normal distribution of the half-width r of the relays times a
    normal distribution of their centre s, on the triangle r > 0, |s| + r < extent. It is constant
    within each cell of the mesh.

    Arguments:
        slope: slope of the reversible part, output per input.
        saturation: output if all relays are in the upper state.
        coercivity: median half-width of the relays, in the unit of the input.
        coercivity_spread: standard deviation of the logarithm of the half-width.
        bias: mean of the centres of the relays, in the unit of the input.
        interaction: standard deviation of the centres, in the unit of the input.
        extent: largest input that switches a relay, which is the size of the triangle.
        rows: number of rows (half-widths) of the mesh; each row has twice this number of cells.

    Raises:
        InputError: the extent is not positive, or there are fewer than 2 rows.
    """

    slope: Scalar = parameter(PREISACH.slope)
    saturation: Scalar = parameter(PREISACH.saturation)
    coercivity: Scalar = parameter(PREISACH.coercivity)
    coercivity_spread: Scalar = parameter(PREISACH.coercivity_spread)
    bias: Scalar = parameter(PREISACH.bias)
    interaction: Scalar = parameter(PREISACH.interaction)
    extent: float = eqx.field(default=1.0, static=True)
    rows: int = eqx.field(default=40, static=True)

    def __check_init__(self) -> None:
        if not 0 < self.extent < float("inf"):
            raise InputError(
                f"the extent is {self.extent:g}: give the largest input as a positive number"
            )
        if self.rows < 2:
            raise InputError(f"the mesh has {self.rows} rows: give at least 2")

    @property
    def half_widths(self) -> Float[Array, " row"]:
        """Half-width r of each row: the middle of its strip of the triangle."""
        fractions = (jnp.arange(self.rows, dtype=jnp.result_type(float)) + 0.5) / self.rows
        return self.extent * fractions

    @property
    def thresholds(self) -> Float[Array, " row"]:
        """Thresholds of the plays.

        Plays of 0 are the demagnetised state: the relays below s = 0 are in the upper state, those
        above in the lower state.
        """
        return self.half_widths

    def cells(self) -> Float[Array, "row cell"]:
        """Return the weight of each cell: the density times its area, normalised to a sum of 1."""
        r = self.half_widths[:, None]
        count = 2 * self.rows
        middles = (jnp.arange(count, dtype=r.dtype) + 0.5) / self.rows - 1
        room = self.extent - r
        s = room * middles[None]
        across = ((s - self.bias) / self.interaction) ** 2
        along = (jnp.log(r / self.coercivity) / self.coercivity_spread) ** 2
        logarithm = -(across + along) / 2 - jnp.log(r) + jnp.log(room)
        # Only the ratios matter. Without this shift, all cells could be rounded to 0 for poor
        # parameter values.
        weights = jnp.exp(logarithm - jnp.max(logarithm))
        return weights / jnp.sum(weights)

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """Return the sum of the reversible part and the weighted mean of the relays."""
        weights = self.cells()
        nothing = jnp.zeros_like(weights[:, :1])
        below = jnp.concatenate([nothing, jnp.cumsum(weights, axis=1)], axis=1)
        # Position at which the dividing line crosses each row, in units of cells.
        position = (
            plays.reshape(-1, self.rows) / (self.extent - self.half_widths)[None] + 1
        ) * self.rows
        position = clip(position, jnp.zeros_like(position), jnp.full_like(position, 2 * self.rows))
        cell = jnp.clip(jnp.floor(position).astype(int), 0, 2 * self.rows - 1)
        row = jnp.arange(self.rows)[None]
        within = position - cell.astype(position.dtype)
        up = jnp.sum(below[row, cell] + within * weights[row, cell], axis=1).reshape(inputs.shape)
        return self.slope * inputs + self.saturation * (2 * up - 1)
