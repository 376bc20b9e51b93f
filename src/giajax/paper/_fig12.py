"""Fig. 12: measured against command values of one link, without and with compensation."""

from collections.abc import Callable

from ..experiments import figure_12, one_link, one_link_table
from ..report import DEGREE
from ._reproduced import Reproduced, Sources

SOURCES = Sources(
    printed=f"the history (60, -60, 0{DEGREE} twice, 1{DEGREE} every 5 or 20 s), eq. (12), the "
    "offsets that make the mean error least, and the errors in the table.",
    assumed=f"over how much travel xi goes from 0 to 1: 40{DEGREE}.",
    reconstructed="the link: a simulated joint that snaps through 0 and is hysteretic. The inverse "
    "operator and the second history are giajax's.",
)


def fig12(progress: Callable[[str], None] | None = None) -> Reproduced:
    """Fig. 12, and the errors that the text gives.

    Arguments:
        progress: called with what is being done.
    """
    study = one_link(progress=progress)
    none, branches, inverse = (
        study.trial("paper", name) for name in ("none", "branches", "inverse")
    )
    rows = (
        ("without", "about 30", none.largest, "about 11", none.mean, "1", 1.0),
        (
            "eq. (12)",
            "almost the same",
            branches.largest,
            "-",
            branches.mean,
            "less than 0.5",
            branches.mean / none.mean,
        ),
        (
            "inverse operator",
            "-",
            inverse.largest,
            "-",
            inverse.mean,
            "-",
            inverse.mean / none.mean,
        ),
    )
    headings = (
        "compensation",
        "largest error in the paper, deg",
        "here",
        "mean error in the paper, deg",
        "here",
        "of that without, in the paper",
        "here",
    )
    figure = figure_12(study)
    title = "Fig. 12: one link, measured against target angles (a simulated joint)"
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return Reproduced(title, SOURCES, figure, headings, rows, one_link_table(study))
