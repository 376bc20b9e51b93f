"""Posterior distribution of the free parameters of a fit, sampled with NUTS."""

import contextlib
import contextvars
import dataclasses
import importlib.util
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..fitting import Density, FitResult, density_of, energy_at
from ..recordings import Run, unique_names
from ..runtime.arrays import on_device
from ..runtime.execution import InProcess, Threads, run_tasks
from ..runtime.process import is_stopped
from ..runtime.programs import program
from ..runtime.tasks import Outcome, Task
from ..runtime.text import InputError, install_command
from ._posterior_records import Posterior, PosteriorSummary, bands, doubts, marginal
from ._refit import Fitted

# Number of transitions per call of the program. Ctrl-C and progress are handled between calls.
_AT_ONCE = 20

# Number of warm-up transitions below which the mass matrix of the optimum is kept. A better
# estimate requires Stan's adaptation windows and some draws for each parameter. #  keys of chains
# whose programs #  keys of
_LEAST_TO_ADAPT, _EACH = 150, 10

_compiling = threading.Lock()
_compiled: set[tuple[Any, ...]] = set()  # keys of chains whose programs are compiled

# Function that is called with the number of transitions completed by chains of this process.
_listener: contextvars.ContextVar[Callable[[int], None] | None] = contextvars.ContextVar(
    "_listener", default=None
)


@dataclasses.dataclass(frozen=True)
class Begun:
    """Initial state of a chain.

    The energy and the gradient at the start are included because computing them in the task would
    require a second program.

    Attributes:
        density: density to be sampled.
        start: initial point in the coordinates of the sampler, shape (drawn,).
        energy: energy at the start.
        gradient: gradient of the energy at the start, shape (drawn,).
        task_key: key of the fit from which the above follows; it identifies the task.
    """

    density: Density
    start: np.ndarray
    energy: float
    gradient: np.ndarray
    task_key: str


