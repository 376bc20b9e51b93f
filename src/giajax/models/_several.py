"""Combine models of several kinds of runs in one fit, with shared parameters by path.

An arm with muscles has corrections alpha and beta of its joints, and so does a joint on a test
bench. A fit to runs of both therefore has one alpha for both.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import equinox as eqx
import numpy as np
import numpy.typing as npt

from ..recordings import Run
from ..runtime.text import InputError
from ..schema import KINDS, Prior
from ..schema.parameters import as_in, declared, inline, left_out, replace
from . import capabilities
from ._protocol import AbstractModel, Prediction, Scene, model_class
from .capabilities import Derived, Integration


def as_stated(model: AbstractModel, run: Run, names: Sequence[str]) -> AbstractModel:
    """Return the model of a run with the named parts as given in the sidecar of the run.

    Parts that the sidecar does not give are left out, or have their defaults. The names are those
    of `giajax.schema.parameters.as_in`.

    Raises:
        InputError: neither the model nor the run has anything of a name, or the run belongs to
            another model.
    """
    if not names:
        return model
    own = model.part(run.model) if isinstance(model, SeveralModels) else model
    return as_in(own, model_class(run.model).for_runs([run]), names)


class SeveralInputs(eqx.Module):
    """Inputs prepared by the model of one kind; parameters in them keep their paths."""

    kind: str = eqx.field(static=True)
    inputs: Any = inline()


class SeveralModels(AbstractModel):
    """Predicts each run with the model of its kind.

    Parameters with the same path are one parameter, in any of the models.

    Arguments:
        parts: the models, each of another kind; their parameters keep their own paths.

    Raises:
        InputError: a path has different meanings in two models.
    """

    parts: tuple[AbstractModel, ...] = inline()

    def __check_init__(self) -> None:
        known: dict[str, tuple[str, Any]] = {}
        for part in self.parts:
            for path, parameter in {**declared(part), **left_out(part)}.items():
                # A model may hold a parameter that another model frees.
                declaration = dataclasses.replace(parameter.declaration, frozen=True)
                kind, first = known.setdefault(path, (part.kind, declaration))
                # Units that contain "input" or "output" depend on the model.
                words = {"input", "output"} & set(declaration.unit.replace("/", " ").split())
                if kind != part.kind and (words or first != declaration):
                    raise InputError(
                        f"'{path}' is a different quantity in the {part.kind} model than in the "
                        f"{kind} model: fit their runs separately"
                    )

    @property
    def kind(self) -> str:
        """The kinds of the parts, such as `arm+joint`."""
        return "+".join(part.kind for part in self.parts)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """Return the models of the runs of each kind, with the constants in their sidecars.

        Raises:
            InputError: the sidecars give different values of a shared parameter.
        """
        by_kind = {kind: [run for run in runs if run.model == kind] for kind in KINDS}
        parts = (model_class(kind).for_runs(its) for kind, its in by_kind.items() if its)
        return cls(tuple(parts))._agreed()

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """Return the models that `definition()` described."""
        own = definition.get("definitions", {})
        rest = {} if "definitions" in definition else definition  # of an earlier version
        ours = AbstractModel.names_of_giajax  # these use only their own sections
        given = {k: definition if k in ours else own.get(k, rest) for k in definition["models"]}
        return cls(tuple(model_class(kind).from_definition(its) for kind, its in given.items()))

    def definition(self) -> dict[str, Any]:
        """Return the definitions of all parts; built-in kinds have different sections.

        The definition of a user-defined kind may contain any key, so it is stored separately.
        """
        each = {part.kind: part.definition() for part in self.parts}
        whole: dict[str, Any] = {"models": list(each)}
        ours = AbstractModel.names_of_giajax
        for kind in each.keys() & set(ours):
            whole |= each[kind]
        own = {kind: its for kind, its in each.items() if its and kind not in ours}
        return {**whole, "definitions": own} if own else whole

    def part(self, kind: str) -> AbstractModel:
        """Return the model for runs of a kind.

        Raises:
            InputError: there is no model of this kind.
        """
        for part in self.parts:
            if part.kind == kind:
                return part
        raise InputError(f"the combined model has no {kind} part: give a run of {self.kind}")

    def prepare(self, run: Run) -> SeveralInputs:
        """Prepare a run with the model of its kind."""
        return SeveralInputs(run.model, self.part(run.model).prepare(run))

    def predict(self, inputs: SeveralInputs, channels: tuple[str, ...]) -> Prediction:
        """Return the channels predicted by the model of the run's kind."""
        return self.part(inputs.kind).predict(inputs.inputs, channels)

    def failure(self, inputs: SeveralInputs) -> str:
        """Return the message of the model of the run's kind."""
        return capabilities.failure(self.part(inputs.kind), inputs.inputs)

    def scene(self, run: Run) -> Scene | None:
        """Return the scene of the model of the run's kind."""
        return capabilities.scene(self.part(run.model), run)

    def unseen(
        self, inputs: SeveralInputs, channels: tuple[str, ...]
    ) -> dict[str, npt.NDArray[np.bool_]]:
        """Return the unseen samples from the model of the run's kind."""
        return capabilities.unseen(self.part(inputs.kind), inputs.inputs, channels)

    def at_start(self, runs: Sequence[Run], free: Sequence[str]) -> Self:
        """Return the models at initial guesses suitable for their parameters."""

        def begun(part: AbstractModel) -> AbstractModel:
            own = [run for run in runs if run.model == part.kind]
            return capabilities.at_start(part, own, _paths_of(part, free))

        return self._each(begun)

    def derived(self) -> dict[str, Derived]:
        """Return the derived quantities of all models."""
        return {
            name: value for part in self.parts for name, value in capabilities.derived(part).items()
        }

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        """Return the conditions of all models."""
        return [
            sentence
            for part in self.parts
            for sentence in capabilities.conditions(part, _paths_of(part, free), runs)
        ]

    def refined(self, factor: float) -> Self | None:
        """Return the models with scaled tolerances; None if one of them has no tolerances."""
        parts = [capabilities.refined(part, factor) for part in self.parts]
        known = tuple(part for part in parts if part is not None)
        return dataclasses.replace(self, parts=known) if len(known) == len(parts) else None

    def variants(self) -> dict[str, Self]:
        """Return all variants in which one choice of one model differs."""
        return {
            name: self._each(lambda part, of=old, by=other: by if part is of else part)  # type: ignore[misc]
            for old in self.parts
            for name, other in capabilities.variants(old).items()
        }

    def uncertain(self, runs: Sequence[Run]) -> dict[str, Prior]:
        """Return the priors of the uncertain parameters of each model for its own runs."""
        known: dict[str, Prior] = {}
        for part in self.parts:
            known |= capabilities.uncertain(part, [run for run in runs if run.model == part.kind])
        return known

    def scattering(self) -> tuple[str, ...]:
        """Return the parameters of all models that may differ between elements."""
        return tuple(p for part in self.parts for p in capabilities.scattering(part))

    def one_by_one(self) -> tuple[str, ...]:
        """Return the parameters of all models of which a single element may be wrong."""
        return tuple(p for part in self.parts for p in capabilities.one_by_one(part))

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """Return the free inputs of the model of the run's kind."""
        return capabilities.free_inputs(self.part(run.model), run)

    def initial_section(self, inputs: SeveralInputs) -> dict[str, Any]:
        """Return the initial section of the model of the run's kind."""
        return capabilities.initial_section(self.part(inputs.kind), inputs.inputs)

    def integration(self) -> Integration | None:
        """Return the integration settings of the first model that is integrated."""
        known = map(capabilities.integration, self.parts)
        return next((each for each in known if each is not None), None)

    def with_integration(self, *, solver: str | None, tolerance: float | None) -> Self:
        """Return the models with another solver or tolerance for those that are integrated.

        Raises:
            InputError: as for these models.
        """

        def changed(part: AbstractModel) -> AbstractModel:
            if capabilities.integration(part) is None:
                return part
            return capabilities.with_integration(part, solver=solver, tolerance=tolerance)

        return self._each(changed)

    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """Return the models with derivatives that are as accurate as predictions."""
        # Paths that belong to no model are those of prepared inputs, which any model may have.
        ours = _paths_of(self, paths)
        inputs = [path for path in paths if path not in ours]
        return self._each(
            lambda part: capabilities.for_derivatives(part, [*_paths_of(part, ours), *inputs])
        )

    def _agreed(self) -> Self:
        """Return the models with each shared parameter at the value that a sidecar gives."""
        agreed = self
        for path, parameter in declared(self).items():
            if not parameter.is_shared:
                continue
            usual = parameter.declaration.default
            values = (reach(self) for reach in parameter.getters)
            found = [np.asarray(value) for value in values if value is not None]
            stated = [value for value in found if not np.all(value == usual)]
            if any(not np.array_equal(value, stated[0]) for value in stated[1:]):
                raise InputError(
                    f"the sidecars give different values of '{path}', which is a single parameter "
                    f"of the models {self.kind}: correct one of the values"
                )
            if stated and len(stated) < len(found):
                agreed = replace(agreed, {path: stated[0]})
        return agreed

    def _each(self, change: Callable[[AbstractModel], AbstractModel]) -> Self:
        return dataclasses.replace(self, parts=tuple(map(change, self.parts)))


def _paths_of(part: AbstractModel, paths: Sequence[str]) -> list[str]:
    known = {**declared(part), **left_out(part)}
    return [path for path in paths if path.partition("[")[0] in known]
