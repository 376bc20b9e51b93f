"""Interface of a study: its run, comparison with stored figures, and table."""

import dataclasses
from collections.abc import Callable
from typing import Any

Figures = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Study:
    """A study whose figures depend only on a size and on random numbers.

    Attributes:
        name: name of the study and of its file, `docs/evidence/NAME.json`.
        meaning: description of the repetitions and figures, for the page.
        size: number of repetitions of the stored run.
        seed: seed of the random numbers of the stored run.
        run: function of (size, seed) that returns the figures, as JSON.
        disagreements: function of (stored figures, new figures) that returns sentences on figures
            of a smaller run with other random numbers that are inconsistent with the stored ones.
        table: function that returns the figures as lines of Markdown.
        title: heading on the page; by default, the name.
        part: as `run`, for some of the cases. The tests run it if one repetition of all cases takes
            minutes; None means `run` itself.
    """

    name: str
    meaning: str
    size: int
    seed: int
    run: Callable[[int, int], Figures]
    disagreements: Callable[[Figures, Figures], list[str]]
    table: Callable[[Figures], list[str]]
    title: str | None = None
    part: Callable[[int, int], Figures] | None = None


PROBABILITY = 1e-4
"""Probability of a disagreement of two runs by chance, for each comparison."""


def shares_differ(a: int, n: int, b: int, m: int, *, fewer: bool = False) -> bool:
    """Return whether a of n and b of m have different probabilities (Fisher's exact test).

    With `fewer`, the test is whether b of m are significantly fewer.
    """
    from scipy.stats import fisher_exact

    side = "greater" if fewer else "two-sided"
    return bool(fisher_exact([[a, n - a], [b, m - b]], alternative=side).pvalue < PROBABILITY)
