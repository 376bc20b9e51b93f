"""What makes one experiment better than another: c-, A- and D-optimality.

Each is the logarithm of an error to expect, of the covariance C of all that is free, nuisances
too (Pukelsheim, Optimal Design of Experiments, chapters 3 and 6):

- c: the standard error of one linear combination w^T p, the square root of w^T C w;
- A: the root of the trace of C over the parameters of interest, and not of its inverse;
- D: the geometric mean of their standard errors as if uncorrelated, det(C)^(1 / 2n).

C counts each parameter in a scale of its own, its value by default; D does not depend on it.
"""

import dataclasses
from typing import Literal, get_args

import numpy as np

from .._errors import InputError
from .._typing import Float
from ..study import expected_errors

Kind = Literal["c", "A", "D"]
_KINDS: tuple[str, ...] = get_args(Kind)

Matrix = Float[np.ndarray, "parameter parameter"]

# Without data a parameter is known to within so many times its scale: no matrix is singular, and
# a parameter that nothing responds to weighs nothing on the others.
_LOOSE = 100.0


@dataclasses.dataclass(frozen=True)
class Criterion:
    """The logarithm of an error to expect.

    Arguments:
        kind: "c", "A" or "D".
        weights: of each parameter: its part of the combination of "c"; for "A" and "D" that of the
            parameters of interest is not 0.

    Raises:
        InputError: no such kind, or no parameter of interest.
    """

    kind: str
    weights: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise InputError(
                f"there is no criterion '{self.kind}': use one of: {', '.join(_KINDS)}"
            )
        if not any(self.weights):
            raise InputError("no parameter is to be found: give the path of at least one")

    def of(self, covariance: Matrix) -> tuple[float, Matrix]:
        """Its value, and the derivative of that by the covariance."""
        weights = np.asarray(self.weights)
        slope = np.zeros_like(covariance)
        if self.kind == "c":
            variance = float(weights @ covariance @ weights)
            return 0.5 * np.log(variance), 0.5 * np.outer(weights, weights) / variance
        some = np.flatnonzero(weights)
        part = covariance[np.ix_(some, some)]
        if self.kind == "A":
            trace = float(np.trace(part))
            slope[some, some] = 0.5 / trace
            return 0.5 * np.log(trace), slope
        each = 0.5 / len(some)
        slope[np.ix_(some, some)] = each * np.linalg.inv(part)
        return each * float(np.linalg.slogdet(part)[1]), slope

    def is_determined(self, information: Matrix) -> bool:
        """Whether the data tell all that it is of, and not only what is known without them."""
        some, weights = np.flatnonzero(self.weights), np.asarray(self.weights)
        if self.kind == "c":
            # The combination takes the place of the parameter that has most of it.
            most = int(np.argmax(np.abs(weights)))
            turn = np.eye(len(weights))
            turn[most] = weights / weights[most]
            back = np.linalg.inv(turn)
            some, information = np.asarray([most]), back.T @ information @ back
        return bool(np.all(expected_errors(information)[some] < _LOOSE))

    def of_information(self, information: Matrix) -> tuple[float, Matrix]:
        """The same of the information, whose inverse the covariance is."""
        covariance = covariance_of(information)
        value, slope = self.of(covariance)
        return value, -covariance @ slope @ covariance


def covariance_of(information: Matrix) -> Matrix:
    """Covariance of scaled parameters, of which something is known without data, too."""
    whole = information + np.eye(len(information)) / _LOOSE**2
    sizes = np.sqrt(np.diag(whole))
    return np.asarray(np.linalg.inv(whole / np.outer(sizes, sizes)) / np.outer(sizes, sizes))
