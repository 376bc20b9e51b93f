"""What a fit is asked: checked and resolved before anything is evaluated."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Self, Unpack

import jax.numpy as jnp
import numpy as np

from ..models import AbstractModel, capabilities
from ..recordings import FitSettings, Run, StartsKeywords, fit_settings, run_keys
from ..runtime.text import InputError
from ..schema import Prior
from ..schema.parameters import Parameter, get, replace
from ._coordinates import Layout, sharing
from ._free import Free, Tie, WarmStart, between, resolve, tied
from ._weights import prior_of


@dataclasses.dataclass(frozen=True)
class Setup:
    """What a fit is asked, resolved once: `set_up` makes it, `solve` fits it.

    Attributes:
        model: with the start values and what is fixed.
        runs: what is fitted to.
        settings: as they were given.
        parameters: the scalar parameters to fit, apart from those of single runs; each declares
            the bounds of this fit.
        unstarted: paths of those that have no start of the caller's.
        own: where the parameters of single runs start, by the run's name and their path, where
            that is not as the run is prepared.
        config: the same as plain data, `config` of the result: two fits of the same data with
            the same one have the same result.
        priors: what is known of parameters before, by the path of an element.
        ties: parameters that follow from others, in their order.
        groups: by path of an element, the runs (by position) that share a value of it; what is
            not in it, all runs share.
        reopened: whether the tolerance that the model has is one that another fit chose.
        suited: the tolerance that suited another fit of the same data, for one that chooses its
            own: it begins there, and looks at the end alone whether it suits.
    """

    model: AbstractModel
    runs: tuple[Run, ...]
    settings: FitSettings
    parameters: tuple[Parameter, ...]
    unstarted: tuple[str, ...]
    config: dict[str, Any]
    own: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)
    priors: Mapping[str, Prior] = dataclasses.field(default_factory=dict)
    ties: tuple[Tie, ...] = ()
    groups: Mapping[str, tuple[tuple[int, ...], ...]] = dataclasses.field(default_factory=dict)
    reopened: bool = False
    suited: float | None = None

    @property
    def layout(self) -> Layout:
        """Where the values of the parameters stand in the free coordinate."""
        return Layout.of([p.path for p in self.parameters], self.groups, len(self.runs))

    def starts(self) -> list[float]:
        """Start values of the parameters, where they stand in the free coordinate."""
        starts = [0.0] * self.layout.size
        for column, parameter in enumerate(self.parameters):
            value, path = float(parameter.value(self.model)), parameter.path
            bounds = parameter.declaration.lower, parameter.declaration.upper
            for run, places in zip(self.runs, self.layout.of_runs, strict=True):
                # Where another fit had a value for each group of runs, each begins at its own.
                known = self.own.get(run.name, {}) if path in self.groups else {}
                starts[places[column]] = between(known[path], *bounds) if path in known else value
        return starts

    @property
    def chooses_tolerance(self) -> bool:
        """Whether the fit chooses the tolerance of an integrator, where nobody states it."""
        integration = capabilities.integration(self.model)
        # 32-bit rounding hides what a finer tolerance changes.
        if integration is None or jnp.result_type(float) == jnp.float32:
            return False
        return self.reopened or integration.tolerance is None

    def at_start(self) -> Self:
        """With the model where the fit may start (`giajax.models.capabilities.at_start`)."""
        model = tied(capabilities.at_start(self.model, self.runs, self.unstarted), self.ties)
        return dataclasses.replace(self, model=model, unstarted=())

    def started_at(self, values: Mapping[str, float]) -> Self:
        """With other start values of the parameters to fit, by path."""
        model = tied(replace(self.model, values), self.ties)
        return dataclasses.replace(self, model=model, unstarted=())


def set_up(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    settings: FitSettings | None = None,
    *,
    begin: WarmStart | None = None,
    **keywords: Unpack[StartsKeywords],
) -> Setup:
    """Check and resolve what a fit is asked, without evaluating the model, for `solve`.

    Arguments:
        model, runs: as of `fit`.
        settings: of the fit; what is for a task (`hold_out`, say) does nothing here.
        begin: where another fit ended, which goes before `start`; `fix` goes before both.
        **keywords: as of `fit` and `multi_start`, in place of `settings`.

    Raises:
        InputError: as `fit`, apart from a start that cannot be evaluated.
    """
    settings = fit_settings(keywords, settings=settings)
    runs = (runs,) if isinstance(runs, Run) else tuple(runs)
    if not runs:
        raise InputError("there is no run: give at least one")
    for run in runs:
        run.require_observations()
    _check_doubles(runs)
    if settings.solver is not None or settings.tolerance is not None:
        model = capabilities.with_integration(
            model, solver=settings.solver, tolerance=settings.tolerance
        )
    groups = sharing(runs, settings.per_run, settings.groups)
    reached = {} if begin is None else begin.values_for(model)
    asked = resolve(model, runs, settings, groups, reached)
    _check_determined(asked, runs)
    _check_together(asked, runs)
    return Setup(
        model=asked.model,
        runs=runs,
        settings=settings,
        parameters=asked.parameters,
        unstarted=tuple(p.path for p in asked.parameters if p.path not in asked.begun),
        config=_config(settings, asked, runs, groups, begin),
        own={} if begin is None else begin.own,
        priors=asked.priors,
        ties=asked.ties,
        groups=asked.groups,
    )


def _config(
    settings: FitSettings,
    asked: Free,
    runs: Sequence[Run],
    groups: Mapping[str, Sequence[Sequence[str]]],
    begin: WarmStart | None,
) -> dict[str, Any]:
    """The settings as they were resolved, as plain data: `config` of the result."""
    integration = capabilities.integration(asked.model)
    limits = {
        "priors": {path: prior.contents() for path, prior in settings.known.items()},
        "bounds": settings.bounds,
        "ties": settings.ties,
        "groups": groups,
        "begin": None if begin is None else dataclasses.asdict(begin),
    }
    return {
        "definition": asked.model.definition(),
        "runs": [_about(run, asked.model) for run in runs],
        "free": [parameter.path for parameter in asked.parameters],
        "start": _plain(settings.start),
        "fix": _plain(settings.fix),
        "loss": settings.loss,
        "noise_model": settings.noise_model,
        "noise_per_run": settings.noise_per_run,
        # None for a model without an integrator.
        "solver": None if integration is None else integration.solver,
        "tolerance": None if integration is None else integration.tolerance,
        # What a fit does not have, its configuration does not mention.
        **{name: value for name, value in limits.items() if value},
    }


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by path as a result states them: numbers, and lists of several."""
    return {
        path: value[0] if isinstance(value, list) and len(value) == 1 else value
        for path, value in values.items()
    }


