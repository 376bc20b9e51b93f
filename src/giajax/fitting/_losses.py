"""Losses: how a large residual counts. A loss of one's own is one more."""

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
    """What a loss makes of residuals, each of their shape.

    Attributes:
        rho: what they count as.
        psi: half its derivative.
        curvature: the derivative of psi.
        slope: that of t(r) = sign(r) sqrt(rho(r)); 1 at 0.
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
    # rho = t^2, so psi = t t'; at 0 every loss is quadratic with t' = 1.
    t = jnp.sign(r) * jnp.sqrt(rho)
    slope = jnp.where(t == 0, 1, value / jnp.where(t == 0, 1, t))
    return Scores(rho, value, curvature, slope)


def untransformed(rows: np.ndarray | float, slope: np.ndarray) -> np.ndarray:
    """What was multiplied by the slope without it; 0 where rho is level: it has no part there."""
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


# Shares of a run's cells that are off by more than their deviation: of a third, noise alone is the
# cause; of two thirds, the model is still far from the data.
_NOISE_ALONE, _FAR = 0.35, 0.65

# Part of the curvature of far cells that is kept at an optimum, where they have none or little.
_KEPT = 0.05

_FEWEST = 1024  # residuals that are scored at once: each number of them would be a program


class AbstractLoss(eqx.Module):
    """How residuals, in units of their noise, count: the cost of a fit is half the sum of `rho`.

    A loss has this one method; all else follows from its derivatives. Its parameters are numbers,
    fields with a default, and are held. `check_loss` tests a loss.
    """

    registered_as: ClassVar[str] = "loss"

    @abc.abstractmethod
    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """What each residual counts as, by itself: r^2 near 0, even, never less farther off."""

    @optional
    def transform(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """t(r) = sign(r) sqrt(rho(r)): half the sum of t^2 is the cost, as of least squares."""
        return _transform(self, r)

    @optional
    def scores(self, r: Float[np.ndarray, "*n"]) -> Scores:
        """`rho` and its derivatives at residuals, as arrays of NumPy."""
        # Padded to a power of two, of which there are few.
        padded = np.zeros(max(_FEWEST, 1 << max(r.size - 1, 0).bit_length()))
        padded[: r.size] = r.ravel()
        found = _scores(self, jnp.asarray(padded))
        return Scores(*(np.asarray(each)[: r.size].reshape(r.shape) for each in found))

    def weights(self, r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Those of reweighted least squares, psi / r; 1 at 0."""
        return np.divide(self.scores(r).psi, r, out=np.ones(r.shape), where=r != 0)

    @property
    def outlier_weight(self) -> float:
        """The weight below which a cell is an outlier, about three deviations off."""
        return float(np.clip(self.weights(np.array([3.0]))[0], 1e-6, 1 / 3))

    def curvature_ratio(
        self, r: Float[Array, " cell"], measured: Float[Array, " cell"]
    ) -> Float[Array, " cell"]:
        """By what to multiply rows of the Jacobian of t for a good second derivative of the cost.

        Gauss-Newton on t takes t'^2 for the curvature of a cell, which is right for none of the far
        ones. Where the model is off, psi / r is: the step of reweighted least squares, which would
        remove all residuals, where that of t would be twice as long. At the optimum, where outliers
        stay, it is psi', or none where that is negative. What is between the two is told by the
        share of the cells that are far.

        It is the root of the curvature over t'; `measured` is 1 or 0. With rows of t divided by it
        the gradient stays the same.
        """
        _, psi, curvature, slope = _scores(self, r)
        reweighted = jnp.where(r == 0, 1, psi / jnp.where(r == 0, 1, r))
        far = jnp.sum(jnp.where(jnp.abs(r) > 1, measured, 0))
        share = far / jnp.maximum(jnp.sum(measured), 1)
        off = jnp.clip((share - _NOISE_ALONE) / (_FAR - _NOISE_ALONE), _KEPT, 1)
        root = jnp.sqrt(off * reweighted + (1 - off) * jnp.maximum(curvature, 0))
        # Where rho is level, a cell has no part in the step.
        return jnp.where(slope > 0, root / jnp.where(slope > 0, slope, 1), 1)

    @property
    def is_linear(self) -> bool:
        """Whether each residual counts as its square, so that least squares stay what they are."""
        return type(self) is Linear

    @property
    def mean_square(self) -> float:
        """The mean of psi^2 of normal noise of deviation 1, by which a robust chi-square is one."""
        return _normal_mean(lambda r: self.scores(r).psi ** 2)

    @property
    def efficiency(self) -> float:
        """With normal noise, the variance of a least-squares estimate over that with this loss.

        It is the square of the mean of psi' over the mean of psi^2 (Huber 1981, section 3.2).
        """
        return _normal_mean(lambda r: r * self.scores(r).psi) ** 2 / self.mean_square

    def contents(self) -> str | dict[str, Any]:
        """What files say of it: its name or, with parameters, a table of name and parameters.

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
    """The parameters of a loss by name, which must be numbers."""
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
                f"the loss {name} has a parameter called 'name', which files reserve for the loss "
                "itself: rename the parameter"
            )
        values[each.name] = value
    return values


def _normal_mean(of: Any) -> float:
    r, step = np.linspace(-12.0, 12.0, 24_001, retstep=True)
    density = np.exp(-(r**2) / 2) / np.sqrt(2 * np.pi)
    return float(np.sum(of(r) * density) * step)


@register
class Linear(AbstractLoss):
    """r^2: least squares."""

    kind: ClassVar[str] = "linear"

    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """r^2."""
        return r**2

    def transform(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The residuals themselves."""
        return r

    def scores(self, r: Float[np.ndarray, "*n"]) -> Scores:
        """`rho` and its derivatives at residuals, without a program."""
        return Scores(r**2, r, np.ones_like(r), np.ones_like(r))


