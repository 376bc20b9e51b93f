"""Configuration of a fit: free and tied parameters, checked before the model is evaluated."""

import dataclasses
import functools
import graphlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Self, TypeVar, Unpack

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..models import AbstractModel, capabilities
from ..recordings import FitSettings, Run, StartsKeywords, fit_settings, run_keys
from ..runtime.arrays import Array, Bool
from ..runtime.text import InputError
from ..schema import Expression, Prior
from ..schema.parameters import (
    Parameter,
    check_count,
    check_within_bounds,
    declared,
    default_free,
    elements,
    find,
    get,
    replace,
    switched_on,
)
from ._coordinates import Layout, members, sharing
from ._losses import AbstractLoss, check_loss, loss_of
from ._nuisances import with_nuisances, with_scattering
from ._weights import prior_of

Module = TypeVar("Module", bound=eqx.Module)

_FUNCTIONS = {"sqrt": jnp.sqrt, "exp": jnp.exp, "log": jnp.log}


@dataclasses.dataclass(frozen=True)
class Tie:
    """Parameter that is computed from other parameters.

    Attributes:
        path: path of the parameter, which may be an array.
        expression: expression that gives the value of the parameter.
        elements: paths of the elements that are tied. Elements that the expression itself names are
            not tied, as in `links.mass = links.mass[0]`.
        lower, upper: bounds of the parameter.
    """

    path: str
    expression: Expression
    elements: tuple[str, ...]
    lower: float
    upper: float

    @classmethod
    def of(cls, model: eqx.Module, path: str, text: str) -> Self:
        """Return the tie of a path to an expression.

        Raises:
            InputError: the expression is invalid, or it contains an unknown path.
        """
        try:
            expression = Expression.parse(text)
        except InputError as error:
            raise InputError(f"the tie of '{path}' is not valid, because {error}") from None
        named = {element.path for name in expression.paths for element in elements(model, name)}
        declaration = find(model, path).declaration
        parts = [element.path for element in elements(model, path)]
        apart = path not in expression.paths
        return cls(
            path=path,
            expression=expression,
            elements=tuple(part for part in parts if part not in named or not apart),
            lower=declaration.lower,
            upper=declaration.upper,
        )

    def values(self, model: eqx.Module) -> Array:
        """Evaluate the expression in the shape of the parameter (differentiable)."""
        value = jnp.asarray(self.expression.value(lambda path: get(model, path), _FUNCTIONS))
        old = get(model, self.path)
        if value.ndim and value.shape != old.shape:
            raise InputError(
                f"'{self.path}' has {old.size} element{'s' * (old.size != 1)}, but the expression "
                f"of its tie has {value.size} values: tie it to one value, or to one value "
                "for each element"
            )
        if not old.ndim:
            return value
        kept = np.asarray([part.path not in self.elements for part in elements(model, self.path)])
        return jnp.where(kept, old, value)


def resolved_ties(model: eqx.Module, texts: Mapping[str, str]) -> tuple[Tie, ...]:
    """Return the ties of a model, sorted so that each depends only on earlier ones.

    Effects that the model omits must be switched on before.

    Raises:
        InputError: an invalid expression, an unknown path, a parameter that is tied twice or
            depends on itself, or a number of values that differs from the number of elements.
    """
    ties = [Tie.of(model, path, text) for path, text in texts.items()]
    owners: dict[str, int] = {}
    for index, tie in enumerate(ties):
        for element in tie.elements:
            if element in owners:
                other = ties[owners[element]].path
                raise InputError(
                    f"'{element}' is tied by both '{other}' and '{tie.path}': remove one of these "
                    "ties"
                )
            owners[element] = index
    needs = {
        index: {
            owners[element.path]
            for name in tie.expression.paths
            for element in elements(model, name)
            if element.path in owners
        }
        for index, tie in enumerate(ties)
    }
    try:
        order = list(graphlib.TopologicalSorter(needs).static_order())
    except graphlib.CycleError as error:
        names = " and ".join(sorted({f"'{ties[index].path}'" for index in error.args[1]}))
        raise InputError(
            f"the ties of {names} are circular: tie them to other parameters"
        ) from None
    return tuple(ties[index] for index in order)


def tied(model: Module, ties: Sequence[Tie]) -> Module:
    """Return the model with the value of each tied parameter computed from the others.

    The function is differentiable.
    """
    for tie in ties:
        model = replace(model, {tie.path: tie.values(model)})
    return model


def _check_values(model: eqx.Module, paths: Iterable[str]) -> None:
    """Refuse values outside the bounds of their parameters."""
    for element in (element for path in paths for element in elements(model, path)):
        check_within_bounds(element, float(element.value(model)), free=False)


