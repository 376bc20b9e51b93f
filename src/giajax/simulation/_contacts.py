"""What an arm touched in a simulation: flattening, forces and impulses."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .._errors import InputError
from .._program import program
from .._typing import Array, Float
from ..arm import Arm, touched
from ._trajectory import Trajectory


class Contacts(NamedTuple):
    """What the links touched, at the samples of a simulation.

    Attributes:
        obstacles: names of the obstacles, in the order of their axis.
        flattening: by how much a link's axis is nearer to an obstacle than its radius, m.
        force: of an obstacle on a link in the base frame, N.
        impulse: of an obstacle on a link over the whole time, N s, by the trapezoidal rule; no
            better than the samples are dense.
    """

    obstacles: tuple[str, ...]
    flattening: Float[Array, "sample link obstacle"]
    force: Float[Array, "sample link obstacle 3"]
    impulse: Float[Array, "link obstacle 3"]


def contacts(trajectory: Trajectory) -> Contacts:
    """Flattening, force and impulse of each contact of a motion.

    Arguments:
        trajectory: the motion of an arm with obstacles.

    Returns:
        What each link touched.

    Raises:
        InputError: nothing stands around the arm.

    Example:
        >>> import giajax, jax.numpy as jnp
        >>> from giajax.arm import Contact
        >>> from giajax.obstacles import Plane
        >>> ground = Plane(centre=[0.0, 0.0, -0.5])
        >>> arm = giajax.takeichi_20m(contact=Contact(obstacles=(ground,)))
        >>> command = giajax.joint_ramps(20, {1: 0.3}, start=0.5, duration=2.0)
        >>> motion = giajax.simulate(arm, command, jnp.linspace(0.0, 10.0, 101))
        >>> giajax.contacts(motion).flattening.shape
        (101, 20, 1)
    """
    contact = trajectory.arm.contact
    if contact is None:
        raise InputError("the arm has no obstacles: give it some, as [[arm.obstacles]]")
    flattening, force = _over_samples(
        trajectory.arm, trajectory.angles, trajectory.rates, trajectory.skin
    )
    steps = jnp.diff(trajectory.times)
    impulse = jnp.tensordot(steps, (force[1:] + force[:-1]) / 2, axes=1)
    names = tuple(obstacle.name for obstacle in contact.obstacles)
    return Contacts(names, flattening, force, impulse)


@program
def _over_samples(arm: Arm, angles: Array, rates: Array, skin: Array | None) -> tuple[Array, Array]:
    return jax.vmap(touched, (None, 0, 0, 0))(arm, angles, rates, skin)
