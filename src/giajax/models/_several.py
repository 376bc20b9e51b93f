"""Several models as one: runs of several kinds in one fit, with parameters that they share by path.

An arm that muscles drive has the corrections alpha and beta of its joints, and so has a joint on a
bench: a fit to runs of both has one alpha for both.
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
    """The model of a run in which what belongs to some names is as the sidecar of the run states.

    What it does not state is left out, or has its default. Names are those of
    `giajax.schema.parameters.as_in`.

    Raises:
        InputError: neither the model nor the run has something of a name, or the run is another
            model's.
    """
    if not names:
        return model
    own = model.part(run.model) if isinstance(model, SeveralModels) else model
    return as_in(own, model_class(run.model).for_runs([run]), names)


class SeveralInputs(eqx.Module):
    """What the model of a kind prepared of a run; its parameters keep their paths."""

    kind: str = eqx.field(static=True)
    inputs: Any = inline()


class SeveralModels(AbstractModel):
    """Predicts for each run what the model of its kind predicts.

    A parameter of the same path is one parameter, whichever of the models have it.

    Arguments:
        parts: the models, each of another kind; their parameters keep their own paths.

    Raises:
        InputError: a path that means something else in two of them.
    """

    parts: tuple[AbstractModel, ...] = inline()

    def __check_init__(self) -> None:
        known: dict[str, tuple[str, Any]] = {}
        for part in self.parts:
            for path, parameter in {**declared(part), **left_out(part)}.items():
                # One of them may hold what another one frees.
                declaration = dataclasses.replace(parameter.declaration, frozen=True)
                kind, first = known.setdefault(path, (part.kind, declaration))
                # Of a unit of "input" and "output" each model has another one.
                words = {"input", "output"} & set(declaration.unit.replace("/", " ").split())
                if kind != part.kind and (words or first != declaration):
                    raise InputError(
                        f"'{path}' is a different quantity in the {part.kind} model than in the "
                        f"{kind} "
                        "model: fit their runs separately"
                    )

    @property
    def kind(self) -> str:
        """The kinds of the parts, such as `arm+joint`."""
        return "+".join(part.kind for part in self.parts)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """The models of the runs of each kind, with the constants that their sidecars state.

        Raises:
            InputError: they state different values of a parameter that they share.
        """
        by_kind = {kind: [run for run in runs if run.model == kind] for kind in KINDS}
        parts = (model_class(kind).for_runs(its) for kind, its in by_kind.items() if its)
        return cls(tuple(parts))._agreed()

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """The models that `definition()` described."""
        own = definition.get("definitions", {})
        rest = {} if "definitions" in definition else definition  # of an earlier version
        ours = AbstractModel.names_of_giajax  # which take what is theirs
        given = {k: definition if k in ours else own.get(k, rest) for k in definition["models"]}
        return cls(tuple(model_class(kind).from_definition(its) for kind, its in given.items()))

    def definition(self) -> dict[str, Any]:
        """What each of them is made from; no two kinds of giajax have a section in common.

        That of a kind of one's own, which may have keys of any name, is there by itself.
        """
        each = {part.kind: part.definition() for part in self.parts}
        whole: dict[str, Any] = {"models": list(each)}
        ours = AbstractModel.names_of_giajax
        for kind in each.keys() & set(ours):
            whole |= each[kind]
        own = {kind: its for kind, its in each.items() if its and kind not in ours}
        return {**whole, "definitions": own} if own else whole

    def part(self, kind: str) -> AbstractModel:
        """The model of the runs of a kind.

        Raises:
            InputError: there is none.
        """
        for part in self.parts:
            if part.kind == kind:
                return part
        raise InputError(f"the combined model has no {kind} part: give a run of {self.kind}")

    def prepare(self, run: Run) -> SeveralInputs:
        """What the model of the run's kind prepares."""
        return SeveralInputs(run.model, self.part(run.model).prepare(run))

    def predict(self, inputs: SeveralInputs, channels: tuple[str, ...]) -> Prediction:
        """Channels of the model of the run's kind."""
        return self.part(inputs.kind).predict(inputs.inputs, channels)

    def failure(self, inputs: SeveralInputs) -> str:
        """What the model of the run's kind says."""
        return capabilities.failure(self.part(inputs.kind), inputs.inputs)

    def scene(self, run: Run) -> Scene | None:
        """That of the model of the run's kind."""
        return capabilities.scene(self.part(run.model), run)

    def unseen(
        self, inputs: SeveralInputs, channels: tuple[str, ...]
    ) -> dict[str, npt.NDArray[np.bool_]]:
        """What the model of the run says."""
        return capabilities.unseen(self.part(inputs.kind), inputs.inputs, channels)

    def at_start(self, runs: Sequence[Run], free: Sequence[str]) -> Self:
        """Each of them where it may start."""

        def begun(part: AbstractModel) -> AbstractModel:
            own = [run for run in runs if run.model == part.kind]
            return capabilities.at_start(part, own, _paths_of(part, free))

        return self._each(begun)

    def derived(self) -> dict[str, Derived]:
        """What each of them derives."""
        return {
            name: value for part in self.parts for name, value in capabilities.derived(part).items()
        }

    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        """Those of each of them."""
        return [
            sentence
            for part in self.parts
            for sentence in capabilities.conditions(part, _paths_of(part, free), runs)
        ]

    def refined(self, factor: float) -> Self | None:
        """Each of them with finer or coarser tolerances; None where one of them has no such."""
        parts = [capabilities.refined(part, factor) for part in self.parts]
        known = tuple(part for part in parts if part is not None)
        return dataclasses.replace(self, parts=known) if len(known) == len(parts) else None

    def variants(self) -> dict[str, Self]:
        """With a choice of one of them made another way."""
        return {
            name: self._each(lambda part, of=old, by=other: by if part is of else part)  # type: ignore[misc]
            for old in self.parts
            for name, other in capabilities.variants(old).items()
        }

    def uncertain(self, runs: Sequence[Run]) -> dict[str, Prior]:
        """What each of them never knows exactly of its own runs."""
        known: dict[str, Prior] = {}
        for part in self.parts:
            known |= capabilities.uncertain(part, [run for run in runs if run.model == part.kind])
        return known

    def scattering(self) -> tuple[str, ...]:
        """What may scatter in each of them."""
        return tuple(p for part in self.parts for p in capabilities.scattering(part))

    def one_by_one(self) -> tuple[str, ...]:
        """What may be wrong of one element in each of them."""
        return tuple(p for part in self.parts for p in capabilities.one_by_one(part))

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """Those of the model of the run's kind."""
        return capabilities.free_inputs(self.part(run.model), run)

    def initial_section(self, inputs: SeveralInputs) -> dict[str, Any]:
        """That of the model of the run's kind."""
        return capabilities.initial_section(self.part(inputs.kind), inputs.inputs)

    def integration(self) -> Integration | None:
        """That of the first of them which has one."""
        known = map(capabilities.integration, self.parts)
        return next((each for each in known if each is not None), None)

    def with_integration(self, *, solver: str | None, tolerance: float | None) -> Self:
        """Those of them that are integrated, with another solver or tolerance.

        Raises:
            InputError: as of that model.
        """

        def changed(part: AbstractModel) -> AbstractModel:
            if capabilities.integration(part) is None:
                return part
            return capabilities.with_integration(part, solver=solver, tolerance=tolerance)

        return self._each(changed)

    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """Each of them as exact in derivatives as in predictions."""
        # Of paths that no model has, those of prepared inputs, any may be asked.
        ours = _paths_of(self, paths)
        inputs = [path for path in paths if path not in ours]
        return self._each(
            lambda part: capabilities.for_derivatives(part, [*_paths_of(part, ours), *inputs])
        )

    def _agreed(self) -> Self:
        """With what one states of a shared parameter and the others leave at its default."""
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
                    f"the sidecars state different values of '{path}', which is one parameter of "
                    f"the models {self.kind}: correct one of them"
                )
            if stated and len(stated) < len(found):
                agreed = replace(agreed, {path: stated[0]})
        return agreed

    def _each(self, change: Callable[[AbstractModel], AbstractModel]) -> Self:
        return dataclasses.replace(self, parts=tuple(map(change, self.parts)))


def _paths_of(part: AbstractModel, paths: Sequence[str]) -> list[str]:
    known = {**declared(part), **left_out(part)}
    return [path for path in paths if path.partition("[")[0] in known]
