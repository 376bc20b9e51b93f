"""Fit a model to runs: a host loop around one jitted trust-region step."""

import time
import warnings
from collections.abc import Callable, Mapping, Sequence

import jax
import numpy as np

from ..models import AbstractModel
from ..runs import Run
from ._bijector import Bijector
from ._configuration import configuration, set_up
from ._descend import Descent, Iteration
from ._fitter import Fitter
from ._noise import from_differences
from ._problem import Problem, Sigmas, build_groups, own_start, stated_sigmas
from ._report import Outcome, report
from ._result import FitResult

MAX_ITERATIONS = 50


def fit(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    *,
    free: Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
    fix: Mapping[str, float] | None = None,
    loss: str = "linear",
    max_iterations: int = MAX_ITERATIONS,
    progress: Callable[[Iteration], None] | None = None,
    check: bool = True,
) -> FitResult:
    """Fit parameters of a model to recorded runs by weighted least squares.

    Each recorded cell counts with the noise that the run states for its channel; where it states
    none, the noise is estimated per channel from the residuals. Empty cells do not count.

    Arguments:
        model: the model with its constants; its values are where the fit starts.
        runs: one run or several, fitted together.
        free: paths of the parameters to fit (`links.mass[2]` for one element of an array); by
            default those that the model declares free.
        start: start values by path, in SI units.
        fix: values by path that are set and not fitted.
        loss: "linear", or "huber" or "soft_l1" where a few cells are outliers.
        max_iterations: trial steps before the fit gives up.
        progress: called after each step with an `Iteration`.
        check: compute the gradient check and the effect of the solver tolerance at the end.

    Returns:
        The result; `result.status` says whether it converged. Ctrl-C ends the fit and returns
        the best point so far.

    Raises:
        InputError: an unknown path, a start outside its bounds, a run without measured channels,
            or a start from which the model cannot be evaluated.

    Example:
        >>> import giajax
        >>> run = giajax.read_run("data/synthetic/base_step.csv")  # doctest: +SKIP
        >>> result = giajax.fit(giajax.model_for([run]), run)  # doctest: +SKIP
        >>> result.parameters["air.drag_coefficient"].value  # doctest: +SKIP
    """
    _warn_once_in_32_bit()
    runs = [runs] if isinstance(runs, Run) else list(runs)
    start, fix = dict(start or {}), dict(fix or {})
    config = configuration(model, runs, free=free, start=start, fix=fix, loss=loss)
    model, parameters = set_up(model, runs, free, start, fix)
    stated = stated_sigmas(runs)
    sigmas: Sigmas = [
        {
            name: sigma if sigma is not None else from_differences(run.observations[name])
            for name, sigma in noise.items()
        }
        for run, noise in zip(runs, stated, strict=True)
    ]
    groups = build_groups(model, runs, sigmas, len(parameters))
    own = own_start(groups)
    bijector = Bijector(
        (*(p.declaration.lower for p in parameters), *(-np.inf for _ in own)),
        (*(p.declaration.upper for p in parameters), *(np.inf for _ in own)),
    )
    problem = Problem(
        model=model,
        groups=groups,
        bijector=bijector,
        paths=tuple(p.path for p in parameters),
        loss=loss,
    )
    values = np.asarray([*(float(p.value(model)) for p in parameters), *own])
    # A parameter whose start and default are zero has no size of its own: one unit.
    defaults = np.asarray([*(p.declaration.default for p in parameters), *(0.0 for _ in own)])
    sizes = np.maximum(np.abs(values), np.abs(defaults))
    fitter = Fitter(problem, values, np.where(sizes > 0, sizes, 1.0))
    unstated = any(sigma is None for noise in stated for sigma in noise.values())
    began = time.perf_counter()
    descent = Descent(fitter, runs, stated, sigmas, progress)
    status, message = descent.run(max_iterations)
    outcome = Outcome(
        status=status,
        message=message,
        parameters=parameters,
        sigmas=sigmas,
        noise_estimated=descent.noise_estimated,
        noise_guessed=unstated and not descent.noise_estimated,
        history=descent.history,
        began=began,
        config={**config, "max_iterations": max_iterations},
    )
    return report(fitter, runs, outcome, check=check and status != "interrupted")


_warned = False


def _warn_once_in_32_bit() -> None:
    global _warned
    if _warned or jax.config.read("jax_enable_x64"):
        return
    _warned = True
    warnings.warn(
        "giajax is fitting in 32-bit, where a long chain keeps about three digits; call "
        'jax.config.update("jax_enable_x64", True) before anything else',
        stacklevel=3,
    )
