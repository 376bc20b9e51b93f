"""What is known of the free parameters of a fit beyond its optimum: draws from their posterior."""

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

# Transitions of a call of the program: between calls Ctrl-C is noticed, and progress reported.
_AT_ONCE = 20

# Transitions of the warm-up below which the matrix of the optimum stays: Stan's windows, and some
# draws for each parameter, are needed to estimate a better one.
_LEAST_TO_ADAPT, _EACH = 150, 10

_compiling = threading.Lock()
_compiled: set[tuple[Any, ...]] = set()  # keys of chains whose programs are there

# Called with the transitions that chains of this process do, after each few.
_listener: contextvars.ContextVar[Callable[[int], None] | None] = contextvars.ContextVar(
    "_listener", default=None
)


@dataclasses.dataclass(frozen=True)
class Begun:
    """Where a chain begins, in the sampler's coordinate, shape (drawn,).

    What the density is there spares a second program. The key is that of the fit that all of it
    follows from, by which a task is known.
    """

    density: Density
    start: np.ndarray
    energy: float
    gradient: np.ndarray
    task_key: str


def chain(begun: Begun, number: int, draws: int, warmup: int, seed: int) -> dict[str, Any]:
    """A task: draws from a density. Chains of a study differ in their number, and so in their seed.

    Returns:
        `values` of all free parameters, shape (draw, parameter), SI; `energy` (minus the logarithm
        of the density of the parameters, up to a constant), `diverging`, `steps` and `acceptance`
        of each draw; the `step_size`; and `warmup_diverging`, how many transitions of the warm-up
        diverged.
    """
    total = warmup + draws
    length = next(n for n in range(min(_AT_ONCE, total), 0, -1) if total % n == 0)
    settings = warmup, warmup >= max(_LEAST_TO_ADAPT, _EACH * len(begun.start))
    density, dtype = begun.density, begun.density.centre.dtype
    start, energy, gradient = (
        on_device(each, dtype) for each in (begun.start, begun.energy, begun.gradient)
    )
    import numpyro.infer.hmc  # noqa: F401  # a program that was kept returns a class of it

    parts = []
    key = (begun.task_key, settings, length)
    with contextlib.ExitStack() as stack:
        # Chains that begin together need the same programs, and each would compile them.
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
        # Waits for the numbers; until then Ctrl-C would wait for all calls.
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
    """NumPyro adds numbers of different types and shapes, which a session may forbid."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@program
def _begin(
    density: Density, start: Any, energy: Any, gradient: Any, key: Any, settings: tuple[int, bool]
) -> Any:
    return _kernels(density, start, energy, gradient, key, settings)[0]


@program
def _move(density: Density, state: Any, settings: tuple[int, bool], length: int) -> Any:
    """So many transitions; the state after them, and what of each is kept."""
    _, sample = _kernels(
        density, state.z, state.potential_energy, state.z_grad, state.rng_key, settings
    )

    def next_one(state: Any, _: None) -> tuple[Any, tuple[Any, ...]]:
        state = sample(state)
        slope = density.bounds.forward(density.centre + density.spread @ state.z)[1]
        # Of the parameters, not of the coordinate.
        energy = state.potential_energy + jnp.sum(slope)
        known = energy, state.diverging, state.num_steps, state.accept_prob
        return state, (density.values(state.z), *known)

    return jax.lax.scan(next_one, state, None, length=length)


def _kernels(
    density: Density, z: Any, energy: Any, gradient: Any, key: Any, settings: tuple[int, bool]
) -> tuple[Any, Callable[[Any], Any]]:
    """NumPyro's state at a point, and its transition."""
    from numpyro.infer.hmc import hmc
    from numpyro.infer.util import ParamInfo

    warmup, adapts = settings
    begin, sample = hmc(density.potential(), algo="NUTS")
    # The second function knows the settings when the first one was called.
    state = begin(
        ParamInfo(z, energy, gradient),
        warmup,
        adapt_mass_matrix=adapts,
        dense_mass=True,
        rng_key=key,
    )
    return state, sample


# Chains that begin farther apart than the posterior is wide show whether they find together.
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
    """Draw from the posterior of the free parameters of a fit, by the No-U-Turn sampler.

    Its density is exp(-cost) with the noise held as it was fitted, and flat in the parameters
    themselves within their bounds where they have no prior. The cost of the measured values is
    divided by one number, so that where the density is normal its deviations are the reported
    standard errors; a robust loss is taken for a density up to a constant. What no channel responds
    to stays where the fit left it.

    Arguments:
        result, runs: of a fit, and what it was fitted to, in their order.
        chains: how many, each a task of its own; after Ctrl-C, those count that were done.
        draws: of each chain that are kept.
        warmup: transitions before them, which adapt the sampler.
        seed: of the random numbers.
        executor, folder: as of `giajax.runtime.execution.Execution`; without an executor, or with
            that of this process, the chains are shared out among its cores.
        progress: called with the transitions that are done, and how many there will be; in the
            threads of the chains.

    Raises:
        InputError: these are not its runs; NumPyro is not installed; nothing limits a parameter;
            a number that cannot be; parameters of two runs of one name; every chain failed.
        KeyboardInterrupt: no chain was done when Ctrl-C came.

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
    """Refuse what cannot be drawn, before anything is computed."""
    if importlib.util.find_spec("numpyro") is None:
        raise InputError(
            "sampling a posterior requires NumPyro, which is not installed: "
            f"{install_command('posterior')}"
        )
    for what, number, least in (("chains", chains, 1), ("draws", draws, 8), ("warmup", warmup, 0)):
        if number < least:
            raise InputError(f"{what} is {number}, but must be at least {least}")


class _Progress:
    """Adds up the transitions that chains of this process and of others have done."""

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
            self._running = max(0, self._running - self._each)  # none of another process
            self._tell()

    def _tell(self) -> None:
        if self._progress is not None:
            self._progress(self._done + self._running, self._total)


def _begun(density: Density, fitted: Fitted, number: int, seed: int) -> Begun:
    """The start of a chain, at which the model can be evaluated if it can be anywhere near."""
    optimum = fitted.optimum()
    z = np.random.default_rng([seed, number]).normal(size=len(density.places)) * _APART
    for _ in range(_ATTEMPTS):
        energy, gradient = energy_at(density, optimum, z)
        if np.isfinite(energy):
            break
        z = z / 2
    return Begun(density, z, energy, gradient, fitted.task_key)
