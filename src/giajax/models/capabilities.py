"""Optional methods of models: one function for each, with a result for models without it.

Each function calls the method of the same name, with the same arguments, if the model has it.
Its docstring describes the result of the method, and the result for a model without it. Generic
code calls these functions, so no class has to implement methods that do nothing.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from ..recordings import Run
from ..runtime.arrays import Scalar
from ..runtime.text import InputError
from ..schema import Prior
from ._protocol import AbstractModel, Scene

T = TypeVar("T")


class Derived(NamedTuple):
    """A quantity computed from the parameters: its value and its unit."""

    value: Scalar
    unit: str


class Integration(NamedTuple):
    """Integration of a model: name of the solver, and tolerance of a step.

    A tolerance of None means that a fit chooses it.
    """

    solver: str
    tolerance: float | None


def _asked(model: AbstractModel, name: str, otherwise: T, *arguments: Any, **named: Any) -> T:
    """Call an optional method of a model; return `otherwise` for a model without it."""
    method: Callable[..., T] | None = getattr(model, name, None)
    return otherwise if method is None else method(*arguments, **named)


def failure(model: AbstractModel, inputs: Any) -> str:
    """Return why the prediction of a prepared run failed, and what to do, in one sentence.

    Without the method the sentence says that the cause is not checked.
    """
    unknown = (
        f"the prediction of the {model.kind} model failed for an unknown reason: choose other "
        "start values"
    )
    return _asked(model, "failure", unknown, inputs)


def conditions(model: AbstractModel, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
    """Return sentences on the conditions under which parameters fitted to these runs are valid.

    Some of the runs may be of another kind, and determine the same parameters in another way.
    Without the method, a single sentence says that the conditions are not checked.
    """
    unknown = (
        f"not checked: the {model.kind} model does not declare the conditions of its parameters"
    )
    return _asked(model, "conditions", [unknown], free, runs)


def refined(model: AbstractModel, factor: float) -> AbstractModel | None:
    """Return the model with its numerical tolerances multiplied by a factor.

    A model in closed form returns itself. Without the method the result is None, and the effect of
    the tolerances is not checked.
    """
    return _asked(model, "refined", None, factor)


def scene(model: AbstractModel, run: Run) -> Scene | None:
    """Return the visible parts of the model as it follows a run; None without the method.

    Raises:
        InputError: the run does not belong to this model.
        SimulationError: the model cannot be evaluated.
    """
    return _asked(model, "scene", None, run)


def at_start(model: AbstractModel, runs: Sequence[Run], free: Sequence[str]) -> AbstractModel:
    """Return the model from which a fit of some parameters to some runs can start.

    A model has this method if, at its default value, a parameter does not affect the prediction.
    Without the method, the model itself is returned. `free` contains the paths of the elements to
    fit that have no start value.
    """
    return _asked(model, "at_start", model, runs, free)


def derived(model: AbstractModel) -> dict[str, Derived]:
    """Return quantities that depend on the parameters and may be determined if those are not.

    Examples are products of parameters that only act together. They are traced and differentiated
    by JAX, and a fit gives each a standard error. Their names are not paths of parameters.
    """
    return _asked(model, "derived", {})


def uncertain(model: AbstractModel, runs: Sequence[Run]) -> dict[str, Prior]:
    """Return priors by path of device parameters and constants that are never known exactly.

    A fit frees them. The prior of an array applies to its first element, and the others change in
    proportion. Without the method there are none.
    """
    return _asked(model, "uncertain", {}, runs)


def scattering(model: AbstractModel) -> tuple[str, ...]:
    """Return parameters whose elements may differ; `giajax.suspects` tests their spread."""
    return _asked(model, "scattering", ())


def one_by_one(model: AbstractModel) -> tuple[str, ...]:
    """Return parameters of which a single element may be wrong.

    An example is a drive that does not move. `giajax.suspects` tests each element, and all of them
    together.
    """
    return _asked(model, "one_by_one", ())


def unseen(
    model: AbstractModel, inputs: Any, channels: tuple[str, ...]
) -> dict[str, npt.NDArray[np.bool_]]:
    """Return the samples of a prepared run at which an experiment cannot record a channel.

    The masks are by channel, each of shape (sample,), for example where a point is outside the
    image of a camera. Channels that are not included can always be recorded.
    """
    return _asked(model, "unseen", {}, inputs, channels)


def variants(model: AbstractModel) -> dict[str, AbstractModel]:
    """Return variants of the model that each differ in one choice, by the name of the choice.

    A choice cannot be expressed by a parameter, such as the points at which drag acts.
    `giajax.suspects` tries each of them.
    """
    return _asked(model, "variants", {})


def rather(model: AbstractModel) -> dict[str, str]:
    """Return, by parameter path, the name of the variant that is preferred to this parameter.

    It is preferred if both describe a recording about equally well. Without the method there are
    none.
    """
    return _asked(model, "rather", {})


def freed_with(model: AbstractModel) -> dict[str, tuple[str, ...]]:
    """Return, by the path that activates a part, the parameters of this part to free with it.

    Their values are guesses, so a selection that tries the part frees them. Without the method
    there are none.
    """
    return _asked(model, "freed_with", {})


def free_inputs(model: AbstractModel, run: Run) -> tuple[str, ...]:
    """Return the paths of declared parameters of the prepared inputs that are free in this run.

    They belong only to this run, such as its initial state.
    """
    return _asked(model, "free_inputs", (), run)


def initial_section(model: AbstractModel, inputs: Any) -> dict[str, Any]:
    """Return the keys of `[initial]` for the initial state of a prepared run.

    A run with `first_row = true` can then be recorded again with another first row.
    """
    return _asked(model, "initial_section", {}, inputs)


def integration(model: AbstractModel) -> Integration | None:
    """Return how the model is integrated; None in closed form or with steps of its own."""
    return _asked(model, "integration", None)


def with_integration(
    model: AbstractModel, *, solver: str | None, tolerance: float | None
) -> AbstractModel:
    """Return the model with another solver or tolerance; None keeps the current one.

    Raises:
        InputError: the model has none, the solver does not exist, or the tolerance is not a
            positive number.
    """
    if integration(model) is None:
        raise InputError(f"the {model.kind} model has neither a solver nor a tolerance: omit both")
    unchanged = model if (solver, tolerance) == (None, None) else None
    changed = _asked(model, "with_integration", unchanged, solver=solver, tolerance=tolerance)
    if changed is None:
        raise InputError(
            f"the {model.kind} model cannot be given another solver or tolerance: omit both, or "
            f"write the method with_integration of the model"
        )
    return changed


def for_derivatives(model: AbstractModel, paths: Sequence[str]) -> AbstractModel:
    """Return the model with derivatives that are as accurate as its predictions.

    A model that is integrated may need shorter steps for derivatives. Its predictions must not
    depend on whether they are differentiated, so fits and sensitivity studies call this function.
    Paths are those of parameters of the model, or of the prepared inputs (`free_inputs`).
    """
    return _asked(model, "for_derivatives", model, paths)
