"""Array types, roots, and functions of arrays: sums and derivatives along a chain, too."""

import functools
import inspect
import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array as Array, Bool as Bool, Float as Float, Int as Int

if TYPE_CHECKING:
    from optimistix import Solution

Scalar = Float[Array, ""]


# Vectors of a chain are stored component first, `(3, link)`: every operation below then works on
# whole rows, which is what makes one evaluation of the dynamics a few microseconds.


def on_device(values: Any, dtype: Any = None) -> Array:
    """Numbers that are known now, and are not changed afterwards, as an array of JAX.

    Without a program: `jnp.asarray` compiles one for every shape, in each process again.
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


@jax.jit
def solution_by_factor(factor: Float[Array, "n n"], b: Float[Array, " n"]) -> Float[Array, " n"]:
    """A^-1 b of a positive matrix A = L L^T, from L."""
    half = jax.lax.linalg.triangular_solve(factor, b[None], lower=True, transpose_a=True)
    return jax.lax.linalg.triangular_solve(factor, half, lower=True)[0]


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


def larger(x: Array, y: Array | float) -> Array:
    """The larger of two, element by element; where both are equal, the derivative is that of x.

    This, and the functions below, choose by a comparison. The derivatives of `jnp.maximum`,
    `jnp.minimum`, `jnp.clip` and `jnp.hypot` ask whether the result equals an argument. A compiler
    may work out that argument twice and round it differently (a product and a sum in one
    instruction): then nothing is equal, and the derivative is 0 where it is not. As there, what is
    not a number makes none.
    """
    return jnp.where((x < y) | (y != y), y, x)


def smaller(x: Array, y: Array | float) -> Array:
    """The smaller of two, element by element; where both are equal, the derivative is that of x."""
    return jnp.where((x > y) | (y != y), y, x)


def limited(x: Array, low: Array | float, high: Array | float) -> Array:
    """x within two limits, element by element; at a limit, the derivative is that of x."""
    return smaller(larger(x, low), high)


def hypotenuse(x: Array, y: Array) -> Array:
    """sqrt(x^2 + y^2), for lengths whose squares are neither 0 nor infinite."""
    return jnp.sqrt(x * x + y * y)


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


# Loops, sums and derivatives along a chain, written so that XLA makes few kernels of them.

# A call of a kernel takes as long as a hundred operations, on a CPU.

# XLA makes a kernel of a loop that touches less than 1024 bytes each time round
# (`SmallWhileLoopHoistingPass`): two columns of so many numbers, and what counts them.
_ROWS = 18

_LOOPS = 8  # more loops than this take longer than what they are instead of


def in_small_loops(
    x: Array, loop: Callable[[Array], Array], instead: Callable[[Array], Array]
) -> Array:
    """What a function makes of all rows (along the last axis), a few at a time.

    `loop` goes over the places of some rows, shape (row, place); `instead` is of `x` where rows
    are missing or too many.
    """
    rows: Any = x.reshape(-1, x.shape[-1]) if x.size else x[:0]
    loops = -(-len(rows) // _ROWS)
    if not 0 < loops <= _LOOPS:
        return instead(x)
    ends = [len(rows) * each // loops for each in range(loops + 1)]
    parts = [loop(rows[begin:end]) for begin, end in itertools.pairwise(ends)]
    return jnp.concatenate(parts).reshape(x.shape)


def lower_by_platform(
    primitive: Any, on_cpu: Callable[..., Any], elsewhere: Callable[..., Any]
) -> None:
    """Say what a primitive with one result is made of, on a CPU and elsewhere."""
    mlir.register_lowering(primitive, mlir.lower_fun(elsewhere, multiple_results=False))
    lowered = mlir.lower_fun(on_cpu, multiple_results=False)
    mlir.register_lowering(primitive, lowered, platform="cpu")


# Sums along a chain, as a CPU computes them quickly.
#
# `jax.numpy.cumsum` becomes a tree of slices, a product with a triangle a call of a library: for
# the few hundred additions of a chain both take several times as long as these, and a small loop
# does not. What a sum is made of depends on how many rows it has in the end, with all directions
# of a derivative and all members of a batch, and is chosen when a program is lowered; so it is a
# primitive.


def running_sum(x: Float[Array, "*row n"], *, backwards: bool = False) -> Float[Array, "*row n"]:
    """Sums over each place along the last axis and all before it; `backwards`: all after it."""
    total: Array = _running_sum_p.bind(x, backwards=backwards)
    return total


_running_sum_p = jax.extend.core.Primitive("running_sum")


def _product(x: Array, *, backwards: bool) -> Array:
    ones = np.ones((x.shape[-1],) * 2, x.dtype)
    return x @ (np.tril(ones) if backwards else np.triu(ones))


def _sum_on_cpu(x: Array, *, backwards: bool) -> Array:
    loop, instead = (functools.partial(how, backwards=backwards) for how in (_loop, _product))
    return in_small_loops(x, loop, instead)


def _loop(rows: Array, *, backwards: bool) -> Array:
    last = rows.shape[1] - 1

    def add(k: Array, rows: Array) -> Array:
        here, before = (last - k, last - k + 1) if backwards else (k, k - 1)
        column = functools.partial(jax.lax.dynamic_slice_in_dim, rows, slice_size=1, axis=1)
        return jax.lax.dynamic_update_slice_in_dim(rows, column(here) + column(before), here, 1)

    return jax.lax.fori_loop(1, last + 1, add, rows)


def _transposed(cotangent: Any, x: Any, *, backwards: bool) -> list[Any]:
    """What a place is added to lies on its other side."""
    del x
    return [running_sum(cotangent, backwards=not backwards)]


def _sum_batched(args: Any, axes: Any, *, backwards: bool) -> tuple[Array, int]:
    return running_sum(jnp.moveaxis(args[0], axes[0], 0), backwards=backwards), 0


_running_sum_p.def_abstract_eval(lambda x, **_: x)
_running_sum_p.def_impl(_product)
ad.deflinear2(_running_sum_p, _transposed)
batching.primitive_batchers[_running_sum_p] = _sum_batched
lower_by_platform(_running_sum_p, _sum_on_cpu, _product)


# Derivatives that XLA computes once.
#
# What is made of a vector by a few operations XLA joins into one kernel with it, and computes the
# vector anew for each of its uses: for each component of a cross product twice. Of motions that
# costs little, but the derivatives of forces have a hundred operations. On a CPU nothing but a
# loop that is a kernel of its own keeps them apart: an `optimization_barrier` is gone before
# kernels are made.


def derivative_barrier(x: Float[Array, "*row n"]) -> Float[Array, "*row n"]:
    """Rows along a chain, with derivatives (in forward mode) computed apart from what uses them."""
    same: Array = _once_p.bind(x, now=False)
    return same


def computed_once(x: Float[Array, "*row n"]) -> Float[Array, "*row n"]:
    """Rows along a chain that are computed apart from what uses them."""
    same: Array = _once_p.bind(x, now=True)
    return same


_once_p = jax.extend.core.Primitive("derivatives_once")


def _same(x: Array, *, now: bool) -> Array:
    del now
    return x


def _copied_on_cpu(x: Array, *, now: bool) -> Array:
    return in_small_loops(x, _copied, lambda x: x) if now else x


def _copied(rows: Array) -> Array:
    def put(k: Array, copy: Array) -> Array:
        column = jax.lax.dynamic_slice_in_dim(rows, k, 1, axis=1)
        return jax.lax.dynamic_update_slice_in_dim(copy, column, k, 1)

    return jax.lax.fori_loop(0, rows.shape[1], put, jnp.zeros_like(rows))


def _jvp(primals: Any, tangents: Any, *, now: bool) -> tuple[Any, Any]:
    (tangent,) = tangents
    if not isinstance(tangent, ad.Zero):
        tangent = _once_p.bind(tangent, now=True)
    return _once_p.bind(*primals, now=now), tangent


def _copy_batched(args: Any, axes: Any, *, now: bool) -> tuple[Any, int]:
    return _once_p.bind(jnp.moveaxis(args[0], axes[0], 0), now=now), 0


_once_p.def_abstract_eval(lambda x, **_: x)
_once_p.def_impl(_same)
ad.primitive_jvps[_once_p] = _jvp
ad.primitive_transposes[_once_p] = lambda cotangent, x, **_: [cotangent]
batching.primitive_batchers[_once_p] = _copy_batched
lower_by_platform(_once_p, _copied_on_cpu, _same)
