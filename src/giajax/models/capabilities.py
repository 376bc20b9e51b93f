"""What a model may have beyond its protocol: one function for each optional method.

Each function calls the method of its own name, with the same arguments, where the model has one;
its docstring says what the method returns, and what holds for a model without it. Generic code
calls these functions, so that no class has to answer "nothing".
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
    """A quantity that follows from the parameters: its value and its unit."""

    value: Scalar
    unit: str


class Integration(NamedTuple):
    """How a model is integrated: its solver by name, and the tolerance of a step.

    The tolerance is None where it is not stated: a fit then chooses it.
    """

    solver: str
    tolerance: float | None


def _asked(model: AbstractModel, name: str, otherwise: T, *arguments: Any, **named: Any) -> T:
    """What an optional method of a model returns; `otherwise` for a model without it."""
    method: Callable[..., T] | None = getattr(model, name, None)
    return otherwise if method is None else method(*arguments, **named)


def failure(model: AbstractModel, inputs: Any) -> str:
    """Why the prediction of a prepared run did not succeed, and what to do: one sentence.

    Without the method the sentence says that the cause is not checked.
    """
    unknown = (
        f"the prediction of the {model.kind} model did not succeed, for a cause that is not known: "
        "choose other start values"
    )
    return _asked(model, "failure", unknown, inputs)


def conditions(model: AbstractModel, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
    """Sentences: on what the parameters, fitted to these runs, are conditional.

    Of the runs some may be of another kind, and determine the same parameters otherwise. Without
    the method the only sentence says that this is not checked.
    """
    unknown = (
        f"not checked: the {model.kind} model does not declare the conditions of its parameters"
    )
    return _asked(model, "conditions", [unknown], free, runs)


def refined(model: AbstractModel, factor: float) -> AbstractModel | None:
    """The same model with its numerical tolerances multiplied by a factor.

    A model in closed form returns itself. None without the method: the effect of the tolerances is
    then not checked.
    """
    return _asked(model, "refined", None, factor)


def scene(model: AbstractModel, run: Run) -> Scene | None:
    """What is seen of the model as it follows a run; None without the method.

    Raises:
        InputError: the run is not one of this model.
        SimulationError: the model cannot be evaluated.
    """
    return _asked(model, "scene", None, run)


def at_start(model: AbstractModel, runs: Sequence[Run], free: Sequence[str]) -> AbstractModel:
    """The model from which a fit of some parameters to some runs may start.

    A model has the method where a parameter has, by default, a value at which nothing responds to
    it. Without it, the model itself. `free` are the paths of the elements to fit that have no
    start.
    """
    return _asked(model, "at_start", model, runs, free)


def derived(model: AbstractModel) -> dict[str, Derived]:
    """Quantities that follow from the parameters and may be determined where those are not.

    Such as the products of parameters that show only together. Traced and differentiated by JAX; a
    fit gives each a standard error. By name, which is not a path of a parameter.
    """
    return _asked(model, "derived", {})


def uncertain(model: AbstractModel, runs: Sequence[Run]) -> dict[str, Prior]:
    """What of devices and constants is never known exactly, by path, with what is known of it.

    A fit frees it. The prior of an array is that of its first element, and the others change in
    proportion. Nothing without the method.
    """
    return _asked(model, "uncertain", {}, runs)


def scattering(model: AbstractModel) -> tuple[str, ...]:
    """Parameters of which each element may be another one: `giajax.suspects` tests their spread."""
    return _asked(model, "scattering", ())


def one_by_one(model: AbstractModel) -> tuple[str, ...]:
    """Parameters of which one element may be wrong: `giajax.suspects` tests each, and all together.

    As one drive does not move, or all reach too little.
    """
    return _asked(model, "one_by_one", ())


def unseen(
    model: AbstractModel, inputs: Any, channels: tuple[str, ...]
) -> dict[str, npt.NDArray[np.bool_]]:
    """Samples of a prepared run at which an experiment could not record a channel.

    By channel, each of shape (sample,), such as where a point is out of a camera's picture; what it
    does not name is always recorded.
    """
    return _asked(model, "unseen", {}, inputs, channels)


def variants(model: AbstractModel) -> dict[str, AbstractModel]:
    """The same model with one of its choices made another way, by the name of that choice.

    Choices are what no parameter blends, such as where drag acts. `giajax.suspects` tries each of
    them.
    """
    return _asked(model, "variants", {})


def rather(model: AbstractModel) -> dict[str, str]:
    """By the path of a parameter, the name of the variant that is to be believed in its place.

    Where both describe a recording about as well. Nothing without the method.
    """
    return _asked(model, "rather", {})


def freed_with(model: AbstractModel) -> dict[str, tuple[str, ...]]:
    """By the path of what switches a part on, what of that part is a guess that is freed with it.

    By a selection that tries it. Nothing without the method.
    """
    return _asked(model, "freed_with", {})


def free_inputs(model: AbstractModel, run: Run) -> tuple[str, ...]:
    """Declared parameters of the prepared inputs that are free in this run, by path.

    They belong to the run alone, such as its initial state.
    """
    return _asked(model, "free_inputs", (), run)


def initial_section(model: AbstractModel, inputs: Any) -> dict[str, Any]:
    """Keys of `[initial]` that state how a prepared run begins.

    A run that says `first_row = true` can then be recorded again with another first row.
    """
    return _asked(model, "initial_section", {}, inputs)


def integration(model: AbstractModel) -> Integration | None:
    """How the model is integrated; None where it is in closed form or has steps of its own."""
    return _asked(model, "integration", None)


def with_integration(
    model: AbstractModel, *, solver: str | None, tolerance: float | None
) -> AbstractModel:
    """The same model with another solver or tolerance; None leaves the one it has.

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
    """The same model, as exact in derivatives by some parameters as in its predictions.

    A model that integrates may need shorter steps for them. Its predictions do not depend on
    whether they are differentiated, so that a fit and a sensitivity study request this. Paths are
    of parameters of the model, or of the prepared inputs (`free_inputs`).
    """
    return _asked(model, "for_derivatives", model, paths)
