"""Loss functions, which weight large residuals. Users can define additional ones."""

import abc
import dataclasses
import functools
import math
import numbers
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..runtime.arrays import Array, Float
from ..runtime.plugins import name_of, optional, register, registered
from ..runtime.programs import program
from ..runtime.text import InputError, shown, tried


class Scores(NamedTuple):
    """Loss and its derivatives at residuals. All arrays have the shape of the residuals.

    Attributes:
        rho: value of the loss.
        psi: half the derivative of `rho`.
        curvature: derivative of `psi`.
        slope: derivative of t(r) = sign(r) sqrt(rho(r)), which is 1 at 0.
    """

    rho: Any
    psi: Any
    curvature: Any
    slope: Any


def _all_scores(loss: "AbstractLoss", r: Array) -> Scores:
    def psi(r: Array) -> Array:
        return jax.jvp(loss.rho, (r,), (jnp.ones_like(r),))[1] / 2

    rho = loss.rho(r)
    value, curvature = jax.jvp(psi, (r,), (jnp.ones_like(r),))
    # rho = t^2 gives psi = t t'. At 0 every loss is quadratic with t' = 1.
    t = jnp.sign(r) * jnp.sqrt(rho)
    slope = jnp.where(t == 0, 1, value / jnp.where(t == 0, 1, t))
    return Scores(rho, value, curvature, slope)


def untransformed(rows: np.ndarray | float, slope: np.ndarray) -> np.ndarray:
    """Divide by the slope. The result is 0 where rho is constant, so a cell has no effect."""
    return np.divide(rows, slope, out=np.zeros(np.broadcast(rows, slope).shape), where=slope != 0)


_scores = program(_all_scores)


@eqx.filter_custom_jvp
def _transform(loss: "AbstractLoss", r: Array) -> Array:
    return jnp.sign(r) * jnp.sqrt(loss.rho(r))


@_transform.def_jvp
def _transform_jvp(primals: tuple[Any, Array], tangents: tuple[Any, Any]) -> tuple[Array, Any]:
    loss, r = primals
    moved = tangents[1]
    return _transform(loss, r), None if moved is None else _scores(loss, r).slope * moved


# Fractions of the cells of a run with residuals above one standard deviation: the first is expected
# from noise alone, and at the second the model is still far from the data.
_NOISE_ALONE, _FAR = 0.35, 0.65

# Fraction of the reweighted curvature that remains for distant cells at an optimum, where their own
# curvature is small or negative.
_KEPT = 0.05

_FEWEST = 1024  # minimum length of padded residuals, because each length needs a program


