"""Ratios of the times, for comparison between machines.

A ratio is the time of another program, of the plain arm, of five runs or of ten fits, divided by a
time of giajax, so that larger ratios are better for giajax.
"""

from typing import Any

from benchmarks import right_model
from benchmarks.bench._contenders import MINE

# The lower limits of the ratios that have one.
LIMITS = {
    "run: MuJoCo in C over giajax": 1 / 0.45,
    "run: CasADi over giajax": 1.0,
    "gradient: CasADi over giajax": 1 / 0.4,
    "batch: MuJoCo in C over giajax": 3.0,
    **{
        f"{what}: the plain arm over {name}": 1 / most
        for name, allowed in right_model.ALLOWED.items()
        for what, most in zip(("run", "gradient"), allowed, strict=True)
    },
    "gradient: the plain arm over a stiffness of each joint": 1 / right_model.ALLOWED_EACH,
    "studies: ten fits over 60 refits": 1.0,
}


def ratios(found: dict[str, Any]) -> dict[str, float]:
    """Return ratios of least times within this run, because other load can only increase a time.

    Arguments:
        found: tables of seconds by name, for one `evaluation`, a `run`, its `gradient`, a `batch`
            and the `fits`; the `arms` and `each` of `benchmarks.right_model`; and the `processes`.

    Returns:
        Ratios by name, without absent contenders. Larger ratios are better for giajax.
    """
    tables = {
        "evaluation": (found["evaluation"], "giajax"),
        "run": (found["run"], MINE),
        "gradient": (found["gradient"], MINE),
        "batch": (found["batch"], "giajax"),
        "fit": (found["fits"], "giajax"),
    }
    peers = {
        "MuJoCo in C": "MuJoCo, drag in C",
        "CasADi": "CasADi in C",
        "best of scipy": "scipy",
        "MuJoCo sysid": "MuJoCo sysid",
        "Tsit5": "giajax tsit5",
        "numpy": "numpy",
    }
    ratios = {}
    for what, (table, mine) in tables.items():
        for title, prefix in peers.items():
            if (theirs := least(table, prefix)) is not None:
                ratios[f"{what}: {title} over giajax"] = theirs / least_of_mine(table, mine)
    ratios["giajax: five runs over value and Jacobian"] = (
        5 * found["run"][MINE]["min"] / found["gradient"][MINE]["min"]
    )
    for name, each in found["arms"].items():
        if name in right_model.ALLOWED:
            ratios[f"run: the plain arm over {name}"] = 1 / each["run"]["ratio"]
            ratios[f"gradient: the plain arm over {name}"] = 1 / each["slopes"]["ratio"]
    slopes = found["each"]["Jacobian"]["ratio"]
    ratios["gradient: the plain arm over a stiffness of each joint"] = 1 / slopes
    if (alone := found["processes"]) is not None:
        ratios["studies: ten fits over 60 refits"] = 10 * alone["next"]["wall"] / alone["refits"]
    return ratios


def least(table: dict[str, Any], prefix: str) -> float | None:
    """Return the least seconds of the rows whose name starts with `prefix`; None without any."""
    seconds = [each["min"] for name, each in table.items() if name.startswith(prefix)]
    return min(seconds, default=None)


def least_of_mine(table: dict[str, Any], prefix: str) -> float:
    """Return the least seconds of giajax, which is always measured."""
    seconds = least(table, prefix)
    assert seconds is not None
    return seconds


def held(ratios: dict[str, float]) -> dict[str, bool]:
    """Return whether each limit with a measured ratio is respected."""
    return {name: ratios[name] >= limit for name, limit in LIMITS.items() if name in ratios}
