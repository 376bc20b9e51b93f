"""A ladder of fits: each with more than the one before, and how much better it is."""

import dataclasses

import numpy as np

from ..fitting import FitResult, Suspect
from ._records import Suspects


@dataclasses.dataclass(frozen=True)
class Rung:
    """One fit of a ladder.

    Attributes:
        suspect: what was added to the fit before; None for the first.
        removed: whether it was taken out again: with what came later, nothing asks for it.
        chi_square: sum of what the loss makes of residuals in units of white noise, the same for
            all rungs, and of the squares of the priors.
        parameters: number of fitted parameters.
        values: number of measured values.
        held_out: root mean square error of the runs that were held out, in units of their noise
            or, where none is stated, of the white noise of the fitted ones; None without any.
        result: the fit.
        suspects: what its residuals ask for; None where that was not asked.
    """

    suspect: Suspect | None
    chi_square: float
    parameters: int
    values: int
    held_out: float | None
    result: FitResult
    suspects: Suspects | None = None
    removed: bool = False

    @property
    def change(self) -> str:
        """What was changed: a path, `without` one, or nothing for the first."""
        if self.suspect is None:
            return "-"
        return f"without {self.suspect.path}" if self.removed else self.suspect.path

    @property
    def aic(self) -> float:
        """Akaike's criterion, with known noise: chi-square + 2 k."""
        return self.chi_square + 2 * self.parameters

    @property
    def bic(self) -> float:
        """Schwarz' criterion, with known noise: chi-square + k log n."""
        return self.chi_square + self.parameters * float(np.log(self.values))


@dataclasses.dataclass(frozen=True)
class Ladder:
    """The fits, from the first to the last that was better, and why there is no other.

    Attributes:
        rungs: the first is the fit that was asked about.
        ending: one sentence.
    """

    rungs: tuple[Rung, ...]
    ending: str

    @property
    def result(self) -> FitResult:
        """The last fit."""
        return self.rungs[-1].result
