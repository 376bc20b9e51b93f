"""Array types, roots, and the few functions of arrays that several rooms need."""

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array as Array, Bool as Bool, Float as Float, Int as Int

if TYPE_CHECKING:
    from optimistix import Solution

Scalar = Float[Array, ""]


# Vectors of a chain are stored component first, `(3, link)`: every operation below then works on
# whole rows, which is what makes one evaluation of the dynamics a few microseconds.


def on_device(values: Any, dtype: Any = None) -> Array:
    """Numbers that are known now, and are not changed afterwards, as an array of JAX.

    Without a program: `jnp.asarray` compiles one for every shape, in each process anew.
    """
    return jax.device_put(np.asarray(values, dtype))


# In functions of their own: where one function has some ten thousand operations (contact with
# friction, and joints that remember), XLA loses which calls of LAPACK have which arguments, and
# refuses them: "no registered implementation for untyped custom call".


@jax.jit
def cholesky_factor(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The lower Cholesky factor, from the lower triangle."""
    return jax.lax.linalg.cholesky(matrix, symmetrize_input=False)


@jax.jit
def factor_with_rows(
    matrix: Float[Array, "n n"], rows: Float[Array, "row n"]
) -> tuple[Float[Array, "n n"], Float[Array, "row n"]]:
    """The lower Cholesky factor L, from the lower triangle, and rows times L^-T.

    Below the matrix, as more rows of it, they come out of the factorisation as more rows of L.
    That is a call of LAPACK less, and a batch of accelerations of 20 links a seventh faster.
    """
    more, count = rows.shape
    # What stands in the corner is no part of the solution, as long as a root of it is left.
    corner = float(np.sqrt(jnp.finfo(rows.dtype).max)) * np.eye(more, dtype=rows.dtype)
    extended = jnp.pad(matrix, ((0, more), (0, more)))
    extended = extended.at[count:, :count].set(rows).at[count:, count:].set(corner)
    whole = cholesky_factor(extended)
    return whole[:count, :count], whole[count:, :count]


@jax.jit
def solve_lower(
    factor: Float[Array, "n n"], b: Float[Array, "n column"]
) -> Float[Array, "n column"]:
    """L^-1 b, of a lower triangle L."""
    return jax.lax.linalg.triangular_solve(factor, b, left_side=True, lower=True)


@jax.jit
def solve_upper(
    factor: Float[Array, "n n"], b: Float[Array, "n column"]
) -> Float[Array, "n column"]:
    """L^-T b, of a lower triangle L."""
    return jax.lax.linalg.triangular_solve(factor, b, left_side=True, lower=True, transpose_a=True)


@jax.jit
def inverse_of_positive(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The inverse of a positive matrix, from its lower triangle."""
    factor, one = cholesky_factor(matrix), jnp.eye(len(matrix), dtype=matrix.dtype)
    # From the right, rows stay rows for LAPACK, and nothing is transposed.
    half = jax.lax.linalg.triangular_solve(factor, one, left_side=False, lower=True)
    return half.T @ half


def dot(a: Float[Array, "3 *shape"], b: Float[Array, "3 *shape"]) -> Float[Array, "*shape"]:
    """Scalar product over the first axis."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Float[Array, "3 *shape"], b: Float[Array, "3 *shape"]) -> Float[Array, "3 *shape"]:
    """Vector product over the first axis."""
    return jnp.stack(
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    )


def scaled(
    factor: Float[Array, "*shape"], vector: Float[Array, "3 *shape"]
) -> Float[Array, "3 *shape"]:
    """Each vector times its own number."""
    return factor[None] * vector


def safe_norm(x: Float[Array, "3 *shape"]) -> Float[Array, "*shape"]:
    """Euclidean norm over the first axis, with the derivative 0 at 0.

    `sqrt` has an infinite slope at 0, so that `norm(v) * v` differentiates to NaN for an arm at
    rest, although its derivative there is 0. The inner `where` keeps `sqrt` away from 0; the
    outer one puts the true value back.
    """
    square = dot(x, x)
    zero = square == 0
    return jnp.where(zero, 0, jnp.sqrt(jnp.where(zero, 1, square)))


def quaternion_product(
    a: Float[Array, "4 *shape"], b: Float[Array, "4 *shape"]
) -> Float[Array, "4 *shape"]:
    """Hamilton product of quaternions stored `(w, x, y, z)` along the first axis."""
    return jnp.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


def rotate(
    quaternion: Float[Array, "4 *shape"], vector: Float[Array, "3 *shape"]
) -> Float[Array, "3 *shape"]:
    """Turn vectors by unit quaternions."""
    twice = 2 * cross(quaternion[1:], vector)
    return vector + scaled(quaternion[0], twice) + cross(quaternion[1:], twice)


def rotation_vector_to_quaternion(rotation: Float[Array, "3"]) -> Float[Array, "4"]:
    """Unit quaternion of a rotation vector (axis times angle, rad), differentiable at 0."""
    half = safe_norm(rotation) / 2
    # sin(half) / (2 half) = sinc(half / pi) / 2, which numpy defines at 0.
    return jnp.concatenate([jnp.cos(half)[None], rotation * jnp.sinc(half / jnp.pi) / 2])


def sobol_points(count: int, dimensions: int, seed: int) -> Float[np.ndarray, "point dimension"]:
    """Points of a scrambled Sobol sequence in the unit cube, none of them on its faces.

    More of them have the same first ones.
    """
    # Takes a second to import.
    from scipy.stats import qmc

    # The seed was called otherwise before SciPy 1.15.
    name = "rng" if "rng" in inspect.signature(qmc.Sobol.__init__).parameters else "seed"
    sobol = qmc.Sobol(dimensions, **{name: seed})
    points = sobol.random_base2(max(count - 1, 1).bit_length())[:count]
    edge = np.finfo(float).eps
    return np.asarray(np.clip(points, edge, 1 - edge))


# Halvings after which 90 deg are less than the rounding of a double.
_HALVINGS = 56
_NEWTON_STEPS = 8


def bisect(
    function: Callable[[Array], Array],
    lower: Scalar,
    upper: Scalar,
    signs: tuple[Scalar, Scalar] | None = None,
) -> Scalar:
    """A point between `lower` and `upper` where the sign changes; NaN where it does not.

    Arguments:
        signs: of the function at both, where they are known. A root at one of them is lost where
            another evaluation rounds to the other sign.
    """
    start, end = signs or (jnp.sign(function(lower)), jnp.sign(function(upper)))
    differs = start * end <= 0

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        same = jnp.sign(function(middle)) == start
        return jnp.where(same, middle, low), jnp.where(same, high, middle)

    low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (lower, upper))
    return jnp.where(differs, (low + high) / 2, jnp.nan)


def polish(
    function: Callable[[Array, Any], Array], guess: Scalar, arguments: Any
) -> tuple[Scalar, Array]:
    """The root near a guess by Newton's method, and whether it converged.

    It is differentiable in `arguments` (implicitly).
    """
    # Slow to import, and needed only where a program is traced.
    import optimistix as optx

    tolerance = 8 * float(jnp.finfo(guess.dtype).eps)
    solution: Solution = optx.root_find(
        function,
        optx.Newton(rtol=tolerance, atol=tolerance),
        jax.lax.stop_gradient(guess),
        args=arguments,
        max_steps=_NEWTON_STEPS,
        throw=False,
    )
    return solution.value, jnp.asarray(solution.result == optx.RESULTS.successful)
