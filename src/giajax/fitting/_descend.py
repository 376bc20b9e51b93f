"""The host loop of a fit: step until the optimum, and estimate the noise that was not stated."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ..runs import Run
from ._fitter import Fitter
from ._identifiability import responds
from ._noise import from_residuals
from ._problem import Sigmas, build_groups, predictions_by_run
from ._result import Status

# Estimating the noise and fitting with it alternate until the noise changes by less than this.
_NOISE_CHANGE = 0.05
_NOISE_ROUNDS = 4

# How often parameters may be moved off their bounds before the bound is believed.
_RELEASES = 3


@dataclasses.dataclass(frozen=True)
class Iteration:
    """What `progress` is told after each trial step.

    Attributes:
        number: 0 for the evaluation of the start.
        cost: half the sum of the loss, at the best point so far.
        step: largest change of a free coordinate that was tried: relative for a positive
            parameter, in its own unit for one without bounds.
        accepted: whether the trial point became the best one.
        parameters: values of the free parameters at the best point, by path.
    """

    number: int
    cost: float
    step: float
    accepted: bool
    parameters: dict[str, float]


class Descent:
    """The loop, with what it tells and remembers.

    Arguments:
        fitter: where the fit stands.
        runs: the recorded runs.
        stated: the noise that each run states by channel, None where it states none.
        sigmas: the noise in use, SI; updated in place.
        progress: told after each trial step.
    """

    def __init__(
        self,
        fitter: Fitter,
        runs: Sequence[Run],
        stated: Sequence[Mapping[str, float | None]],
        sigmas: Sigmas,
        progress: Callable[[Iteration], None] | None,
    ) -> None:
        """Begin; nothing is evaluated yet."""
        self.fitter = fitter
        self.runs = runs
        self.stated = stated
        self.sigmas = sigmas
        self.progress = progress
        self.trials = 0
        self.noise_estimated = False
        self.history: list[dict[str, Any]] = []

    def run(self, max_iterations: int) -> tuple[Status, str]:
        """Step until converged; returns how it ended.

        Raises:
            InputError: the model cannot be evaluated at the start.
            KeyboardInterrupt: before anything was evaluated; later the best point is kept.
        """
        fitter = self.fitter
        try:
            fitter.step()
            if not fitter.evaluated:
                raise InputError(
                    "the model cannot be evaluated at the start values (the simulation fails); "
                    "choose others, for an arm softer or less damped joints, or a shorter run"
                )
            norms = fitter.natural_jacobian().norms()
            fitter.active = jnp.asarray(responds(norms, fitter.sizes))
            self._tell(accepted=True)
            if not bool(jnp.any(fitter.active)):
                return "not_converged", "no channel responds to any of the free parameters"
            for rounds_left in reversed(range(_NOISE_ROUNDS)):
                ended = self._to_optimum(max_iterations)
                if ended is not None:
                    return ended
                # The last word is always an optimum with the noise that it was found with.
                if rounds_left == 0 or not self._update_noise():
                    break
                shared = len(fitter.problem.paths)
                groups = build_groups(fitter.problem.model, self.runs, self.sigmas, shared)
                fitter.problem = dataclasses.replace(fitter.problem, groups=groups)
                fitter.move_to(fitter.coordinate)
                fitter.step()
                fitter.best = None  # its cost was counted with another noise
        except KeyboardInterrupt:
            fitter.back_to_best()
            if not fitter.evaluated:
                raise
            return "interrupted", (
                f"interrupted after {self.trials} iterations; this is the best so far"
            )
        return "converged", f"converged in {self.trials} iterations"

    def _to_optimum(self, max_iterations: int) -> tuple[Status, str] | None:
        """Step until the solver is done at an optimum; else say how it ended."""
        fitter = self.fitter
        releases = 0
        while True:
            done = False
            while not done:
                if self.trials >= max_iterations:
                    return "not_converged", (
                        f"no optimum after {self.trials} iterations; start nearer, free fewer "
                        "parameters or allow more iterations"
                    )
                done = fitter.step()
                self.trials += 1
                self._tell(accepted=bool(fitter.state.accepted))
            if releases == _RELEASES or not fitter.release():
                break
            releases += 1
            fitter.step()
            self.trials += 1
            worse = fitter.back_to_best()
            self._tell(accepted=not worse)
            if worse:
                break
        if fitter.converged:
            return None
        return "not_converged", (
            "no step lowers the cost any further, and the optimum is not reached; "
            "start elsewhere or free fewer parameters"
        )

    def _tell(self, *, accepted: bool) -> None:
        fitter = self.fitter
        iteration = Iteration(
            number=self.trials,
            cost=float(fitter.state.cost),
            step=float(np.max(np.abs(np.asarray(fitter.state.step)), initial=0.0)),
            accepted=accepted,
            parameters=fitter.parameters(),
        )
        self.history.append(dataclasses.asdict(iteration))
        if self.progress is not None:
            self.progress(iteration)

    def _update_noise(self) -> bool:
        """Re-estimate what was not stated, where that changes it; whether it did."""
        predictions = predictions_by_run(self.fitter.problem, self.fitter.state.aux, self.runs)
        channels = sum(len(noise) for noise in self.stated)
        taken = float(np.sum(np.asarray(self.fitter.active))) / channels
        robust = self.fitter.problem.loss != "linear"
        self.noise_estimated = any(s is None for noise in self.stated for s in noise.values())
        found: Sigmas = [{} for _ in self.runs]
        change = 0.0
        for row, (run, noise, sigma, predicted) in enumerate(
            zip(self.runs, self.stated, self.sigmas, predictions, strict=True)
        ):
            for name, known in noise.items():
                if known is not None:
                    continue
                difference = predicted[name] - run.observations[name]
                new = from_residuals(difference[~np.isnan(difference)], taken, robust=robust)
                change = max(change, abs(float(np.log(new / sigma[name]))))
                found[row][name] = new
        if change < _NOISE_CHANGE:
            return False
        for sigma, new_ones in zip(self.sigmas, found, strict=True):
            sigma.update(new_ones)
        return True