def chain(begun: Begun, number: int, draws: int, warmup: int, seed: int) -> dict[str, Any]:
    """Task: sample a density. The chains of a study have different numbers, and thus seeds.

    Returns:
        `values` of all free parameters, shape (draw, parameter), SI; the `energy` (minus the
        logarithm of the density of the parameters, up to a constant), `diverging`, `steps` and
        `acceptance` of each draw; the `step_size`; and `warmup_diverging`, the number of divergent
        warm-up transitions.
    """
    total = warmup + draws
    length = next(n for n in range(min(_AT_ONCE, total), 0, -1) if total % n == 0)
    settings = warmup, warmup >= max(_LEAST_TO_ADAPT, _EACH * len(begun.start))
    density, dtype = begun.density, begun.density.centre.dtype
    start, energy, gradient = (
        on_device(each, dtype) for each in (begun.start, begun.energy, begun.gradient)
    )
    import numpyro.infer.hmc  # noqa: F401  # a cached program returns a class of it

    parts = []
    key = (begun.task_key, settings, length)
    with contextlib.ExitStack() as stack:
        # Chains that start together need the same programs, which each of them would otherwise
        # compile.
        if key not in _compiled:
            stack.enter_context(_compiling)
            if key in _compiled:
                stack.close()
        if is_stopped():
            raise KeyboardInterrupt
        with _mixing_types():
            state = _begin(density, start, energy, gradient, jax.random.PRNGKey(seed), settings)
            state, found = _move(density, state, settings, length)
        _compiled.add(key)
    for at in range(total // length):
        if at:
            with _mixing_types():
                state, found = _move(density, state, settings, length)
        # This waits for the results. Otherwise Ctrl-C would be handled only after all calls.
        parts.append([np.asarray(each) for each in found])
        if is_stopped():
            raise KeyboardInterrupt
        if (listener := _listener.get()) is not None:
            listener(length)
    whole = [np.concatenate(each) for each in zip(*parts, strict=True)]
    names = "values", "energy", "diverging", "steps", "acceptance"
    return {
        **{name: each[warmup:] for name, each in zip(names, whole, strict=True)},
        "step_size": float(state.adapt_state.step_size),
        "warmup_diverging": int(np.sum(whole[2][:warmup])),
    }


@contextlib.contextmanager
def _mixing_types() -> Iterator[None]:
    """Allow NumPyro to combine different types and ranks, which the session may forbid."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@program
def _begin(
    density: Density, start: Any, energy: Any, gradient: Any, key: Any, settings: tuple[int, bool]
) -> Any:
    return _kernels(density, start, energy, gradient, key, settings)[0]


@program
def _move(density: Density, state: Any, settings: tuple[int, bool], length: int) -> Any:
    """Perform the given number of transitions; return the final state and the stored quantities."""
    _, sample = _kernels(
        density, state.z, state.potential_energy, state.z_grad, state.rng_key, settings
    )

    def next_one(state: Any, _: None) -> tuple[Any, tuple[Any, ...]]:
        state = sample(state)
        slope = density.bounds.forward(density.centre + density.spread @ state.z)[1]
        # The energy refers to the density of the parameters rather than of the sampler's
        # coordinates.
        energy = state.potential_energy + jnp.sum(slope)
        known = energy, state.diverging, state.num_steps, state.accept_prob
        return state, (density.values(state.z), *known)

    return jax.lax.scan(next_one, state, None, length=length)


def _kernels(
    density: Density, z: Any, energy: Any, gradient: Any, key: Any, settings: tuple[int, bool]
) -> tuple[Any, Callable[[Any], Any]]:
    """Return NumPyro's state at a point and its transition function."""
    from numpyro.infer.hmc import hmc
    from numpyro.infer.util import ParamInfo

    warmup, adapts = settings
    begin, sample = hmc(density.potential(), algo="NUTS")
    # `sample` uses the settings of the preceding call of `begin`.
    state = begin(
        ParamInfo(z, energy, gradient),
        warmup,
        adapt_mass_matrix=adapts,
        dense_mass=True,
        rng_key=key,
    )
    return state, sample


# The initial points are more widely spread than the posterior, so that R-hat shows whether the
# chains have converged to the same distribution.
_APART = 1.5
_ATTEMPTS = 12


def posterior(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    chains: int = 4,
    draws: int = 500,
    warmup: int = 200,
    seed: int = 0,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Posterior:
    """Sample the posterior of the free parameters of a fit with the No-U-Turn sampler.

    The density is exp(-cost), where the noise is fixed at its fitted value. Parameters without a
    prior have a uniform prior within their bounds. The cost of the measured values is divided by
    one factor such that, for a normal density, the standard deviations equal the reported standard
    errors. A robust loss is interpreted as a density up to a constant. Parameters to which no
    channel responds are fixed at their fitted values.

    Arguments:
        result, runs: fit result and the fitted runs, in the same order.
        chains: number of chains, each of which is a task; after Ctrl-C the completed chains are
            used.
        draws: number of draws of each chain that are kept.
        warmup: number of preceding transitions, which adapt the sampler.
        seed: seed of the random numbers.
        executor, folder: as for `giajax.runtime.execution.Execution`; without an executor, or with
            `InProcess`, the chains run in threads on the cores of this process.
        progress: function that is called with the number of completed transitions and their total
            number, from the threads of the chains.

    Raises:
        InputError: the runs do not match the result; NumPyro is not installed; a parameter is
            not limited by data, prior or bounds; a number is invalid; two runs have the same name,
            so labels of parameters are ambiguous; or all chains failed.
        KeyboardInterrupt: Ctrl-C was pressed before any chain was completed.

    Example:
        >>> result = giajax.load_result("giajax-out/run")  # doctest: +SKIP
        >>> print(giajax.posterior(result, [run]).summary.parameters)  # doctest: +SKIP
    """
    check_posterior(chains=chains, draws=draws, warmup=warmup)
    fitted = Fitted.of(result, runs)
    optimum = fitted.optimum()
    doubled = [label for label in optimum.labels if optimum.labels.count(label) > 1]
    if doubled:
        raise InputError(
            f"two runs have the same name, so their values of {doubled[0]} would be ambiguous: "
            "rename one of the runs"
        )
    density = density_of(optimum)
    if not density.places:
        raise InputError(
            "no channel responds to the free parameters of this fit, so no posterior can be "
            "sampled: free other parameters"
        )
    begun = [_begun(density, fitted, number, seed) for number in range(chains)]
    tasks = [
        Task(chain, {"begun": one, "number": at, "draws": draws, "warmup": warmup}, seed=seed)
        for at, one in enumerate(begun)
    ]
    counted = _Progress(progress, chains, draws + warmup)
    token = _listener.set(counted.moved)
    try:
        with contextlib.ExitStack() as stack:
            if executor is None or type(executor) is InProcess:
                executor = stack.enter_context(Threads(chains))
            outcomes = run_tasks(tasks, executor=executor, folder=folder, progress=counted.done)
    finally:
        _listener.reset(token)
    found = [outcome.value for outcome in outcomes if outcome.status == "done"]
    failed = [outcome.message for outcome in outcomes if outcome.status == "failed"]
    if not found:
        raise InputError(f"no chain could be sampled: {failed[0]}") if failed else KeyboardInterrupt
    whole = np.stack([np.asarray(one["values"], dtype=float) for one in found])
    each = bands(result, fitted.runs, optimum, whole.reshape(-1, whole.shape[-1]))
    samples = whole[..., np.asarray(density.places)]
    parts: dict[str, Any] = {
        name: np.stack([np.asarray(one[name]) for one in found])
        for name in ("energy", "diverging", "steps", "acceptance")
    }
    marginals = {
        optimum.labels[place]: marginal(result, optimum, place, samples[..., column])
        for column, place in enumerate(density.places)
    }
    divergences = int(np.sum(parts["diverging"]))
    summary = PosteriorSummary(
        parameters=marginals,
        chains=samples.shape[0],
        draws=samples.shape[1],
        warmup=warmup,
        asked=chains,
        seed=seed,
        divergences=divergences,
        scale=float(density.scale),
        cost=result.cost,
        held=tuple(label for label in optimum.labels if label not in marginals),
        within={
            run: {name: band.within for name, band in by_channel.items()}
            for run, by_channel in zip(unique_names(fitted.runs), each, strict=True)
        },
        warnings=tuple(doubts(marginals, divergences, samples, failed, chains)),
    )
    return Posterior(summary=summary, samples=samples, bands=each, **parts)


def check_posterior(*, chains: int = 1, draws: int = 8, warmup: int = 0) -> None:
    """Reject invalid settings before any computation."""
    if importlib.util.find_spec("numpyro") is None:
        raise InputError(
            "sampling a posterior requires NumPyro, which is not installed: "
            f"{install_command('posterior')}"
        )
    for what, number, least in (("chains", chains, 1), ("draws", draws, 8), ("warmup", warmup, 0)):
        if number < least:
            raise InputError(f"{what} is {number}, but must be at least {least}")


class _Progress:
    """Count of the transitions completed by chains of this process and of others."""

    def __init__(self, progress: Callable[[int, int], None] | None, chains: int, each: int) -> None:
        self._progress, self._each, self._total = progress, each, chains * each
        self._done = self._running = 0
        self._lock = threading.Lock()

    def moved(self, transitions: int) -> None:
        with self._lock:
            self._running += transitions
            self._tell()

    def done(self, outcome: Outcome, done: int, total: int) -> None:
        with self._lock:
            self._done = done * self._each
            self._running = max(0, self._running - self._each)  # 0 for other processes
            self._tell()

    def _tell(self) -> None:
        if self._progress is not None:
            self._progress(self._done + self._running, self._total)


def _begun(density: Density, fitted: Fitted, number: int, seed: int) -> Begun:
    """Return the initial state of a chain, as near as necessary to the optimum to be evaluable."""
    optimum = fitted.optimum()
    z = np.random.default_rng([seed, number]).normal(size=len(density.places)) * _APART
    for _ in range(_ATTEMPTS):
        energy, gradient = energy_at(density, optimum, z)
        if np.isfinite(energy):
            break
        z = z / 2
    return Begun(density, z, energy, gradient, fitted.task_key)
