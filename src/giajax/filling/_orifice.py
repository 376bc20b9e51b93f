"""The flow of gas through a hole: laminar, turbulent, choked."""

from typing import NamedTuple

import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ._gas import Gas

Numbers = Float[Array, "..."]


class Hole(NamedTuple):
    """A round hole.

    Attributes:
        diameter, length: m.
        coefficient: the discharge coefficient.
    """

    diameter: Numbers
    length: Numbers
    coefficient: Scalar


def mass_flow(gas: Gas, hole: Hole, before: Numbers, after: Numbers) -> Numbers:
    """Gas that a hole lets through, kg/s; negative from after to before.

    An isentropic orifice of Saint-Venant and Wantzel (ISO 6358-1 has it for air),

        m = C A p0 sqrt(2 k / ((k - 1) R T)) sqrt(g),  g = r^(2/k) - r^((k + 1)/k),

    with r the ratio of pressures, which is no less than the critical one,
    (2 / (k + 1))^(k / (k - 1)) = 0.487 for helium: there the slope of g is 0, and so the flow is
    smooth where it chokes. In series with it a short tube after Hagen and Poiseuille: in place of
    y = sqrt(g) it is y^2 + a y = g, so that the flow is laminar for small differences of pressure
    and has a slope at 0. Where the difference is small beside the pressure that is
    dp = 128 mu L Q / (pi d^4) + rho Q |Q| / (2 C^2 A^2).

    Arguments:
        gas: the gas.
        hole: or several.
        before, after: absolute pressures on both sides, Pa.

    Returns:
        Flow of mass, kg/s.
    """
    k, rt = gas.heat_capacity_ratio, gas.specific_energy
    upstream = jnp.maximum(before, after)
    most = 1 - critical_ratio(gas)
    signed = jnp.clip((before - after) / upstream, -most, most)
    drop = jnp.abs(signed)
    # g over the drop, which has a limit where there is none.
    known = jnp.where(drop == 0, most, drop)
    logarithm = jnp.log1p(-known)
    # Without what is lost where powers that are nearly the same are subtracted.
    known = jnp.exp(2 / k * logarithm) * -jnp.expm1((k - 1) / k * logarithm) / known
    slope = jnp.where(drop == 0, (k - 1) / k, known)
    area = jnp.pi / 4 * hole.diameter**2
    scale = hole.coefficient * area * upstream * jnp.sqrt(2 * k / ((k - 1) * rt))
    resistance = 128 * gas.viscosity * hole.length / (jnp.pi * hole.diameter**4)
    # For small drops the flow is (before - after) / resistance, times the density.
    laminar = scale * (k - 1) / k * resistance * rt / upstream**2
    return scale * signed * 2 * slope / (laminar + jnp.sqrt(laminar**2 + 4 * slope * drop))


def critical_ratio(gas: Gas) -> Scalar:
    """Pressure behind a hole over that before it, below which the flow is choked."""
    k = gas.heat_capacity_ratio
    return (2 / (k + 1)) ** (k / (k - 1))
