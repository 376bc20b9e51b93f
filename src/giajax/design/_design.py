"""What the design of an experiment says: the command, the markers and the errors to expect."""

import dataclasses
from typing import Literal

import numpy as np

from .._typing import Float
from ..runs import Run
from ..synthetic import Drive
from ._limits import Limits
from ._search import Evaluation


@dataclasses.dataclass(frozen=True)
class Expected:
    """An experiment that was not made yet, and the errors to expect of it.

    Attributes:
        run: what will be commanded, and when rows are recorded, without recorded values.
        drive: the corners of the command.
        markers: bodies that are filmed (`link06`).
        errors: standard errors by path, in the unit of the parameter; infinite where the
            experiment does not determine one.
        criterion: error that the criterion is about; that of one parameter in its unit. None where
            the experiment does not determine it, to a hundred times the value at least.
        times: of the samples, s, shape (sample,).
        predicted: all candidates by name as the model foresees them, SI, each (sample,).
        channels: those of the markers.
    """

    run: Run
    drive: Drive
    markers: tuple[str, ...]
    errors: dict[str, float]
    criterion: float | None
    times: Float[np.ndarray, " sample"]
    predicted: dict[str, Float[np.ndarray, " sample"]]
    channels: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Design:
    """The experiment that was found, beside the paper's base step under the same limits.

    Attributes:
        limits: what the command may do.
        criterion: "c", "A" or "D".
        wanted: paths of the parameters of interest.
        parameters: of all that a fit would have free: value and unit, by path.
        noise: standard deviation of a cell, SI, by channel that may be recorded.
        designed: the experiment.
        base_step: the paper's, with markers chosen for it.
        before: standard errors by path of the result that the design began from; may be empty.
        spread: smallest and largest criterion of the design over draws of what is uncertain, over
            that of the present values.
        draws: how many, without those with which the base step cannot be simulated.
        status: "converged", "iteration limit" where the search for the best one ended there, or
            "interrupted" with the best so far.
        evaluations: of the search.
        seconds: that it took.
    """

    limits: Limits
    criterion: str
    wanted: tuple[str, ...]
    parameters: dict[str, tuple[float, str]]
    noise: dict[str, float]
    designed: Expected
    base_step: Expected
    before: dict[str, float]
    spread: tuple[float, float]
    draws: int
    status: Literal["converged", "iteration limit", "interrupted"]
    evaluations: tuple[Evaluation, ...]
    seconds: float

    @property
    def ratio(self) -> float | None:
        """Error of the design over that of the base step, by the criterion; None without one."""
        if self.designed.criterion is None or self.base_step.criterion is None:
            return None
        return self.designed.criterion / self.base_step.criterion

    def summary(self) -> str:
        """What the design comes to, in a clause."""
        if self.ratio is not None:
            return f"{self.ratio:.3f} times the error of the base step"
        both = {"the design": self.designed, "the base step": self.base_step}
        without = [name for name, one in both.items() if one.criterion is None]
        return f"{' and '.join(without)} cannot tell {', '.join(self.wanted)}"

    def __repr__(self) -> str:
        return f"<Design: {self.criterion}-optimal for {', '.join(self.wanted)}, {self.summary()}>"
