"""Accelerations from the mass matrix, some joints at a time, from the tip to the base.

The matrix is that of products, M[k, j] = a_k . b_j for k <= j, of the motion a = S_k and the
momentum b = I_j S_j that go with each joint. Where the joints from some place to the tip are free
to follow, what is left for those before it is of the same form, with b_j - Q a_j for b_j: Q is the
part of the composite inertia that follows, and what remains is the articulated one (Featherstone,
Rigid Body Dynamics Algorithms, ch. 7). Joint by joint that is his algorithm. Here LAPACK eliminates
many joints at once, as a call of it takes as long as some thousand operations, but not all of a
long arm, whose matrix takes n^3.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from .._maths import factor_with_rows, solve_lower, solve_upper
from .._typing import Array, Float
from ._inertia import mass_matrix_upper

# Joints that are eliminated together, at most: two pieces of half as many take as long.
_TOGETHER = 48


class Piece(NamedTuple):
    """Joints that are eliminated together.

    Attributes:
        motion: their a.
        factor: lower Cholesky factor L of their part of the matrix, where all that follow are free.
        reach: their b, of what is left of the inertia, times L^-T; None of the first joints.
    """

    motion: Float[Array, "6 joint"]
    factor: Float[Array, "joint joint"]
    reach: Float[Array, "6 joint"] | None


def eliminate_and_solve(
    motion: Float[Array, "6 joint"],
    momentum: Float[Array, "6 joint"],
    armature: Array | None,
    torque: Float[Array, " joint"],
) -> tuple[tuple[Piece, ...], Float[Array, " joint"]]:
    """The pieces from the tip to the base, and the accelerations that a torque gives the joints.

    Arguments:
        motion, momentum: a and b of the matrix.
        armature: what is added to its diagonal, of one number or of one for each joint.
        torque: of the joints, N m.
    """
    count = len(torque)
    pieces, halves = [], []
    taken: Array | None = None
    for begin, end in _from_tip(count):
        a, b, pull = motion[:, begin:end], momentum[:, begin:end], torque[None, begin:end]
        if taken is not None:
            both = taken @ a
            b, pull = b - both[:6], pull - both[6:]
        # LAPACK reads the lower triangle alone.
        matrix = mass_matrix_upper(a, b).T
        if armature is not None:
            matrix = matrix + jnp.diag(jnp.broadcast_to(armature, (count,))[begin:end])
        # For the first joints there is nobody to follow.
        rows = jnp.concatenate([b, pull]) if begin else pull
        factor, solved = factor_with_rows(matrix, rows)
        reach = solved[:6] if begin else None
        if reach is not None:
            followed = solved @ reach.T
            taken = followed if taken is None else taken + followed
        pieces.append(Piece(a, factor, reach))
        halves.append(solved[-1][:, None])
    return tuple(pieces), _back(pieces, halves)


def solve_eliminated(
    pieces: tuple[Piece, ...], torque: Float[Array, " joint"]
) -> Float[Array, " joint"]:
    """The accelerations that another torque gives the joints of an arm.

    Arguments:
        pieces: of `eliminate_and_solve`.
        torque: of the joints, N m.
    """
    halves = []
    taken: Array | None = None
    for piece, (begin, end) in zip(pieces, _from_tip(len(torque)), strict=True):
        pull = torque[begin:end, None]
        if taken is not None:
            pull = pull - piece.motion.T @ taken
        half = solve_lower(piece.factor, pull)
        if piece.reach is not None:
            followed = piece.reach @ half
            taken = followed if taken is None else taken + followed
        halves.append(half)
    return _back(pieces, halves)


def _back(pieces: Sequence[Piece], halves: Sequence[Array]) -> Array:
    """Accelerations from the base to the tip, from L^-1 times the torques of each piece."""
    found = []
    carried: Array | None = None
    for piece, half in zip(reversed(pieces), reversed(halves), strict=True):
        if carried is not None:
            assert piece.reach is not None
            half = half - piece.reach.T @ carried
        found.append(solve_upper(piece.factor, half))
        if len(found) < len(pieces):
            moved = piece.motion @ found[-1]
            carried = moved if carried is None else carried + moved
    return jnp.concatenate(found)[:, 0]


def _from_tip(count: int) -> list[tuple[int, int]]:
    """Where pieces of about the same number of joints begin and end, the last ones first."""
    pieces = -(-count // _TOGETHER)
    ends = [count * each // pieces for each in range(pieces, -1, -1)]
    return [(begin, end) for end, begin in itertools.pairwise(ends)]
