"""Array aliases, written once."""

from jaxtyping import Array as Array, Bool as Bool, Float as Float, Int as Int

Scalar = Float[Array, ""]
