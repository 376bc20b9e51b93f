"""The figures and tables by name."""

import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from .._errors import InputError
from ._contenders import Fits, stand_in
from ._fig05 import fig05
from ._fig06 import fig06
from ._fig09 import fig09, fig10
from ._fig12 import fig12
from ._fig19 import fig19
from ._inverse import table3_inverse
from ._reproduced import Reproduced
from ._table3 import table3

Say = Callable[[str], None]

FIGURES: dict[str, Callable[[Say, Callable[[], Fits]], Reproduced]] = {
    "fig5": lambda say, fits: fig05(),
    "fig6": lambda say, fits: fig06(),
    "fig9": lambda say, fits: fig09(),
    "fig10": lambda say, fits: fig10(),
    "fig12": lambda say, fits: fig12(say),
    "fig19": lambda say, fits: fig19(fits()),
    "table3": lambda say, fits: table3(fits()),
    "table3_inverse": lambda say, fits: table3_inverse(say),
}
"""What is made again, by the name of its files; the last one by `table3 --inverse` alone."""


def reproduce(
    names: Sequence[str], recordings: Path, *, progress: Say | None = None
) -> Iterator[tuple[str, Reproduced]]:
    """Make figures and tables of the paper again.

    Arguments:
        names: of `FIGURES`.
        recordings: folder of the runs that stand in for the paper's, `data/paper` of a checkout.
        progress: called with what is being done.

    Returns:
        Each name with what it shows, one after the other, as they are made.

    Raises:
        InputError: a name that there is not, or a folder without those runs.
    """
    for name in names:
        if name not in FIGURES:
            raise InputError(f"there is no figure '{name}': use one of {', '.join(FIGURES)}")
    say = progress or (lambda text: None)
    # Fig. 19 and table 3 show the same fits, and most figures need none.
    fits = functools.cache(lambda: Fits(stand_in(recordings), say))
    return ((name, FIGURES[name](say, fits)) for name in names)
