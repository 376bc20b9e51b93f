"""Where another fit ended, as the start of this one."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._errors import InputError
from ..models import AbstractModel
from ..parameters import Parameter, check_count, elements, switched_on


@dataclasses.dataclass(frozen=True)
class Beginning:
    """What a fit takes from where another one ended.

    Attributes:
        model: the kind of model that was fitted.
        values: of the parameters that were free or fixed there, by path, SI.
        own: of the parameters of single runs, by the run's name and their path, SI.
    """

    model: str
    values: Mapping[str, Any]
    own: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    def values_for(self, model: AbstractModel) -> Mapping[str, Any]:
        """The values, where this model has all of their parameters.

        Raises:
            InputError: it has no model of that kind, or lacks one.
        """
        if not set(self.model.split("+")) <= set(model.kind.split("+")):
            raise InputError(
                f"the fit to begin from is of the {self.model} model and the runs are of the "
                f"{model.kind} model: give a fit of the same kind"
            )
        try:
            whole = switched_on(model, self.values)
            for path, value in self.values.items():
                check_count(whole, path, value)
        except InputError as error:
            raise InputError(f"the fit to begin from has other parameters: {error}") from None
        return self.values


def inside_bounds(
    model: AbstractModel,
    paths: Mapping[str, Any],
    free: Mapping[str, Parameter],
) -> dict[str, float]:
    """Values strictly between their bounds, for those parameters that have to start there.

    Arguments:
        model: with the present values.
        paths: of the parameters that another fit may have left on a bound.
        free: the scalar parameters to fit, by path.
    """
    values = {}
    for element in (element for path in paths for element in elements(model, path)):
        if element.path in free:
            low, high = element.declaration.lower, element.declaration.upper
            values[element.path] = between(float(element.value(model)), low, high)
    return values


def between(value: float, lower: float, upper: float, *, margin: float = 0.0) -> float:
    """The nearest value strictly between two bounds, which may be infinite.

    Arguments:
        value: any.
        lower, upper: bounds.
        margin: how far from a bound it has to be, at least; less than half of the way between two.
    """
    if np.isfinite(lower) and np.isfinite(upper):
        margin = max(margin, 1e-9 * (upper - lower))
        return float(np.clip(value, lower + margin, upper - margin))
    # Next to 0 are numbers that a logarithm does not take.
    margin = max(margin, float(np.finfo(float).tiny))
    if np.isfinite(lower):
        return max(value, lower + margin, float(np.nextafter(lower, np.inf)))
    return min(value, upper - margin, float(np.nextafter(upper, -np.inf)))
