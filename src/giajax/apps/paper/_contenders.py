"""Models that are compared with the stand-in for the paper's experiment, and their fits."""

import dataclasses
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...fitting import FitResult, fit, predict
from ...mechanics.arm import STANDARD_GRAVITY, takeichi_20m
from ...models import ArmModel
from ...recordings import Run, observing, read_run
from ...report import GREY
from ...runtime.arrays import Float
from ...runtime.text import InputError
from ...schema.parameters import replace

_LETTERS = 18  # Number of letters of the small print per inch.


@dataclasses.dataclass(frozen=True)
class Sources:
    """Sources of the contents of a figure.

    Attributes:
        printed: values and equations from the paper that are used or compared.
        assumed: values that the paper does not give.
        reconstructed: replacements for data that are not public.
    """

    printed: str
    assumed: str
    reconstructed: str

    def by_word(self) -> dict[str, str]:
        """Return the sentences by the heading under which they are printed."""
        words = ("Printed in the paper", "Assumed", "Reconstructed")
        return dict(zip(words, (self.printed, self.assumed, self.reconstructed), strict=True))


@dataclasses.dataclass(frozen=True)
class Reproduced:
    """A reproduced figure or table of the paper.

    Attributes:
        sources: which parts are printed in the paper, assumed, or reconstructed.
        figure: the figure, with the sources below it.
        columns: plotted values, by a name with its unit, in columns of equal length.
        facts: further values by name, in a form that JSON can represent.
    """

    title: str
    sources: Sources
    figure: Figure
    headings: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    columns: Mapping[str, Iterable[Any]]
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Write the sources below the figure in small print."""
        width = self.figure.get_size_inches()[0]
        lines = [
            textwrap.fill(f"{word}: {text}", round(width * _LETTERS), subsequent_indent="    ")
            for word, text in self.sources.by_word().items()
        ]
        self.figure.supxlabel(
            "\n".join(lines), x=0.01, ha="left", fontsize=7, color=GREY, linespacing=1.3
        )


WINDOW = (10.0, 25.0)  # First and last time that table 3 compares, s.
STEP = 0.1  # Interval between compared times, s.


def compared(times: Float[np.ndarray, " sample"]) -> np.ndarray:
    """Return the indices of the samples that table 3 compares: every 0.1 s from 10 to 25 s."""
    every = np.linspace(*WINDOW, round((WINDOW[1] - WINDOW[0]) / STEP) + 1)
    rows = np.abs(np.asarray(times)[:, None] - every[None]).argmin(axis=0)
    off = np.abs(times[rows] - every)
    if off.max() > 1e-6:
        raise InputError(
            f"the recording has no sample at {every[off.argmax()]:g} s, but table 3 compares "
            "values every 0.1 s from 10 to 25 s: sample the recording at these times"
        )
    return rows


def concordance(
    model: Float[np.ndarray, " sample"], experiment: Float[np.ndarray, " sample"]
) -> float:
    """Return the paper's concordance rate: the mean of 1 - |Xm - Xe| / |Xe|.

    It is 1 if model and experiment agree, and has no lower bound: a term is arbitrarily large where
    the experiment crosses zero. Samples that are exactly zero or missing (NaN) have no term.
    Displacements are in m.
    """
    counts = np.isfinite(experiment) & (experiment != 0)
    model, experiment = model[counts], experiment[counts]
    return float(np.mean(1 - np.abs(model - experiment) / np.abs(experiment)))


def relative_error(
    model: Float[np.ndarray, " sample"], experiment: Float[np.ndarray, " sample"]
) -> float:
    """Return the RMS of Xm - Xe divided by that of Xe: 0 for agreement, 1 for a model at rest."""
    counts = np.isfinite(experiment)
    difference = (model - experiment)[counts]
    return float(np.sqrt(np.mean(difference**2) / np.mean(experiment[counts] ** 2)))


LINKS = (2, 6, 12, 20)
"""The links of fig. 19 and table 3."""

HEIGHTS = tuple(f"link{link:02d}_z" for link in LINKS)
"""The channels that the paper's camera records, to which models are fitted."""

PAPERS = ("air.drag_coefficient", "joints.pitch_stiffness", "joints.damping")
_NO_AIR = {"air.drag_coefficient": 0.0}

# Known properties of the stand-in: it floats, because weights hang below it at this depth, its drag
# is distributed along the links, and its added mass is nonzero. Joint hysteresis is the first
# effect that the residuals of the paper's model suggest. Its values are an initial guess.
_KNOWN = {"air.added_mass_coefficient": 1.0, "buoyancy.trim_depth": 0.15}
_MEMORY = {"joints.memory.strength": 0.03, "joints.memory.yield_angle": 0.003}