def _about(run: Run, model: AbstractModel) -> dict[str, Any]:
    """What of a run a fit depends on, beside its data and the constants of the model."""
    sidecar = run.definition.contents()
    about: dict[str, Any] = {key: sidecar[key] for key in run_keys(model=False) if key in sidecar}
    if run.model != model.kind:
        about["model"] = run.model
    if run.observed is not None:
        about["channels"] = list(run.observed)
    if run.times is not None:
        about |= {"from_s": float(run.times[0]), "rows": len(run.times)}
    return about


def _check_determined(asked: Free, runs: Sequence[Run]) -> None:
    """Refuse a fit of nothing, and one of more parameters than there are values and priors."""
    paths = [p.path for p in asked.parameters for _ in asked.groups.get(p.path, [runs])]
    for run in runs:
        inputs = asked.model.prepare(run)
        for path in capabilities.free_inputs(asked.model, run):
            size = get(inputs, path).size
            paths += [f"{path}[{index}]" for index in range(size)] if size > 1 else [path]
    if not paths:
        raise InputError("no parameter is free: free at least one")
    measured = sum(int(np.sum(~np.isnan(v))) for run in runs for v in run.observations.values())
    # A prior is a row of the residual for each value that it is of.
    known = sum(prior_of(asked.priors, path) is not None for path in paths)
    if measured + known <= len(paths):
        raise InputError(
            f"{measured} measured values cannot determine {len(paths)} parameters and their "
            "standard errors: free fewer parameters or give a longer run"
        )


def _check_together(asked: Free, runs: Sequence[Run]) -> None:
    """Refuse a fit of runs of several kinds that have nothing in common: a mistake, or two fits."""
    kinds = dict.fromkeys(run.model for run in runs)
    if len(kinds) < 2:
        return
    if asked.groups:
        path = next(iter(asked.groups))
        raise InputError(
            f"'{path}' has values for single runs, and the runs are of several models: leave them "
            "out, or fit the runs of one model"
        )
    joins = [
        tie
        for tie in asked.ties
        if any(p.partition("[")[0] != tie.path.partition("[")[0] for p in tie.expression.paths)
    ]
    if not joins and not any(p.is_shared for p in asked.parameters):
        raise InputError(
            f"no parameter that is free belongs to more than one of the models of these runs, "
            f"{' and '.join(kinds)}: free or tie one that does, or fit them separately"
        )


def _check_doubles(runs: Sequence[Run]) -> None:
    """Refuse a recording that is there twice: standard errors would shrink for nothing."""
    seen: dict[tuple[str, float], str] = {}
    for run in runs:
        if run.sha256 is None:
            continue
        # Windows of one recording are several runs.
        part = (run.sha256, 0.0 if run.times is None else float(run.times[0]))
        if part in seen:
            raise InputError(
                f"'{seen[part]}' and '{run.path}' are the same recording: give it once"
            )
        seen[part] = str(run.path)
