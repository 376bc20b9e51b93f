"""What a study is: how it is run, compared with an earlier run of itself, and shown."""

import dataclasses
from collections.abc import Callable
from typing import Any

Figures = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Study:
    """A study whose figures depend on a size and on random numbers, and on nothing else.

    Attributes:
        name: of the study and of its file, `docs/evidence/NAME.json`.
        meaning: what is repeated and what the figures are, for the page.
        size: number of repetitions of the stored run.
        seed: of the random numbers of the stored run.
        run: figures, as JSON, of (size, seed).
        disagreements: sentences on what a smaller run of the same program with other random
            numbers could not have found, of (stored figures, new figures).
        table: the figures as rows of Markdown.
        part: as `run`, but of some of the cases: what the tests run again where even one
            repetition of all of them takes minutes; None for `run` itself.
    """

    name: str
    meaning: str
    size: int
    seed: int
    run: Callable[[int, int], Figures]
    disagreements: Callable[[Figures, Figures], list[str]]
    table: Callable[[Figures], list[str]]
    part: Callable[[int, int], Figures] | None = None


PROBABILITY = 1e-4
"""Of a disagreement of two runs by chance, of each comparison."""


def shares_differ(a: int, n: int, b: int, m: int, *, fewer: bool = False) -> bool:
    """Whether a of n and b of m cannot have one probability (Fisher's exact test).

    With `fewer`, only whether b of m are too few.
    """
    from scipy.stats import fisher_exact

    side = "greater" if fewer else "two-sided"
    return bool(fisher_exact([[a, n - a], [b, m - b]], alternative=side).pvalue < PROBABILITY)