class AbstractLoss(eqx.Module):
    """Loss function of residuals that are divided by their noise.

    The cost of a fit is half the sum of `rho`. A subclass defines only this method, and all other
    quantities follow from its derivatives. The parameters of a loss are numbers, fields with a
    default, and are held in a fit. `check_loss` tests a loss.
    """

    registered_as: ClassVar[str] = "loss"

    @abc.abstractmethod
    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the loss of each residual: r^2 near 0, even, and not decreasing in |r|."""

    @optional
    def transform(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return t(r) = sign(r) sqrt(rho(r)). The least-squares cost is half the sum of t^2."""
        return _transform(self, r)

    @optional
    def scores(self, r: Float[np.ndarray, "*n"]) -> Scores:
        """Return `rho` and its derivatives at residuals, as NumPy arrays."""
        # Padding to a power of two limits the number of programs.
        padded = np.zeros(max(_FEWEST, 1 << max(r.size - 1, 0).bit_length()))
        padded[: r.size] = r.ravel()
        found = _scores(self, jnp.asarray(padded))
        return Scores(*(np.asarray(each)[: r.size].reshape(r.shape) for each in found))

    def weights(self, r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Return the weights of iteratively reweighted least squares, psi / r, which are 1 at 0."""
        return np.divide(self.scores(r).psi, r, out=np.ones(r.shape), where=r != 0)

    @property
    def outlier_weight(self) -> float:
        """Weight below which a cell is an outlier, at about three standard deviations."""
        return float(np.clip(self.weights(np.array([3.0]))[0], 1e-6, 1 / 3))

    def curvature_ratio(
        self, r: Float[Array, " cell"], measured: Float[Array, " cell"]
    ) -> Float[Array, " cell"]:
        """Return factors on rows of the Jacobian of t for an accurate curvature of the cost.

        Gauss-Newton with t uses t'^2 as the curvature of a cell, which is wrong for all distant
        cells. If the model is far from the data, psi / r is right: this is the step of reweighted
        least squares, which would remove all residuals, while the step for t would be twice as
        long. At the optimum, where outliers remain, the right curvature is psi', or zero if that is
        negative. The fraction of distant cells determines the interpolation between the two.

        The factor is the square root of the curvature, divided by t'. `measured` is 1 or 0.
        Dividing the rows of t by the factor keeps the gradient unchanged.
        """
        _, psi, curvature, slope = _scores(self, r)
        reweighted = jnp.where(r == 0, 1, psi / jnp.where(r == 0, 1, r))
        far = jnp.sum(jnp.where(jnp.abs(r) > 1, measured, 0))
        share = far / jnp.maximum(jnp.sum(measured), 1)
        off = jnp.clip((share - _NOISE_ALONE) / (_FAR - _NOISE_ALONE), _KEPT, 1)
        root = jnp.sqrt(off * reweighted + (1 - off) * jnp.maximum(curvature, 0))
        # Where rho is constant, a cell has no effect on the step.
        return jnp.where(slope > 0, root / jnp.where(slope > 0, slope, 1), 1)

    @property
    def is_linear(self) -> bool:
        """Whether the loss is the square of each residual, so that least squares need no change."""
        return type(self) is Linear

    @property
    def mean_square(self) -> float:
        """Mean of psi^2 for unit normal noise, which normalises a robust chi-square."""
        return _normal_mean(lambda r: self.scores(r).psi ** 2)

    @property
    def efficiency(self) -> float:
        """Variance of a least-squares estimate relative to that with this loss, for normal noise.

        It is the squared mean of psi' divided by the mean of psi^2 (Huber 1981, section 3.2).
        """
        return _normal_mean(lambda r: r * self.scores(r).psi) ** 2 / self.mean_square

    def contents(self) -> str | dict[str, Any]:
        """Return the entry in files: the name or, with parameters, a table of name and parameters.

        Raises:
            InputError: its class is not registered, or a parameter is not a number.
        """
        name = name_of(type(self))
        if registered(self.registered_as, name) is not type(self):
            raise InputError(
                f"the loss {name} is not registered, so a result cannot refer to it: call "
                "giajax.register on its class"
            )
        values = _parameters(self)
        return {"name": name, **values} if values else name


def _parameters(loss: AbstractLoss) -> dict[str, int | float]:
    """Return the parameters of a loss by name. They must be numbers."""
    name, values = name_of(type(loss)), {}
    for each in dataclasses.fields(loss):
        given = getattr(loss, each.name)
        value = given.item() if isinstance(given, np.generic) else given
        if not (isinstance(value, int | float) and math.isfinite(value)):
            raise InputError(
                f"the loss {name} has {each.name} = {given!r}, which cannot be stored in a file: "
                "give a finite number"
            )
        if each.name == "name":
            raise InputError(
                f"the loss {name} has a parameter called 'name', which is reserved in files for "
                "the name of the loss: rename the parameter"
            )
        values[each.name] = value
    return values


def _normal_mean(of: Any) -> float:
    r, step = np.linspace(-12.0, 12.0, 24_001, retstep=True)
    density = np.exp(-(r**2) / 2) / np.sqrt(2 * np.pi)
    return float(np.sum(of(r) * density) * step)


@register
class Linear(AbstractLoss):
    """Squared residual r^2 (least squares)."""

    kind: ClassVar[str] = "linear"

    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return r^2."""
        return r**2

    def transform(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the residuals unchanged."""
        return r

    def scores(self, r: Float[np.ndarray, "*n"]) -> Scores:
        """Return `rho` and its derivatives at residuals, without a compiled program."""
        return Scores(r**2, r, np.ones_like(r), np.ones_like(r))


@register
class Huber(AbstractLoss):
    """Huber loss: r^2 up to |r| = 1, and 2 |r| - 1 beyond (Huber 1964)."""

    kind: ClassVar[str] = "huber"

    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the quadratic and, beyond |r| = 1, linear loss."""
        return jnp.where(jnp.abs(r) <= 1, r**2, 2 * jnp.abs(r) - 1)


@register
class SoftL1(AbstractLoss):
    """Soft L1 loss, 2 (sqrt(1 + r^2) - 1), a smooth variant of the Huber loss."""

    kind: ClassVar[str] = "soft_l1"

    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the loss in a form without cancellation near 0."""
        return 2 * r**2 / (1 + jnp.sqrt(1 + r**2))


@register
class StudentT(AbstractLoss):
    """Student's t loss, (nu + 1) log(1 + r^2 / (nu + 1)), for noise with heavy tails.

    It is minus twice the logarithm of the density of t, up to a constant. The density is scaled so
    that its curvature at 0 equals that of normal noise (Lange, Little and Taylor 1989). The
    influence of a residual decreases beyond |r| = sqrt(nu + 1), so distant outliers have almost no
    effect. A poor initial guess may therefore lead to a local optimum.

    Arguments:
        degrees_of_freedom: nu, which is held. The source recommends 4.

    Raises:
        InputError: the number of degrees of freedom is not positive.
    """

    kind: ClassVar[str] = "student_t"
    degrees_of_freedom: float = 4.0

    def __check_init__(self) -> None:
        if not self.degrees_of_freedom > 0:
            raise InputError(
                f"student_t has {self.degrees_of_freedom:g} degrees of freedom: give a positive "
                "number"
            )

    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the loss, which is quadratic near 0 and logarithmic beyond."""
        size = self.degrees_of_freedom + 1
        return size * jnp.log1p(r**2 / size)


def loss_of(said: str | Mapping[str, Any]) -> AbstractLoss:
    """Return the loss for an entry of settings or of a result.

    Arguments:
        said: name of the loss, or a table of its name and parameters.

    Raises:
        InputError: the name is unknown, or the loss does not have these parameters.

    Example:
        >>> from giajax.fitting import loss_of
        >>> loss_of({"name": "student_t", "degrees_of_freedom": 6})
        StudentT(degrees_of_freedom=6.0)
    """
    values: dict[str, Any] = {"name": said} if isinstance(said, str) else dict(said)
    name = values.pop("name")
    if (found := registered(AbstractLoss.registered_as, name)) is None:
        raise InputError(f"unknown loss '{name}': register its class, or correct the name")
    try:
        whole = {each.name for each in dataclasses.fields(found) if type(each.default) is int}
        for key, value in values.items():
            if not isinstance(value, numbers.Real):
                raise TypeError(f"{key} = {value!r} is not a number")
            values[key] = value if key in whole else float(value)
        loss: AbstractLoss = found(**values)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"the loss {name} cannot be created ({error}): give numbers as its parameters, and "
            "define a numerical default for each parameter in its class"
        ) from None
    return loss


def check_loss(loss: AbstractLoss) -> None:
    """Test a loss at 0 and at residuals from 0.001 to 10 000 times the noise.

    Raises:
        InputError: a parameter is not a number, the class overrides a method other than `rho`, or
            `rho` is wrong: it raises an exception, or returns a wrong shape or type, a value or
            derivative that is not finite, or a negative value; it differs for -r, depends on other
            residuals, jumps, decreases for larger residuals, or is not r^2 near 0. The message
            names the method.
    """
    if not isinstance(loss, AbstractLoss):
        raise InputError(
            f"{shown(loss)} is not a loss: give an instance of a class derived from "
            "giajax.fitting.AbstractLoss, such as giajax.fitting.StudentT()"
        )
    _parameters(loss)  # refuses parameters that cannot be hashed
    if type(loss).__module__ != __name__:
        _check_rho(loss)


@functools.lru_cache
def _check_rho(loss: AbstractLoss) -> None:
    cls = type(loss)
    for name, own in vars(AbstractLoss).items():
        if name[0] != "_" and name != "rho" and getattr(cls, name) is not own:
            raise InputError(
                f"{cls.__name__} defines {name}, which is derived from rho: remove it, and derive "
                "the class from AbstractLoss"
            )
    what = f"{type(loss).__name__}.rho"
    r = jnp.asarray(np.append(0.0, np.geomspace(1e-3, 1e4, 141)))
    with tried(what), jax.ensure_compile_time_eval():
        given: Any = loss.rho(r)
        if (shape := getattr(given, "shape", None)) != r.shape:
            raise InputError(
                f"{what} returns an array of shape {shape} for residuals of shape {r.shape}: "
                "return one number for each residual"
            )
        if given.dtype != r.dtype:
            raise InputError(
                f"{what} returns {given.dtype} for residuals of type {r.dtype}: return the same "
                "type"
            )
        found, mirrored = _scores(loss, r), np.asarray(loss.rho(-r))
        few, more = loss.rho(r[::2]), loss.rho(jnp.append(jnp.zeros_like(r), r))[r.size :]
    rho, psi, curvature, _ = (np.asarray(each) for each in found)
    names = {"value": rho, "derivative": psi, "second derivative": curvature}

    def refuse(wrong: np.ndarray, how: str, remedy: str) -> None:
        if np.any(wrong):
            raise InputError(f"{what} {how} at r = {np.asarray(r)[wrong][0]:.3g}: {remedy}")

    for name, values in names.items():
        refuse(~np.isfinite(values), f"has a {name} that is not finite", "correct it")
    refuse(rho < 0, "is negative", "make it at least 0, and equal to r^2 near 0")
    rounding = 1e-9 if rho.dtype == np.float64 else 1e-4
    uneven = np.abs(mirrored - rho) > rounding * np.abs(rho)
    refuse(uneven, "differs from its value at -r", "make it depend only on |r|")
    beside = np.abs(np.asarray(more) - rho)
    beside[::2] += np.abs(np.asarray(few) - rho[::2])
    refuse(
        beside > rounding * rho,
        "depends on the other residuals",
        "evaluate each residual separately",
    )
    if rho[0] != 0 or abs(curvature[0] - 1) > rounding:
        raise InputError(
            f"{what} is {rho[0]:.3g} + {curvature[0]:.6g} r^2 near r = 0, but must be r^2 there, "
            "because residuals are divided by the standard deviation of the noise: rescale it"
        )
    falling = np.append(False, np.diff(rho) < -rounding * rho[1:])
    refuse(falling, "decreases for larger residuals", "make it increase with |r|")
    size = np.asarray(r)
    rounded = 4 * np.finfo(rho.dtype).eps
    bent = (np.abs(rho - size**2) > 0.01 * size**2 + rounded) & (size < 2e-3)
    refuse(
        bent,
        "deviates from r^2 near 0",
        "make it equal to r^2 there, because residuals are divided by the standard deviation of "
        "the noise",
    )
    # The tolerance is coarse, because psi may have a corner or end abruptly.
    sums = np.append(0.0, np.cumsum((psi[1:] + psi[:-1]) * np.diff(size)))
    refuse(
        np.abs(rho - sums) > 0.2 * rho,
        "is not the integral of its derivative",
        "make both continuous",
    )