def within_bounds(model: eqx.Module, ties: Sequence[Tie]) -> Bool[Array, ""]:
    """Return whether all tied parameters are within their bounds."""
    inside = [
        jnp.all((tie.lower <= value) & (value <= tie.upper))
        for tie in ties
        for value in [get(model, tie.path)]
    ]
    return jnp.all(jnp.stack(inside)) if inside else jnp.asarray(True)


@dataclasses.dataclass(frozen=True)
class WarmStart:
    """Final values of another fit, from which a fit starts.

    Attributes:
        model: kind of the fitted model.
        values: values of the parameters that were free or fixed in that fit, by path, SI units.
        own: values of the parameters of single runs, by the name of the run and their path, SI
            units.
    """

    model: str
    values: Mapping[str, Any]
    own: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    def values_for(self, model: AbstractModel) -> Mapping[str, Any]:
        """Return the values, if this model has all of their parameters.

        Raises:
            InputError: the model is of a different kind, or lacks one of the parameters.
        """
        if not set(self.model.split("+")) <= set(model.kind.split("+")):
            raise InputError(
                f"the fit for the warm start uses the {self.model} model, but the runs use the "
                f"{model.kind} model: give a fit of the same model"
            )
        try:
            whole = switched_on(model, self.values)
            for path, value in self.values.items():
                check_count(whole, path, value)
        except InputError as error:
            raise InputError(
                f"the fit for the warm start and the model of the runs have different parameters: "
                f"{error}"
            ) from None
        return self.values


def between(value: float, lower: float, upper: float, *, margin: float = 0.0) -> float:
    """Return the nearest value strictly between two bounds, which may be infinite.

    Arguments:
        value: value to limit.
        lower, upper: bounds.
        margin: minimum distance from a bound, less than half the distance between the bounds.
    """
    if np.isfinite(lower) and np.isfinite(upper):
        margin = max(margin, 1e-9 * (upper - lower))
        return float(np.clip(value, lower + margin, upper - margin))
    # Exclude subnormal numbers next to 0, whose logarithm may fail.
    margin = max(margin, float(np.finfo(float).tiny))
    if np.isfinite(lower):
        return max(value, lower + margin, float(np.nextafter(lower, np.inf)))
    return min(value, upper - margin, float(np.nextafter(upper, -np.inf)))


