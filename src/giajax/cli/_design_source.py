"""What `giajax design` begins from: a fit, its definition, or a file with an arm."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._driven import definition_from_options, model_and_truth
from ._model import is_result

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..models import ArmModel
    from ..runs import Fit

# Of a file, beside the arm.
_KEPT = ("initial", "wind", "noise")


def source_of(
    source: Path | None,
    links: int | None,
    pairs: list[str],
    free: list[str],
    solver: str,
    tolerance: float,
) -> tuple["ArmModel | FitResult", dict[str, Any]]:
    """The arm or the fit, and what a file says of what is free, priors, ties and the start.

    Arguments:
        source: SOURCE of the command line.
        links, pairs, free: of --links, --set and --free, which go before what a file says.
        solver, tolerance: of the integration.

    Raises:
        InputError: --links or --set beside a fit, or a file that describes no arm.
    """
    if source is not None and is_result(source):
        from ..fitting import load_result

        if links is not None or pairs:
            raise InputError("a fit brings its own arm: leave out --links and --set")
        fitted = load_result(source)
        model = fitted.model.with_integration(solver=solver, tolerance=tolerance)
        # As the definition of the fit would have it, but for noise, which the fit tells.
        first = {**fitted.config["runs"][0], "noise": None}
        return dataclasses.replace(fitted, model=model), {
            "free": None,
            "priors": None,
            "ties": None,
            "definition": _kept(first),
        }
    from ..runs import read_sidecar

    definition = definition_from_options(source, links, None)
    fit = definition.fit
    if source is not None and fit.data:
        # What a fit definition does not say of the arm, the sidecar of its first run does.
        definition = read_sidecar(source.parent / fit.data[0]).merged_with(definition)
    values, ties = {**(fit.start or {}), **(fit.fix or {})}, fit.ties or {}
    started = [f"{path}={_typed(value)}" for path, value in values.items()]
    changed = {path.partition("=")[0] for path in pairs}
    kept = [pair for pair in started if pair.partition("=")[0] not in changed]
    model, _ = model_and_truth(definition, [*kept, *pairs], solver, tolerance)
    stated = definition.contents()
    return model, {
        "free": _free(model, fit),
        "priors": {path: entry.prior() for path, entry in fit.priors.items()},
        "ties": {path: text for path, text in ties.items() if path not in {*changed, *free}},
        "definition": _kept(stated),
    }


def _kept(stated: Mapping[str, Any]) -> dict[str, Any]:
    """What a file says of the start, the wind and the noise, without what only a recording has."""
    kept = {key: dict(stated[key]) for key in _KEPT if stated.get(key) is not None}
    # An experiment that is planned has no first row.
    kept.get("initial", {}).pop("first_row", None)
    return {key: section for key, section in kept.items() if section}


def _free(model: "ArmModel", fit: "Fit") -> list[str] | None:
    """What the fit of a definition has free, by elements; None where there is none."""
    from ..parameters import default_free, elements, switched_on

    if not fit.contents():
        return None
    apart = (*(fit.per_run or ()), *(fit.groups or ()))
    held = (*(fit.fix or ()), *(fit.ties or ()))
    model = switched_on(model, (*(fit.start or ()), *(fit.free or ()), *apart, *held))
    named = default_free(model, fit.start or ()) if fit.free is None else fit.free
    without = {element.path for path in held for element in elements(model, path)}
    free = [element.path for path in (*named, *apart) for element in elements(model, path)]
    return [path for path in free if path not in without]


def _typed(value: Any) -> str:
    numbers = value if isinstance(value, list) else [value]
    return ",".join(f"{number:.17g}" for number in numbers)
