"""The whole fit by the optimisers of MuJoCo and scipy, from the same initial guess.

All optimisers minimise the same sum of squares over the same samples. MuJoCo's optimiser is the one
that `mujoco.sysid.optimize` calls, and it is called in the same way. The parameters of that toolbox
are entries of an MJCF file, which has no drag of this kind. The residual function of the toolbox is
therefore replaced by one that simulates MuJoCo with drag in C.
"""

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from mujoco import minimize
from scipy.optimize import least_squares

from benchmarks.bench._process import RUN, START
from benchmarks.measuring import in_turns
from giajax import FitResult, Run, fit, model_for, read_run
from giajax.simulation import logged
from peers.compiling import CompilerError
from peers.mujoco_c import MujocoInC
from peers.plain_arm import PARAMETERS

NOISE = 0.02  # m, as in the sidecar
STEP = 0.02  # s; divides the sampling interval and keeps the tip within the accuracy
CLOSE = 0.01  # largest distance of two equal optima, in standard errors
UNSTABLE = 1e3  # residual of a run that diverges
MINE = "giajax"

Residual = Callable[[np.ndarray], np.ndarray]
Minimise = Callable[[Residual, np.ndarray], np.ndarray]


def fits(run: Run, repeats: int) -> dict[str, Any]:
    """Measure the seconds and runs of each fit, and the distance of its end from the optimum.

    Arguments:
        run: recording from rest; joint 1 is commanded, centres of links are measured.
        repeats: number of measurements of each fit.
    """
    model = model_for([run])
    # Skip the gradient check, the noise model and the nuisance parameters, because the other
    # optimisers do not compute them.
    mine: Callable[..., FitResult] = partial(
        fit, model, run, start=START, check=False, noise_model="white", nuisances=False
    )
    reference = mine(tolerance=1e-10)
    squares: dict[str, Peer | None] = {MINE: None, **_peers(run, model, reference)}
    estimates: dict[str, Mapping[str, float]] = {}

    def keep(name: str) -> Callable[[], None]:
        def one() -> None:
            peer = squares[name]
            if peer is None:
                estimates[name] = {path: each.value for path, each in mine().free.items()}
            else:
                estimates[name] = peer.fit()

        return one

    seconds = in_turns({name: keep(name) for name in squares}, repeats)
    for name, peer in squares.items():
        seconds[name]["standard_errors_off"] = max(
            abs(estimates[name][path] - each.value) / each.standard_error
            for path, each in reference.free.items()
            if each.standard_error
        )
        if peer is not None:
            seconds[name]["runs"] = peer.runs
    return seconds


def base_step() -> Run:
    """Read the recording that is part of giajax."""
    return read_run(RUN)


def small_run() -> Run:
    """Simulate a short recording of three links, for a test of the benchmark."""
    times = np.linspace(0.0, 4.0, 41)
    still: dict[str, Any] = {
        "joint01_command": np.interp(times, [0.5, 1.0], [0.0, 0.5]),
        **dict.fromkeys(("link02_z", "link03_z"), np.zeros_like(times)),
    }
    known = {"model": "arm", "arm": {"links": 3}, "noise": {"position_m": NOISE}}
    empty = Run.from_arrays(times, still, definition=known)
    model = model_for([empty])
    moved, _ = model.predict(model.prepare(empty), tuple(empty.observations))
    random = np.random.default_rng(0)
    noisy = {name: value + NOISE * random.normal(size=41) for name, value in moved.items()}
    return Run.from_arrays(times, {**still, **noisy}, definition=known)


class Peer:
    """Another optimiser with the residuals of a recording as a function of the free parameters.

    Arguments:
        run: the recording.
        ends: returns the ends of the links at the samples, given values of `PARAMETERS`.
        result: giajax result, which gives the identifiable parameters and the values of the rest.
        minimise: the optimiser.
    """

    def __init__(
        self,
        run: Run,
        ends: Callable[[Mapping[str, float]], np.ndarray],
        result: FitResult,
        minimise: Minimise,
    ) -> None:
        self._ends = ends
        self._held = {path: float(result.parameters[path].value) for path in PARAMETERS}
        self._free = [path for path, each in result.free.items() if each.standard_error]
        self._links = [int(name[4:6]) - 1 for name in run.observations]
        self._measured = np.stack(list(run.observations.values()), axis=-1)
        self._minimise = minimise
        self.runs = 0

    def fit(self) -> dict[str, float]:
        """Return the estimates, starting from the initial guess."""
        self.runs = 0
        start = np.array([START[path] for path in self._free])
        return dict(zip(self._free, self._minimise(self.residual, start).tolist(), strict=True))

    def residual(self, values: np.ndarray) -> np.ndarray:
        """Return the residuals, divided by the standard deviation of the noise."""
        self.runs += 1
        parameters = self._held | dict(zip(self._free, values.tolist(), strict=True))
        try:
            ends = self._ends(parameters)
        except FloatingPointError:
            return np.full(self._measured.size, UNSTABLE)
        heights = np.pad(ends[:, :, 2], ((0, 0), (1, 0)))
        centres = (heights[:, 1:] + heights[:, :-1]) / 2
        return ((centres[:, self._links] - self._measured) / NOISE).ravel()


def _peers(run: Run, model: Any, result: FitResult) -> dict[str, Peer]:
    """Return each optimiser with the simulation that this machine can compile."""
    assert run.times is not None
    times = run.times
    columns = np.zeros((len(times), model.arm.count))
    columns[:, 0] = run.commands["joint01_command"]
    command = logged(times, columns)
    found = {}
    try:
        engine = MujocoInC(model.arm, command)

        def by_mujoco(parameters: Mapping[str, float]) -> np.ndarray:
            engine.set_parameters(parameters)
            return engine.ends(times, STEP)

        found["scipy least_squares over MuJoCo in C"] = Peer(run, by_mujoco, result, _scipy)
        found["MuJoCo sysid over MuJoCo in C"] = Peer(run, by_mujoco, result, _mujoco)
    except CompilerError:
        return {}
    return found


def _scipy(residual: Residual, start: np.ndarray) -> np.ndarray:
    # Of scipy's methods and scales, these need the fewest runs of the arm: 28 instead of 44.
    found = least_squares(residual, start, method="lm", x_scale="jac")
    return np.asarray(found.x)


def _mujoco(residual: Residual, start: np.ndarray) -> np.ndarray:
    """Minimise as the toolbox does: columns of values, one-sided differences, within bounds."""

    def columns(values: np.ndarray) -> np.ndarray:
        if values.ndim == 1:
            return residual(values)[:, None]
        return np.stack([residual(column) for column in values.T], axis=1)

    # The scale reduces the runs of the arm from 147 to 119, in the versions of MuJoCo that have it.
    has_scale = "x_scale" in inspect.signature(minimize.least_squares).parameters
    found, _ = minimize.least_squares(
        start,
        columns,
        bounds=[np.zeros_like(start), np.full_like(start, 1e3)],
        verbose=minimize.Verbosity.SILENT,
        max_iter=200,
        **({"x_scale": "jac"} if has_scale else {}),
    )
    return np.ravel(found)