# With hysteresis the cost is rough on a scale far below the noise: later iterations reduce it by
# less than a thousandth. Standard errors are not needed.
_ENOUGH_WITH_MEMORY = 12


@dataclasses.dataclass(frozen=True)
class Contender:
    """A model that is fitted to a recording.

    Attributes:
        start: function that returns the initial model of the fit.
        afterwards: parameters that are changed after the fit.
        as_fitted: name of the contender whose fit is reused; "" if the model has its own fit.
        on_another: whether the model is fitted to a run other than the one it is compared with.
    """

    label: str
    start: Callable[[], ArmModel]
    free: tuple[str, ...]
    afterwards: Mapping[str, float] = dataclasses.field(default_factory=dict)
    as_fitted: str = ""
    on_another: bool = False
    iterations: int = 50


def _papers() -> ArmModel:
    """Return the paper's model: drag at the link centres, 0.047 kg per link, no hysteresis."""
    return ArmModel(takeichi_20m())


def _own() -> ArmModel:
    known = {**_KNOWN, **_MEMORY}
    return ArmModel(
        takeichi_20m(drag="strip", trim=True, gravity=STANDARD_GRAVITY, parameters=known)
    )


CONTENDERS: dict[str, Contender] = {
    "with_air": Contender("the paper's model, fitted", _papers, PAPERS),
    "without_air": Contender(
        "the paper's model with C_D = 0", _papers, PAPERS, afterwards=_NO_AIR, as_fitted="with_air"
    ),
    "refitted": Contender(
        "the model without air, fitted again",
        lambda: replace(_papers(), _NO_AIR),
        PAPERS[1:],
    ),
    "own": Contender(
        "the giajax model, fitted to another run",
        _own,
        (*PAPERS, *_MEMORY),
        on_another=True,
        iterations=_ENOUGH_WITH_MEMORY,
    ),
}
"""The models by the names used in files."""


def stand_in(folder: Path) -> list[Run]:
    """Read the runs that stand in for the paper's recordings, from `data/paper` of the examples.

    Only the heights of the paper's links are used. The last run serves to fit the models that are
    compared with the other runs.
    """
    runs = [observing(read_run(path), HEIGHTS) for path in sorted(folder.glob("stand_in_*.csv"))]
    if len(runs) < 2:
        raise InputError(
            f"{folder} does not contain the runs stand_in_01.csv and following: reinstall giajax"
        )
    return runs


def times_of(run: Run) -> np.ndarray:
    """Return the sample times, s, shape (sample,); every run of an arm has them."""
    return np.asarray(run.times, dtype=float)


class Fits:
    """Fits of the contenders to runs, each made once; the last run is used only for fits."""

    def __init__(self, runs: Sequence[Run], say: Callable[[str], None]) -> None:
        self.runs = tuple(runs[:-1])
        self._other = runs[-1]
        self._say = say
        self._results: dict[tuple[str, str], FitResult] = {}

    def result(self, name: str, run: Run) -> FitResult:
        """Return the fit of a contender that is compared with a run; Ctrl-C ends all fits."""
        contender = CONTENDERS[name]
        used = self._other if contender.on_another else run
        # The paper's model is fitted once, with air, for both contenders that share the fit.
        key = (contender.as_fitted or name, used.name)
        if key not in self._results:
            self._say(f"fitting {contender.label.partition(',')[0]} to {used.name}")
            # The sidecars specify white noise: all other residuals are model errors.
            result = fit(
                contender.start(),
                used,
                free=contender.free,
                noise_model="white",
                max_iterations=contender.iterations,
                check=False,
            )
            if result.status == "interrupted":
                # A table of an incomplete fit would look like that of a complete one.
                raise KeyboardInterrupt
            self._results[key] = result
        return self._results[key]

    def predicted(self, name: str, run: Run) -> dict[str, np.ndarray]:
        """Return the predicted heights of the paper's links, m, by channel."""
        model = replace(self.result(name, run).model, CONTENDERS[name].afterwards)
        channels = predict(model, run)
        return {channel: np.asarray(channels[channel]) for channel in HEIGHTS}

    def record(self) -> list[dict[str, object]]:
        """Return the run, status and estimates of every fit."""
        return [
            {
                "model": name,
                "run": run,
                "status": result.status,
                "reduced_chi_square": result.reduced_chi_square,
                "estimates": {
                    path: float(result.parameters[path].value) for path in CONTENDERS[name].free
                },
            }
            for (name, run), result in self._results.items()
        ]
