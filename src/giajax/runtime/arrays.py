"""Array types, array functions, roots, and efficient sums and derivatives along a chain."""

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


# Vectors of a chain are stored component first, `(3, link)`. Each operation below then works on
# whole rows, so one evaluation of the dynamics takes a few microseconds.


def on_device(values: Any, dtype: Any = None) -> Array:
    """Return concrete, constant numbers as a JAX array, without compiling a program.

    `jnp.asarray` compiles a program for each shape in each process.
    """
    return jax.device_put(np.asarray(values, dtype))


# These are separate compiled functions. If a function has about ten thousand operations (contact
# with friction, and joints with memory), XLA confuses the arguments of LAPACK calls and fails with
# "no registered implementation for untyped custom call".


@jax.jit
def cholesky_factor(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return the lower Cholesky factor, from the lower triangle."""
    return jax.lax.linalg.cholesky(matrix, symmetrize_input=False)


@jax.jit
def factor_with_rows(
    matrix: Float[Array, "n n"], rows: Float[Array, "row n"]
) -> tuple[Float[Array, "n n"], Float[Array, "row n"]]:
    """Return the lower Cholesky factor L, from the lower triangle, and rows times L^-T.

    The rows are appended to the matrix, so the factorisation returns them as further rows of L.
    This saves a LAPACK call.
    """
    more, count = rows.shape
    # The corner does not affect the solution as long as the root of its diagonal remains real.
    corner = float(np.sqrt(jnp.finfo(rows.dtype).max)) * np.eye(more, dtype=rows.dtype)
    extended = jnp.pad(matrix, ((0, more), (0, more)))
    extended = extended.at[count:, :count].set(rows).at[count:, count:].set(corner)
    whole = cholesky_factor(extended)
    return whole[:count, :count], whole[count:, :count]


@jax.jit
def solve_lower(
    factor: Float[Array, "n n"], b: Float[Array, "n column"]
) -> Float[Array, "n column"]:
    """Return L^-1 b for a lower triangular matrix L."""
    return jax.lax.linalg.triangular_solve(factor, b, left_side=True, lower=True)


@jax.jit
def solve_upper(
    factor: Float[Array, "n n"], b: Float[Array, "n column"]
) -> Float[Array, "n column"]:
    """Return L^-T b for a lower triangular matrix L."""
    return jax.lax.linalg.triangular_solve(factor, b, left_side=True, lower=True, transpose_a=True)


@jax.jit
def inverse_of_positive(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return the inverse of a positive definite matrix, from its lower triangle."""
    factor, one = cholesky_factor(matrix), jnp.eye(len(matrix), dtype=matrix.dtype)
    # A solution from the right keeps the order of rows for LAPACK, so nothing is transposed.
    half = jax.lax.linalg.triangular_solve(factor, one, left_side=False, lower=True)
    return half.T @ half


@jax.jit
def solution_by_factor(factor: Float[Array, "n n"], b: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return A^-1 b for a positive definite matrix A = L L^T, from L."""
    half = jax.lax.linalg.triangular_solve(factor, b[None], lower=True, transpose_a=True)
    return jax.lax.linalg.triangular_solve(factor, half, lower=True)[0]


def dot(a: Float[Array, "3 *shape"], b: Float[Array, "3 *shape"]) -> Float[Array, "*shape"]:
    """Return the scalar product over the first axis."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Float[Array, "3 *shape"], b: Float[Array, "3 *shape"]) -> Float[Array, "3 *shape"]:
    """Return the vector product over the first axis."""
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
    """Multiply each vector by its own factor."""
    return factor[None] * vector


def safe_norm(x: Float[Array, "3 *shape"]) -> Float[Array, "*shape"]:
    """Return the Euclidean norm over the first axis, with the derivative 0 at 0.

    `sqrt` has an infinite slope at 0, so the derivative of `norm(v) * v` would be NaN for an arm at
    rest, although the true derivative is 0. The inner `where` keeps the argument of `sqrt` away
    from 0. The outer `where` restores the correct value.
    """
    square = dot(x, x)
    zero = square == 0
    return jnp.where(zero, 0, jnp.sqrt(jnp.where(zero, 1, square)))


def larger(x: Array, y: Array | float) -> Array:
    """Return the elementwise maximum, with the derivative of x where both are equal.

    This function and the functions below select by a comparison. The derivatives of `jnp.maximum`,
    `jnp.minimum`, `jnp.clip` and `jnp.hypot` test whether the result equals an argument. A compiler
    may compute that argument twice with different rounding (for example a product and a sum in one
    instruction). Then neither argument equals the result, and the derivative is wrongly 0. NaN is
    propagated, as in those functions.
    """
    return jnp.where((x < y) | (y != y), y, x)


def smaller(x: Array, y: Array | float) -> Array:
    """Return the elementwise minimum, with the derivative of x where both are equal."""
    return jnp.where((x > y) | (y != y), y, x)


def limited(x: Array, low: Array | float, high: Array | float) -> Array:
    """Clip x to two limits, element by element, with the derivative of x at a limit."""
    return smaller(larger(x, low), high)


def hypotenuse(x: Array, y: Array) -> Array:
    """Return sqrt(x^2 + y^2), for lengths whose squares are neither 0 nor infinite."""
    return jnp.sqrt(x * x + y * y)


def quaternion_product(
    a: Float[Array, "4 *shape"], b: Float[Array, "4 *shape"]
) -> Float[Array, "4 *shape"]:
    """Return the Hamilton product of quaternions stored `(w, x, y, z)` along the first axis."""
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
    """Rotate vectors by unit quaternions."""
    twice = 2 * cross(quaternion[1:], vector)
    return vector + scaled(quaternion[0], twice) + cross(quaternion[1:], twice)


def rotation_vector_to_quaternion(rotation: Float[Array, "3"]) -> Float[Array, "4"]:
    """Return the unit quaternion of a rotation vector (axis times angle, rad), smooth at 0."""
    half = safe_norm(rotation) / 2
    # sin(half) / (2 half) = sinc(half / pi) / 2, which numpy defines at 0.
    return jnp.concatenate([jnp.cos(half)[None], rotation * jnp.sinc(half / jnp.pi) / 2])


def sobol_points(count: int, dimensions: int, seed: int) -> Float[np.ndarray, "point dimension"]:
    """Return points of a scrambled Sobol sequence in the interior of the unit cube.

    A larger number of points starts with the same points.
    """
    # Imported here because it takes a second.
    from scipy.stats import qmc

    # The argument for the seed had another name before SciPy 1.15.
    name = "rng" if "rng" in inspect.signature(qmc.Sobol.__init__).parameters else "seed"
    sobol = qmc.Sobol(dimensions, **{name: seed})
    points = sobol.random_base2(max(count - 1, 1).bit_length())[:count]
    edge = np.finfo(float).eps
    return np.asarray(np.clip(points, edge, 1 - edge))


# Number of bisections after which an interval of 90 deg is shorter than the rounding of a double.
_HALVINGS = 56
_NEWTON_STEPS = 8


def bisect(
    function: Callable[[Array], Array],
    lower: Scalar,
    upper: Scalar,
    signs: tuple[Scalar, Scalar] | None = None,
) -> Scalar:
    """Return a point between `lower` and `upper` at which the sign changes; NaN if it does not.

    Arguments:
        function: function of one variable.
        lower, upper: ends of the interval.
        signs: signs of the function at both ends, if known. Without them, a root at an end is
            missed if another evaluation rounds to the other sign.
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
    """Return the root near a guess by Newton's method, and whether it converged.

    The root is differentiable with respect to `arguments` (implicit differentiation).
    """
    # Imported here because it is slow to import and needed only while a program is traced.
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


# Loops, sums and derivatives along a chain, written such that XLA creates few kernels.

# On a CPU, a kernel call takes as long as a hundred operations.

# XLA compiles a loop to a single kernel if it accesses less than 1024 bytes per iteration
# (`SmallWhileLoopHoistingPass`). This corresponds to two columns of this many numbers and the loop
# counter.
_ROWS = 18

_LOOPS = 8  # more loops than this are slower than the alternative


def in_small_loops(
    x: Array, loop: Callable[[Array], Array], instead: Callable[[Array], Array]
) -> Array:
    """Apply a loop to all rows (along the last axis), a few rows at a time.

    `loop` processes the places of some rows, shape (row, place). `instead` is applied to `x` if
    there are no rows or too many.
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
    """Define the lowering of a primitive with one result on a CPU and on other platforms."""
    mlir.register_lowering(primitive, mlir.lower_fun(elsewhere, multiple_results=False))
    lowered = mlir.lower_fun(on_cpu, multiple_results=False)
    mlir.register_lowering(primitive, lowered, platform="cpu")


# Sums along a chain, computed efficiently on a CPU.
#
# `jax.numpy.cumsum` becomes a tree of slices, and a product with a triangular matrix becomes a
# library call. For the few hundred additions of a chain, both are several times slower than the
# additions, and a small loop is not. The best form depends on the final number of rows, including
# all directions of a derivative and all members of a batch. It is chosen when a program is lowered,
# so the sum is a primitive.


def running_sum(x: Float[Array, "*row n"], *, backwards: bool = False) -> Float[Array, "*row n"]:
    """Return cumulative sums along the last axis; with `backwards`, from the end."""
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
    """Return the transpose: the same sum in the other direction."""
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
# XLA fuses a few operations on a vector with the computation of the vector into one kernel, and
# computes the vector again for each use: for each component of a cross product twice. This is cheap
# for motions, but the derivatives of forces have a hundred operations. On a CPU, only a loop that
# is a separate kernel prevents the fusion. An `optimization_barrier` is removed before kernels are
# created.


def derivative_barrier(x: Float[Array, "*row n"]) -> Float[Array, "*row n"]:
    """Return rows along a chain whose forward derivatives are computed apart from their uses."""
    same: Array = _once_p.bind(x, now=False)
    return same


def computed_once(x: Float[Array, "*row n"]) -> Float[Array, "*row n"]:
    """Return rows along a chain that are computed apart from their uses."""
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