@register
class Huber(AbstractLoss):
    """r^2 up to |r| = 1, and 2 |r| - 1 beyond (Huber 1964)."""

    kind: ClassVar[str] = "huber"

    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Quadratic, then a line."""
        return jnp.where(jnp.abs(r) <= 1, r**2, 2 * jnp.abs(r) - 1)


@register
class SoftL1(AbstractLoss):
    """2 (sqrt(1 + r^2) - 1): as Huber's, and smooth."""

    kind: ClassVar[str] = "soft_l1"

    def rho(self, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Without the cancellation near 0."""
        return 2 * r**2 / (1 + jnp.sqrt(1 + r**2))


@register
class StudentT(AbstractLoss):
    """(nu + 1) log(1 + r^2 / (nu + 1)) for noise with the tails of Student's t.

    That is minus twice the logarithm of the density of t, up to a constant, of such a scale that
    its curvature at 0 is that of normal noise (Lange, Little and Taylor 1989). Its influence falls
    again beyond |r| = sqrt(nu + 1), so that outliers far off have hardly any, and a start far off
    may have optima of its own.

    Arguments:
        degrees_of_freedom: nu, which is held; 4 is what the source found to work well.

    Raises:
        InputError: degrees of freedom that are not positive.
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
        """Quadratic, then a logarithm."""
        size = self.degrees_of_freedom + 1
        return size * jnp.log1p(r**2 / size)


def loss_of(said: str | Mapping[str, Any]) -> AbstractLoss:
    """The loss that settings or a result state: a name, or a table of that and of parameters.

    Raises:
        InputError: there is no such name, or it has no such parameters.

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
            f"the loss {name} cannot be created ({error}): give numbers for its own "
            "parameters, each of which needs a default"
        ) from None
    return loss


def check_loss(loss: AbstractLoss) -> None:
    """Try a loss at 0 and at residuals from a thousandth of the noise to ten thousand times it.

    Raises:
        InputError: a parameter is not a number, or the class overrides another method than `rho`;
            or naming the method and what is wrong: an exception, a shape, a type, a value or a
            derivative that is not finite, a value that is negative, that differs for -r or beside
            others, that jumps or that falls for larger residuals, or another beginning than r^2.
    """
    if not isinstance(loss, AbstractLoss):
        raise InputError(
            f"{shown(loss)} is not a loss: give an instance of a class derived from "
            "giajax.fitting.AbstractLoss, such as giajax.fitting.StudentT()"
        )
    _parameters(loss)  # what can be hashed
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
                f"{what} returns {given.dtype} for residuals of {r.dtype}: keep the data type"
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
    refuse(rho < 0, "is negative", "make it at least 0, and r^2 near 0")
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
            "because residuals are in units of the noise: rescale it"
        )
    falling = np.append(False, np.diff(rho) < -rounding * rho[1:])
    refuse(falling, "decreases for larger residuals", "make it increase with |r|")
    size = np.asarray(r)
    rounded = 4 * np.finfo(rho.dtype).eps
    bent = (np.abs(rho - size**2) > 0.01 * size**2 + rounded) & (size < 2e-3)
    refuse(
        bent,
        "deviates from r^2 near 0",
        "make it equal to r^2 there, because residuals are in units of the noise",
    )
    # Coarse: psi may have a corner, or end at once.
    sums = np.append(0.0, np.cumsum((psi[1:] + psi[:-1]) * np.diff(size)))
    refuse(
        np.abs(rho - sums) > 0.2 * rho,
        "is not the integral of its derivative",
        "make both continuous",
    )
