"""Priors as rows of the residual: what is known of a parameter counts as one more measurement."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._maths import on_device
from .._typing import Array, Float
from ..quantities import Prior
from ._bijector import Bijector

Rows = Float[Array, " prior"]


class Priors(eqx.Module):
    """What is known of some free coordinates before the fit, a row of the residual each.

    A row is (p - centre) / spread, of the parameter p or of its logarithm. It is not whitened,
    no loss transforms it, and no noise is estimated from it.

    Attributes:
        centre, spread: mean and standard deviation, of the parameter or its logarithm.
        columns: positions of the parameters in the free coordinate.
        logarithmic: whether the logarithm of each is normal.
    """

    centre: Rows
    spread: Rows
    columns: tuple[int, ...] = eqx.field(static=True, default=())
    logarithmic: tuple[bool, ...] = eqx.field(static=True, default=())

    @classmethod
    def of(cls, priors: Mapping[str, Prior], paths: Sequence[str]) -> Self:
        """The rows of some priors.

        Arguments:
            priors: by path, of an element or of a whole array.
            paths: of the parameter at each position of the free coordinate.
        """
        known = [prior_of(priors, path) for path in paths]
        rows = [(column, prior) for column, prior in enumerate(known) if prior is not None]
        dtype = jnp.result_type(float)
        return cls(
            centre=on_device([prior.centre for _, prior in rows], dtype),
            spread=on_device([prior.spread for _, prior in rows], dtype),
            columns=tuple(column for column, _ in rows),
            logarithmic=tuple(prior.logarithmic for _, prior in rows),
        )

    @classmethod
    def none(cls) -> Self:
        """No prior at all."""
        return cls.of({}, ())

    def __len__(self) -> int:
        return len(self.columns)

    def rows(self, coordinate: Float[Array, " parameter"], bijector: Bijector) -> tuple[Rows, Rows]:
        """Rows of the residual, and the derivative of each by its own free coordinate."""
        columns = np.asarray(self.columns, dtype=int)
        bounds = bijector.at(columns)
        logarithmic = np.asarray(self.logarithmic, dtype=bool)

        def row(part: Array) -> Array:
            values = bounds.forward(part)
            # A stand-in that keeps the branch which is not taken free of NaN.
            logarithms = jnp.log(jnp.where(logarithmic, values, 1))
            return (jnp.where(logarithmic, logarithms, values) - self.centre) / self.spread

        part = coordinate[columns]
        return jax.jvp(row, (part,), (jnp.ones_like(part),))


def prior_of(priors: Mapping[str, Prior], path: str) -> Prior | None:
    """What is known of a scalar parameter: by itself, or as an element of its array."""
    return priors.get(path, priors.get(path.partition("[")[0]))


def prior_row(prior: Prior, value: float) -> tuple[float, float]:
    """The row of the residual that a prior is, and its derivative by the parameter itself."""
    if prior.logarithmic:
        return (math.log(value) - prior.centre) / prior.spread, 1 / (value * prior.spread)
    return (value - prior.centre) / prior.spread, 1 / prior.spread


def checked_priors(priors: Mapping[str, Any]) -> dict[str, Prior]:
    """The priors, also where they are given as `{"value": ..., "deviation": ...}`.

    Raises:
        InputError: what is no prior.
    """
    checked = {}
    for path, prior in priors.items():
        try:
            checked[path] = prior if isinstance(prior, Prior) else Prior(**prior)
        except InputError as error:
            raise InputError(f"the prior of '{path}' is not right, because {error}") from None
        except TypeError:
            raise InputError(
                f"the prior of '{path}' is no prior: give giajax.Prior(value, deviation=...)"
            ) from None
    return checked
