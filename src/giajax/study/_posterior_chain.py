"""One chain of a posterior: NumPyro's No-U-Turn sampler over the density of a fit."""

import contextlib
import contextvars
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._maths import on_device
from .._program import program
from .._signals import is_stopped
from ..fitting import Density

# Transitions of a call of the program: between calls Ctrl-C is heard, and progress told.
_AT_ONCE = 20

# Transitions of the warm-up below which the matrix of the optimum stays: Stan's windows, and some
# draws for each parameter, are needed to estimate a better one.
_LEAST_TO_ADAPT, _EACH = 150, 10

_listener: contextvars.ContextVar[Callable[[int], None] | None] = contextvars.ContextVar(
    "_listener", default=None
)


@contextlib.contextmanager
def heard_by(listener: Callable[[int], None] | None) -> Iterator[None]:
    """Tell a function of the transitions that chains of this process have done since the last."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@dataclasses.dataclass(frozen=True)
class Begun:
    """Where a chain begins.

    Attributes:
        density: of the fit.
        start: in the sampler's coordinate, shape (drawn,).
        energy, gradient: what the density is there, which spares a second program.
        task_key: of the fit that all of it follows from, by which a task is known.
    """

    density: Density
    start: np.ndarray
    energy: float
    gradient: np.ndarray
    task_key: str


def chain(begun: Begun, number: int, draws: int, warmup: int, seed: int) -> dict[str, Any]:
    """Draw from a density, as a task of `giajax.execution`.

    Arguments:
        begun: where.
        number: of the chain; those of a study differ in it, and so in their seeds.
        draws, warmup: how many transitions are kept, and how many adapt the sampler before.
        seed: of the random numbers.

    Returns:
        `values` of all free parameters, shape (draw, parameter), SI; `energy` (minus the logarithm
        of the density of the parameters, up to a constant), `diverging`, `steps` and `acceptance`
        of each draw; the `step_size`; and `warmup_diverging`, how many transitions of the warm-up
        diverged.
    """
    total = warmup + draws
    length = next(n for n in range(min(_AT_ONCE, total), 0, -1) if total % n == 0)
    settings = warmup, _adapts(warmup, len(begun.start))
    density, dtype = begun.density, begun.density.centre.dtype
    state = _begun(
        density,
        on_device(begun.start, dtype),
        on_device(begun.energy, dtype),
        on_device(begun.gradient, dtype),
        jax.random.key(seed),
        settings,
    )
    parts = []
    for _ in range(total // length):
        state, found = _moved(density, state, settings, length)
        # Waits for the numbers; until then Ctrl-C would wait for all calls.
        parts.append([np.asarray(each) for each in found])
        if is_stopped():
            raise KeyboardInterrupt
        if (listener := _listener.get()) is not None:
            listener(length)
    values, energies, diverging, steps, acceptance = (
        np.concatenate(each) for each in zip(*parts, strict=True)
    )
    return {
        "values": values[warmup:],
        "energy": energies[warmup:],
        "diverging": diverging[warmup:],
        "steps": steps[warmup:],
        "acceptance": acceptance[warmup:],
        "step_size": float(state.adapt_state.step_size),
        "warmup_diverging": int(np.sum(diverging[:warmup])),
    }


def _adapts(warmup: int, size: int) -> bool:
    return warmup >= max(_LEAST_TO_ADAPT, _EACH * size)


@contextlib.contextmanager
def _mixing_types() -> Iterator[None]:
    """NumPyro adds numbers of different types and shapes, which a session may forbid."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


def _begun(*arguments: Any) -> Any:
    with _mixing_types():
        return _begin(*arguments)


def _moved(*arguments: Any) -> Any:
    with _mixing_types():
        return _move(*arguments)


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