@dataclasses.dataclass(frozen=True)
class Setup:
    """Resolved configuration of a fit. `set_up` creates it, and `solve` fits it.

    Attributes:
        model: model with the initial values and the fixed values.
        runs: runs to which the model is fitted.
        settings: settings as they were given.
        parameters: free scalar parameters, except those of single runs. Each declares the bounds of
            this fit.
        unstarted: paths of the free parameters without an initial value from the caller.
        own: initial values of the parameters of single runs, by the name of the run and their path,
            if they differ from the prepared run.
        config: the configuration as plain data, `config` of the result. Two fits of the same data
            with the same configuration have the same result.
        priors: priors of parameters, by the path of an element.
        ties: parameters that are computed from others, in order of evaluation.
        groups: runs (by position) that share a value, by the path of an element. A path that is not
            included has one value for all runs.
        reopened: whether another fit chose the tolerance of the model.
        suited: tolerance that another fit of the same data chose. A fit that chooses its own
            tolerance begins with it, and checks it only at the end.
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
        """Positions of the parameter values in the free coordinate."""
        return Layout.of([p.path for p in self.parameters], self.groups, len(self.runs))

    def starts(self) -> list[float]:
        """Return the initial parameter values at their positions in the free coordinate."""
        starts = [0.0] * self.layout.size
        for column, parameter in enumerate(self.parameters):
            value, path = float(parameter.value(self.model)), parameter.path
            bounds = parameter.declaration.lower, parameter.declaration.upper
            for run, places in zip(self.runs, self.layout.of_runs, strict=True):
                # If another fit had values for groups of runs, each group starts at its own.
                known = self.own.get(run.name, {}) if path in self.groups else {}
                starts[places[column]] = between(known[path], *bounds) if path in known else value
        return starts

    @property
    def nuisances(self) -> tuple[str, ...]:
        """Paths of the nuisance parameters, which are free because they are always uncertain."""
        return tuple(self.config.get("nuisances", ()))

    @functools.cached_property
    def loss(self) -> AbstractLoss:
        """Loss function of the fit, which weights large residuals."""
        return loss_of(self.settings.loss)

    @functools.cached_property
    def chooses_tolerance(self) -> bool:
        """Whether the fit chooses the integrator tolerance, because none is specified."""
        integration = capabilities.integration(self.model)
        # Rounding in 32 bit hides the effect of a finer tolerance.
        if integration is None or jnp.result_type(float) == jnp.float32:
            return False
        return self.reopened or integration.tolerance is None

    def at_start(self) -> Self:
        """Return the setup with the model at its start (`giajax.models.capabilities.at_start`)."""
        model = tied(capabilities.at_start(self.model, self.runs, self.unstarted), self.ties)
        return dataclasses.replace(self, model=model, unstarted=())

    def started_at(self, values: Mapping[str, float]) -> Self:
        """Return the setup with different initial values of the free parameters, by path."""
        model = tied(replace(self.model, values), self.ties)
        return dataclasses.replace(self, model=model, unstarted=())


def _resolved(
    model: AbstractModel,
    runs: tuple[Run, ...],
    settings: FitSettings,
    groups: Mapping[str, Sequence[Sequence[str]]],
    reached: Mapping[str, Any],
    nuisances: Sequence[str],
) -> Setup:
    """Resolve the free parameters of a fit, without its `config`.

    Arguments:
        model: model of the runs.
        runs: runs to fit.
        settings: settings of the fit.
        groups: names of the runs that share a value, by path.
        reached: final values of another fit, by path.
        nuisances: paths of the nuisance parameters.

    Raises:
        InputError: an unknown path, two paths that contradict each other, or a value outside its
            bounds.
    """
    free, start, fix, ties = settings.free, settings.start, settings.fix, settings.ties
    asked = [*(free or ()), *nuisances, *groups]
    model = switched_on(model, (*reached, *start, *fix, *asked, *ties))
    for path, value in (*start.items(), *fix.items()):
        check_count(model, path, value)
    for path in set(start) & set(fix):
        raise InputError(
            f"'{path}' has both an initial value and a fixed value: give only one of them"
        )
    by_default = default_free(model, start) if free is None else ()
    chosen = [*by_default, *asked]
    fixed = {element.path for path in fix for element in elements(model, path)}
    for values in (start, reached, fix):
        model = replace(model, values)
    order = resolved_ties(model, ties)
    following = dict.fromkeys(path for tie in order for path in tie.elements)
    for path in (*asked, *fix, *start):
        if all(element.path in following for element in elements(model, path)):
            how = "free" if path in asked else "fixed" if path in fix else "given an initial value"
            raise InputError(
                f"'{path}' is tied to other parameters and also {how}: omit one of the two"
            )
    parameters: dict[str, Parameter] = {}
    for path in chosen:
        for element in elements(model, path):
            if element.path in fixed:
                if path in asked:
                    raise InputError(f"'{element.path}' is both free and fixed: choose one of them")
            elif element.path not in following:
                parameters[element.path] = element
    parameters |= _bounded(model, parameters, settings.bounds)
    known = _element_priors(model, runs, parameters, settings.known)
    begun = {element.path for path in (*reached, *start) for element in elements(model, path)}
    # The mean of a prior is the best initial guess.
    expected = {path: p.value for path, p in known.items() if path in parameters}
    expected = {path: value for path, value in expected.items() if path not in begun}
    model = replace(model, expected)
    _check_values(model, fix)
    # A fit may end on a bound, but cannot start there.
    ended = (element for path in reached for element in elements(model, path))
    inside = {
        e.path: between(float(e.value(model)), e.declaration.lower, e.declaration.upper)
        for e in ended
        if e.path in parameters
    }
    model = replace(model, inside)
    for element in parameters.values():
        check_within_bounds(element, float(element.value(model)), free=True)
    _check_values(model, start)
    model = tied(model, order)
    _check_values(model, following)
    return Setup(
        model=model,
        runs=runs,
        settings=settings,
        parameters=tuple(parameters.values()),
        unstarted=tuple(path for path in parameters if path not in begun | expected.keys()),
        config={},
        priors=known,
        ties=order,
        groups={
            element.path: members(path, runs, names)
            for path, names in groups.items()
            for element in _free_elements(model, path, parameters, "groups of runs")
        },
    )


def _bounded(
    model: AbstractModel, parameters: Mapping[str, Parameter], bounds: Mapping[str, Sequence[float]]
) -> dict[str, Parameter]:
    """Return the free parameters whose bounds this fit sets, with these bounds."""
    bounded: dict[str, Parameter] = {}
    for path, pair in bounds.items():
        if np.shape(pair) != (2,) or not np.all(np.isfinite(pair)) or not pair[0] < pair[1]:
            raise InputError(
                f"the bounds of '{path}' must be two numbers, the lower one first: write, for "
                "example, 0.01,1.0"
            )
        low, high = map(float, pair)
        for element in _free_elements(model, path, parameters, "bounds"):
            declaration = element.declaration
            if low < declaration.lower or high > declaration.upper:
                raise InputError(
                    f"the bounds {low:g} and {high:g} of '{path}' exceed its permitted range: "
                    f"choose bounds between {declaration.lower:g} and {declaration.upper:g}"
                )
            narrow = dataclasses.replace(declaration, lower=low, upper=high)
            bounded[element.path] = dataclasses.replace(element, declaration=narrow)
    return bounded


def _element_priors(
    model: AbstractModel,
    runs: Sequence[Run],
    parameters: Mapping[str, Parameter],
    priors: Mapping[str, Prior],
) -> dict[str, Prior]:
    """Return the priors by element. Priors of parameters of single runs keep their paths."""
    known: dict[str, Prior] = {}
    # A prior of one element takes precedence over a prior of all elements.
    for path, prior in sorted(priors.items(), key=lambda item: "[" in item[0]):
        if path.partition("[")[0] not in declared(model) and path in _own_paths(model, runs):
            known[path] = prior
            continue
        for element in _free_elements(model, path, parameters, "a prior"):
            declaration = element.declaration
            if prior.logarithmic and declaration.lower < 0:
                raise InputError(
                    f"'{path}' may be negative, but the width of its prior is given as a factor: "
                    "give a deviation instead"
                )
            if not declaration.lower < prior.value < declaration.upper:
                raise InputError(
                    f"the prior of '{path}' has the value {prior.value:g}, which is outside the "
                    "bounds of this parameter: choose a value between "
                    f"{declaration.lower:g} and {declaration.upper:g}"
                )
            known[element.path] = prior
    return known


def _free_elements(
    model: AbstractModel, path: str, parameters: Mapping[str, Parameter], what: str
) -> list[Parameter]:
    """Return the free elements of a path. At least one element must be free."""
    parts = elements(model, path)
    free = [parameters[part.path] for part in parts if part.path in parameters]
    if not free:
        raise InputError(f"'{path}' has {what} but is not free: free it, or omit {what}")
    return free


def element_labels(path: str, size: int) -> list[str]:
    """Return the names of the elements of a parameter that is free in each run."""
    return [f"{path}[{index}]" for index in range(size)] if size > 1 else [path]


def _own_paths(model: AbstractModel, runs: Sequence[Run]) -> set[str]:
    """Return the paths of the free parameters of single runs, with and without an index."""
    paths: set[str] = set()
    for run in runs:
        for path in capabilities.free_inputs(model, run):
            size = get(model.prepare(run), path).size
            paths |= {path, *(f"{path}[{index}]" for index in range(size))}
    return paths


def set_up(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    settings: FitSettings | None = None,
    *,
    begin: WarmStart | None = None,
    **keywords: Unpack[StartsKeywords],
) -> Setup:
    """Check and resolve the configuration of a fit for `solve`, without evaluating the model.

    Arguments:
        model, runs: as in `fit`.
        settings: settings of the fit. Settings for a task (such as `hold_out`) have no effect here.
        begin: final values of another fit. They take precedence over `start`, and `fix` takes
            precedence over both.
        **keywords: as in `fit` and `multi_start`, instead of `settings`.

    Raises:
        InputError: as in `fit`, except for an initial guess that cannot be evaluated.
    """
    settings = fit_settings(keywords, settings=settings)
    runs = (runs,) if isinstance(runs, Run) else tuple(runs)
    if not runs:
        raise InputError("no run is given: give at least one")
    for run in runs:
        run.require_observations()
    _check_doubles(runs)
    if settings.solver is not None or settings.tolerance is not None:
        model = capabilities.with_integration(
            model, solver=settings.solver, tolerance=settings.tolerance
        )
    groups = sharing(runs, settings.per_run, settings.groups)
    reached = {} if begin is None else begin.values_for(model)
    named: list[Iterable[str]] = [settings.free or (), settings.start, settings.fix, reached]
    named += [settings.priors, *(run.definition.uncertainty.deviations for run in runs)]
    model = with_scattering(model, (path for each in named for path in each))
    settings, nuisances = with_nuisances(model, runs, settings)
    setup = _resolved(model, runs, settings, groups, reached, nuisances)
    check_loss(setup.loss)
    _check_determined(setup)
    _check_together(setup)
    own = {} if begin is None else begin.own
    config = _config(setup, groups, begin, nuisances)
    return dataclasses.replace(setup, config=config, own=own)


def _config(
    setup: Setup,
    groups: Mapping[str, Sequence[Sequence[str]]],
    begin: WarmStart | None,
    nuisances: Sequence[str],
) -> dict[str, Any]:
    """Return the resolved settings as plain data: `config` of the result."""
    settings, integration = setup.settings, capabilities.integration(setup.model)
    limits = {
        "priors": {path: prior.contents() for path, prior in settings.known.items()},
        "bounds": settings.bounds,
        "ties": settings.ties,
        "nuisances": list(nuisances),
        "groups": groups,
        "begin": None if begin is None else dataclasses.asdict(begin),
        "optimiser": _in_words(settings.optimiser),
    }
    return {
        "definition": setup.model.definition(),
        "runs": [_about(run, setup.model) for run in setup.runs],
        "free": [parameter.path for parameter in setup.parameters],
        "start": _plain(settings.start),
        "fix": _plain(settings.fix),
        "loss": setup.loss.contents(),
        "noise_model": settings.noise_model,
        "noise_per_run": settings.noise_per_run,
        # None for a model without an integrator.
        "solver": None if integration is None else integration.solver,
        "tolerance": None if integration is None else integration.tolerance,
        # The configuration omits empty settings.
        **{name: value for name, value in limits.items() if value},
    }


def _in_words(optimiser: Any) -> str:
    """Return the class and the numbers of an optimiser, or an empty string for giajax's own."""
    if optimiser is None:
        return ""
    fields = {each.name: getattr(optimiser, each.name) for each in dataclasses.fields(optimiser)}
    numbers = [f"{k}={v}" for k, v in fields.items() if isinstance(v, int | float)]
    return f"{type(optimiser).__qualname__}({', '.join(numbers)})"


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by path as in a result: a number, or a list of several numbers."""
    return {
        path: value[0] if isinstance(value, list) and len(value) == 1 else value
        for path, value in values.items()
    }


def _about(run: Run, model: AbstractModel) -> dict[str, Any]:
    """Return the properties of a run that affect a fit, besides its data and model constants."""
    sidecar = run.definition.contents()
    about: dict[str, Any] = {key: sidecar[key] for key in run_keys(model=False) if key in sidecar}
    if run.model != model.kind:
        about["model"] = run.model
    if run.observed is not None:
        about["channels"] = list(run.observed)
    if run.times is not None:
        about |= {"from_s": float(run.times[0]), "rows": len(run.times)}
    return about


def _check_determined(setup: Setup) -> None:
    """Refuse a fit without parameters, or with more parameters than measured values and priors."""
    paths = [p.path for p in setup.parameters for _ in setup.groups.get(p.path, [setup.runs])]
    for run in setup.runs:
        inputs = setup.model.prepare(run)
        for path in capabilities.free_inputs(setup.model, run):
            paths += element_labels(path, get(inputs, path).size)
    if not paths:
        raise InputError("no parameter is free: free at least one")
    measured = sum(
        int(np.sum(~np.isnan(v))) for run in setup.runs for v in run.observations.values()
    )
    # A prior adds one row of the residual for each value to which it applies.
    known = sum(prior_of(setup.priors, path) is not None for path in paths)
    if measured + known <= len(paths):
        raise InputError(
            f"{measured} measured values cannot determine {len(paths)} parameters and their "
            "standard errors: free fewer parameters or give a longer run"
        )


def _check_together(setup: Setup) -> None:
    """Refuse a joint fit of runs of several models that share no parameter.

    Such a fit is a mistake, or two separate fits.
    """
    kinds = dict.fromkeys(run.model for run in setup.runs)
    if len(kinds) < 2:
        return
    if setup.groups:
        path = next(iter(setup.groups))
        raise InputError(
            f"'{path}' has values for individual runs, but the runs use several models: omit "
            "these values, or fit only the runs of one model"
        )
    joins = [
        tie
        for tie in setup.ties
        if any(p.partition("[")[0] != tie.path.partition("[")[0] for p in tie.expression.paths)
    ]
    if not joins and not any(p.is_shared for p in setup.parameters):
        raise InputError(
            f"the models of these runs, {' and '.join(kinds)}, share no free parameter: free or "
            "tie a shared parameter, or fit the models separately"
        )


def _check_doubles(runs: Sequence[Run]) -> None:
    """Refuse a recording that is given twice, because its standard errors would be too small."""
    seen: dict[tuple[str, float], str] = {}
    for run in runs:
        if run.sha256 is None:
            continue
        # Several windows of one recording are separate runs.
        part = (run.sha256, 0.0 if run.times is None else float(run.times[0]))
        if part in seen:
            raise InputError(
                f"'{seen[part]}' and '{run.path}' are the same recording: give it only once"
            )
        seen[part] = str(run.path)
