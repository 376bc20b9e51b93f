"""Inertia of the links in the base frame, and the mass matrix that it makes.

Spatial inertias about the base origin simply add, so the composite inertias are one reverse
cumulative sum and M[k, j] = S_k . (I_composite_j S_j) for k <= j (Featherstone, Rigid Body
Dynamics Algorithms, ch. 6, in base coordinates).
"""

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np

from .._maths import cross, dot, scaled
from .._typing import Array, Float
from ._added_mass import added_mass
from ._arm import Arm
from ._bodies import Bodies, bodies
from ._kinematics import Pose, Rows, pose, sum_from_tip


def mass_matrix(arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "joint joint"]:
    """Joint-space mass matrix M(q), kg m^2; symmetric and positive definite.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.

    Returns:
        M(q), kg m^2, shape (joint, joint).
    """
    here = pose(arm, angles)
    motion, momentum = motion_and_momentum(arm, here, sum_from_tip(carried_inertia(arm, here)))
    upper = jnp.triu(mass_matrix_upper(motion, momentum))
    if arm.joints.armature is not None:
        upper = upper + jnp.diag(jnp.broadcast_to(arm.joints.armature, angles.shape))
    return upper + jnp.triu(upper, 1).T


def motion_and_momentum(
    arm: Arm, here: Pose, carried: Float[Array, "12 link"]
) -> tuple[Float[Array, "6 joint"], Float[Array, "6 joint"]]:
    """Of each joint's unit rate: the motion S, and the momentum I S of all links that it carries.

    Both about the base origin, three angular rows before three linear ones.

    Arguments:
        arm: the arm.
        here: its pose.
        carried: `carried_inertia`, summed from the tip.
    """
    rod = added_mass(arm)
    mass = bodies(arm).mass if rod is None else bodies(arm).mass + rod.mass
    first, inertia = carried[:3], carried[3:].reshape(3, 3, -1)
    w = here.axis
    v = cross(here.joint, w)  # velocity, at the origin, of a body turning about the joint
    linear = scaled(sum_from_tip(mass[None])[0], v) + cross(w, first)
    turn = _tensor_times(inertia, w)
    motion = jnp.concatenate([w, v])
    momentum = jnp.concatenate([turn + cross(first, v), linear])
    if rod is not None:
        # Velocity of a link's centre along itself is this times the motion of the link.
        slip = jnp.concatenate([cross(here.centre, here.direction), here.direction])
        along = sum_from_tip(scaled(rod.mass, slip)[:, None] * slip[None])
        momentum = momentum - jnp.sum(along * motion[None], axis=1)
    return motion, momentum


def mass_matrix_upper(
    motion: Float[Array, "6 joint"], momentum: Float[Array, "6 joint"]
) -> Float[Array, "joint joint"]:
    """The mass matrix without armature, right on and above the diagonal only."""
    # XLA takes twice as long over one product of six rows.
    return motion[:3].T @ momentum[:3] + motion[3:].T @ momentum[3:]


def carried_inertia(arm: Arm, here: Pose) -> Float[Array, "12 link"]:
    """Moments of mass of each link and of the air that it moves, to be summed from the tip."""
    body, e = bodies(arm), here.direction
    ring = body.axial - body.transverse
    spatial = _about_origin(body.mass, here.mass_centre, e, body.transverse, ring)
    uneven = _uneven(body, here)
    if uneven is not None:
        spatial = spatial.at[3:].add(uneven.reshape(9, -1))
    rod = added_mass(arm)
    if rod is not None:
        # A rod that had its mass along itself, too; `motion_and_momentum` takes it away again.
        spatial = spatial + _about_origin(rod.mass, here.centre, e, rod.inertia, -rod.inertia)
    return spatial


def _about_origin(
    mass: Array, x: Rows, direction: Rows, transverse: Array, ring: Array
) -> Float[Array, "12 link"]:
    """Moments of mass, about the base origin, of bodies that are round about the links' axes.

    The first moments, and the inertia as nine rows, where six would do: they come out of one
    product, and a stack of rows that are computed one by one costs more than their sum.
    `ring` is axial - transverse.
    """
    first = scaled(mass, x)
    round_part = transverse + dot(first, x)
    inertia = (
        scaled(ring, direction)[:, None] * direction[None]
        - first[:, None] * x[None]
        + np.eye(3, dtype=first.dtype)[:, :, None] * round_part[None, None]
    )
    return jnp.concatenate([first, inertia.reshape(9, -1)])


def inertia_times(body: Bodies, here: Pose, vector: Rows) -> Rows:
    """Rotational inertia of each link about its centre of mass, times a vector."""
    along = (body.axial - body.transverse) * dot(here.direction, vector)
    product = scaled(body.transverse, vector) + scaled(along, here.direction)
    uneven = _uneven(body, here)
    return product if uneven is None else product + _tensor_times(uneven, vector)


def gyroscopic(body: Bodies, here: Pose, omega: Rows, leaning: Rows) -> Rows:
    """The couple omega x (I omega) of each link; `leaning` is the rate of its direction.

    Of a body that is round about its axis, only what it turns about that counts.
    """
    axial = (body.axial - body.transverse) * dot(here.direction, omega)
    couple = scaled(axial, leaning)
    uneven = _uneven(body, here)
    return couple if uneven is None else couple + cross(omega, _tensor_times(uneven, omega))


def _uneven(body: Bodies, here: Pose) -> Float[Array, "3 3 link"] | None:
    """What off-axis masses add to the inertia, in the base frame."""
    if body.uneven is None:
        return None
    assert here.left is not None
    frame = jnp.stack([here.direction, here.left, here.up])
    xx, yy, zz, xy, xz, yz = body.uneven
    tensor = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    # X R', then R X R', with the columns of R in the rows of `frame`.
    turned = [_sum3(scaled(row[k], frame[k]) for k in range(3)) for row in tensor]
    return _sum3(frame[k][:, None] * turned[k][None] for k in range(3))


def _tensor_times(tensor: Float[Array, "3 3 *shape"], v: Rows) -> Rows:
    return _sum3(scaled(v[i], tensor[:, i]) for i in range(3))


def _sum3(terms: Iterable[Array]) -> Array:
    x, y, z = terms
    return x + y + z
