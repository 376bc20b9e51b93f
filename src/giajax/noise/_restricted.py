"""The restricted likelihood of the noise, given what a fit left over and what it could move.

Parameters that are fitted take with them a part of the noise, most of what is slow: the plain
likelihood takes slow noise for too small. The restricted likelihood (Patterson and Thompson 1971)
is that of all combinations of the cells which no parameter changes. To first order in the
parameters, with V the covariance of the cells, J the Jacobian and e the residuals,

    -2 log L = log|V| + log|J^T V^-1 J| + min_d (e + J d)^T V^-1 (e + J d).

What is known of a parameter before is one more row of residuals, of variance one: what takes part
in both J^T V^-1 J and the minimum. It is then the likelihood of all cells, with the parameter drawn
from its prior: of a parameter that is known well, the plain one.

Runs share some columns of J and have others of their own, which are eliminated run by run.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from .._typing import Float
from ._basis import conditioned
from ._cells import Cells, grams
from ._model import ChannelNoise

ByScale = Callable[[Float[np.ndarray, "noise scale"]], Float[np.ndarray, "noise scale"]]
"""-2 log L by the logarithms of factors of each of several noises of one key."""


class _Others(NamedTuple):
    """What the likelihood is made of apart from the cells of one key.

    Attributes:
        runs: Gram matrix of each run that has cells of the key, without them; and how many of its
            columns are its own.
        shared: of the other runs and the prior: Gram matrix without their own columns.
        known: log|V| of the cells, and log-determinants of the columns that are eliminated.
    """

    runs: dict[int, tuple[np.ndarray, int]]
    shared: np.ndarray
    known: float


@dataclasses.dataclass(frozen=True)
class Restricted:
    """Minus twice the logarithm of the restricted likelihood, as a function of one key's noise.

    Attributes:
        cells: of all channels of all runs, their columns of about the same size and independent.
        noise: of each key.
        grams: of each of `cells`, with that noise.
        prior: X^T X of the rows of priors; X are the shared columns and, last, the residual.
    """

    cells: tuple[Cells, ...]
    noise: Mapping[str, ChannelNoise]
    grams: tuple[tuple[np.ndarray, float], ...]
    prior: Float[np.ndarray, "column column"]

    @classmethod
    def of(
        cls,
        cells: Sequence[Cells],
        noise: Mapping[str, ChannelNoise],
        prior: Float[np.ndarray, "column column"] | None = None,
    ) -> Self:
        """The likelihood of the noise of some cells.

        Arguments:
            cells: of all channels of all runs.
            noise: of each key, to begin with.
            prior: as the attribute, of the columns of `cells`; None where nothing is known.
        """
        if prior is None:
            prior = np.zeros((cells[0].shared.shape[1] + 1,) * 2)
        those, prior = conditioned(cells, noise, prior)
        return cls(those, noise, tuple(each.gram(noise[each.key]) for each in those), prior)

    def with_noise(self, key: str, noise: ChannelNoise) -> Self:
        """The same with another noise of one key."""
        if noise == self.noise[key]:
            return self
        changed = (
            cells.gram(noise) if cells.key == key else before
            for cells, before in zip(self.cells, self.grams, strict=True)
        )
        return dataclasses.replace(self, noise={**self.noise, key: noise}, grams=tuple(changed))

    def of_key(self, key: str) -> tuple[Cells, ...]:
        """The cells of a key."""
        return tuple(each for each in self.cells if each.key == key)

    def value(self, key: str, noise: ChannelNoise) -> float:
        """-2 log L where the cells of one key have another noise."""
        return float(self.by_scale(key, [noise])(np.zeros((1, 1)))[0, 0])

    def by_scale(self, key: str, noises: Sequence[ChannelNoise]) -> ByScale:
        """-2 log L by the logarithms of factors of each of several noises of one key.

        A factor scales a Gram matrix: the samples are passed over once for all factors.
        """
        return self.by_scales([key], noises)[key]

    def by_scales(self, keys: Sequence[str], noises: Sequence[ChannelNoise]) -> dict[str, ByScale]:
        """As `by_scale`, of each of some keys with all others as they are.

        Cells at the same instants are passed over together.
        """
        those = [each for each in self.cells if each.key in keys]
        passes = [grams(those, noise) for noise in noises]
        of_keys: dict[str, dict[int, list[tuple[np.ndarray, np.ndarray]]]] = {}
        for at, each in enumerate(those):
            gram, log = (
                np.array(parts) for parts in zip(*(one[at] for one in passes), strict=True)
            )
            of_keys.setdefault(each.key, {}).setdefault(each.run, []).append((gram, log))
        return {
            key: self._by_scale(
                key,
                {
                    run: np.sum([gram for gram, _ in parts], axis=0)
                    for run, parts in of_runs.items()
                },
                np.sum([log for parts in of_runs.values() for _, log in parts], axis=0),
            )
            for key, of_runs in of_keys.items()
        }

    def _by_scale(
        self,
        key: str,
        of_runs: Mapping[int, Float[np.ndarray, "noise column column"]],
        determinants: Float[np.ndarray, " noise"],
    ) -> ByScale:
        """`by_scale`, of the Gram matrices of each run that has cells of the key, and of log|V|."""
        others = self._without(key)
        count = sum(len(each.residual) for each in self.of_key(key))

        def value(logs: Float[np.ndarray, "noise scale"]) -> Float[np.ndarray, "noise scale"]:
            powers = np.exp(-2 * logs)[..., None, None]
            total = others.known + determinants[:, None] + 2 * logs * count
            shared = others.shared
            for run, grams_of_run in of_runs.items():
                before, width = others.runs[run]
                rest, log = _eliminated(before + powers * grams_of_run[:, None], width)
                shared, total = shared + rest, total + log
            rest, log = _eliminated(shared, shared.shape[-1] - 1)
            return total + log + rest[..., 0, 0]

        return value

    def _without(self, key: str) -> _Others:
        """All but the cells of a key."""
        if key not in self._sums:
            mine = {each.run for each in self.of_key(key)}
            runs: dict[int, tuple[np.ndarray, int]] = {}
            known = 0.0
            for each, (gram, log) in zip(self.cells, self.grams, strict=True):
                before, width = runs.get(each.run, (np.zeros_like(gram), each.own.shape[1]))
                if each.key != key:
                    before, known = before + gram, known + log
                runs[each.run] = before, width
            shared = self.prior
            for run in sorted(runs.keys() - mine):
                rest, determinant = _eliminated(*runs[run])
                shared, known = shared + rest, known + float(determinant)
            self._sums[key] = _Others({run: runs[run] for run in mine}, shared, known)
        return self._sums[key]

    @functools.cached_property
    def _sums(self) -> dict[str, _Others]:
        return {}


def _eliminated(
    gram: Float[np.ndarray, "... column column"], width: int
) -> tuple[np.ndarray, np.ndarray]:
    """The Schur complements of the first columns of Gram matrices, and their log-determinants."""
    if not width:
        return gram, np.zeros(gram.shape[:-2])
    factor = np.linalg.cholesky(gram[..., :width, :width])
    across = np.linalg.solve(factor, gram[..., :width, width:])
    rest = gram[..., width:, width:] - np.swapaxes(across, -1, -2) @ across
    diagonal = np.diagonal(factor, axis1=-2, axis2=-1)
    return rest, 2 * np.sum(np.log(diagonal), axis=-1)
