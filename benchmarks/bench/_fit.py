"""The whole fit by others: MuJoCo's own optimiser and scipy's, from the same start.

They minimise the same squares over the same samples. MuJoCo's optimiser is the one behind
`mujoco.sysid.optimize`, called as that calls it: the toolbox's parameters are entries of an MJCF
file, among which there is no such drag, so a residual of the user's own takes the place of its
rollouts, here MuJoCo with drag in C.
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

NOISE = 0.02  # m, as the sidecar states
STEP = 0.02  # s; divides the samples of the run, and keeps the tip within the accuracy
CLOSE = 0.01  # standard errors: an optimum that far off is the same
UNSTABLE = 1e3  # the residual of a run that ends early
MINE = "giajax"

Residual = Callable[[np.ndarray], np.ndarray]
Minimise = Callable[[Residual, np.ndarray], np.ndarray]


def fits(run: Run, repeats: int) -> dict[str, Any]:
    """Seconds of each fit, runs of the arm that it took, and how far off it ends.

    Arguments:
        run: the recording, from rest: joint 1 is commanded, centres of links are measured.
        repeats: how often each is measured.
    """
    model = model_for([run])
    # No look at the gradient and at the noise, nor at what is always uncertain: the others do not
    # look at them, either.
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
    """The recording that ships with giajax."""
    return read_run(RUN)


def small_run() -> Run:
    """A short one of three links, made by giajax: whether all of this runs."""
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
    """The residuals of a recording, of the free parameters, and who makes them small.

    Arguments:
        run: the recording.
        ends: ends of the links at the samples for values of `PARAMETERS`.
        result: of giajax: which parameters the recording determines, and the values of the rest.
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
        """Estimates from the start."""
        self.runs = 0
        start = np.array([START[path] for path in self._free])
        return dict(zip(self._free, self._minimise(self.residual, start).tolist(), strict=True))

    def residual(self, values: np.ndarray) -> np.ndarray:
        """Of one set of values, in standard deviations of the noise."""
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
    """Each optimiser over each arm that this machine has."""
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
    # Of its methods and scales these took the fewest runs of the arm: 28 for 44.
    found = least_squares(residual, start, method="lm", x_scale="jac")
    return np.asarray(found.x)


def _mujoco(residual: Residual, start: np.ndarray) -> np.ndarray:
    """As the toolbox calls it: columns of values, differences to one side, within bounds."""

    def columns(values: np.ndarray) -> np.ndarray:
        if values.ndim == 1:
            return residual(values)[:, None]
        return np.stack([residual(column) for column in values.T], axis=1)

    # 119 runs of the arm for 147, where MuJoCo has it.
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
