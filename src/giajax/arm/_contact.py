"""Contact of inflated links with obstacles: the law, and its numbers."""

import equinox as eqx
import jax.numpy as jnp

from .._errors import InputError
from .._maths import safe_norm, scaled
from .._typing import Array, Float, Scalar
from ..obstacles import AbstractObstacle
from ..parameters import is_concrete, parameter
from ..quantities import CONTACT


class Contact(eqx.Module):
    """Links are inextensible tubes under pressure, and flatten where they meet an obstacle.

    A tube of length L under gauge pressure p that two plates flatten by delta presses with
    (pi / 2) p L delta: the flat part is as wide as pi delta / 2. Each wall meets half of that, so
    that the axis of a link that is nearer to a wall than its radius by w is pushed away by
    pi p w for each metre (`shape_factor` is that pi).

    Friction is elastic up to Coulomb's limit: where a link touches, its skin sticks, and slides
    once the force reaches `friction` times the pressing one. The stretch of the skin is a state
    of shape (3, link), m; without friction there is none.

    Arguments:
        obstacles: what stands around the arm, at least one.
        pressure: gauge pressure in the links, Pa; one number, or one each.
        shape_factor: force over pressure, length and penetration.
        damping: s/m; a closing contact presses (1 + damping times closing speed) times as hard
            (Hunt and Crossley, J. Appl. Mech. 42 (1975) 440), an opening one softer, and none
            pulls: it never creates energy.
        friction: coefficient of friction; None for none.
        friction_stiffness: of a link along a surface that it sticks to, N/m.
        points: Gauss points of each of the three pieces of a contact of a link with a box.

    Raises:
        InputError: no obstacles, two of the same name, or friction without a stiffness.
    """

    obstacles: tuple[AbstractObstacle, ...]
    pressure: Float[Array, ""] | Float[Array, " link"] = parameter(CONTACT.pressure)
    shape_factor: Scalar = parameter(CONTACT.shape_factor)
    damping: Scalar = parameter(CONTACT.damping)
    friction: Scalar | None = parameter(CONTACT.friction)
    friction_stiffness: Scalar = parameter(CONTACT.friction_stiffness)
    points: int = eqx.field(static=True, default=5)

    def __check_init__(self) -> None:
        if not self.obstacles:
            raise InputError("contact without an obstacle: give at least one, or leave contact out")
        names = [obstacle.name for obstacle in self.obstacles]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"two obstacles are called '{twice}': give each its own name")
        stiffness = self.friction_stiffness
        if self.friction is not None and is_concrete(stiffness) and not float(stiffness) > 0:
            raise InputError(
                f"contact.friction_stiffness is {float(stiffness):g}: make it positive"
            )

    @property
    def rows(self) -> int:
        """States of each link."""
        return 0 if self.friction is None else 3

    def line(self, links: int) -> Float[Array, " link"]:
        """Force of each metre of link over its penetration, N/m^2."""
        return self.shape_factor * jnp.broadcast_to(self.pressure, (links,))

    def hold(
        self, strain: Float[Array, "3 link"], normal: Float[Array, " link"]
    ) -> Float[Array, "3 link"]:
        """The stretch (m) that friction can hold where normal forces (N) press."""
        if self.friction is None:
            return strain
        most = self.friction * normal / self.friction_stiffness
        size = safe_norm(strain)
        over = size > most
        return scaled(jnp.where(over, most / jnp.where(over, size, 1), 1), strain)
