"""What models with one input and one output share: their columns, and Bouc-Wen products."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self

import numpy as np

from .._errors import InputError
from .._typing import Scalar
from ..kinds import KINDS
from ..runs import Channel, Run, parse_column
from ._protocol import Derived


@dataclasses.dataclass(frozen=True)
class Columns:
    """The columns of input and output in the runs of a model; empty where not known.

    Attributes:
        input: that drove the runs, such as "command_deg".
        output: that they measured, such as "angle_deg".
    """

    input: str = ""
    output: str = ""

    @classmethod
    def of(cls, run: Run) -> Self:
        """Those of a run."""
        driven, measured = input_channel(run, run.model), output_channel(run)
        return cls(driven.column, "" if measured is None else measured.column)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """As `to_dict` gave them."""
        return cls(definition.get("input_column", ""), definition.get("output_column", ""))

    def to_dict(self) -> dict[str, str]:
        """Those that are known, as plain data."""
        both = {"input_column": self.input, "output_column": self.output}
        return {name: column for name, column in both.items() if column}

    @property
    def input_channel(self) -> Channel:
        """The channel that drove the runs; the command of a joint where that is not known."""
        return parse_column(self.input or "command_rad")

    @property
    def output_channel(self) -> Channel | None:
        """The channel that the runs measured; None where that is not known."""
        return parse_column(self.output) if self.output else None

    def check(self, run: Run) -> None:
        """Raise `InputError` for a run of other quantities than those of the model."""
        own = [self.input_channel if self.input else None, self.output_channel]
        theirs = [input_channel(run, run.model), output_channel(run)]
        for mine, other in zip(own, theirs, strict=True):
            if mine is not None and other is not None and not comparable(mine, other):
                raise InputError(
                    f"'{run.name}' has the column {other.column} where the model has "
                    f"{mine.column}: give a run of the same quantity"
                )


def input_channel(run: Run, kind: str) -> Channel:
    """The channel that drives a run of a kind of model that has one input.

    Raises:
        InputError: a run of another kind, or with none or several.
    """
    if run.model != kind:
        raise InputError(
            f"'{run.name}' is a run of the {run.model} model: give one of the {kind} model"
        )
    names = list(run.commands)
    if len(names) != 1:
        raise InputError(
            f"'{run.name}' must have one column of input or command, and has "
            f"{' and '.join(names) or 'none'}: rename or remove columns"
        )
    if len(_outputs(run)) > 1:
        raise InputError(f"'{run.name}' has both output and angle: remove one of the columns")
    return run.channels[names[0]]


def input_values(run: Run, kind: str) -> np.ndarray:
    """What drives a run of a kind of model that has one input, SI, shape (sample,).

    Raises:
        InputError: as `input_channel`.
    """
    return np.asarray(run.values[input_channel(run, kind).name], dtype=float)


def output_channel(run: Run) -> Channel | None:
    """The channel that a run measures; None where it measures none."""
    return next(iter(_outputs(run)), None)


def _outputs(run: Run) -> list[Channel]:
    return [channel for channel in run.channels.values() if channel.kind in run.kind.outputs]


def comparable(one: Channel, other: Channel) -> bool:
    """Whether two channels may be of one quantity; a bare `input` or `output` says none."""
    return "ratio" in (one.quantity, other.quantity) or one.quantity == other.quantity


def check_outputs(kind: str, channels: Sequence[str]) -> None:
    """Raise `InputError` for a channel that a kind of model does not predict."""
    outputs = KINDS[kind].outputs
    for name in channels:
        if Channel.named(name).kind not in outputs:
            raise InputError(
                f"'{name}' is not predicted by the {kind} model: use one of {', '.join(outputs)}"
            )


class BoucWenParameters(Protocol):
    """What an element of the Bouc-Wen equation has."""

    beta: Scalar
    gamma: Scalar
    delta: Scalar


def products(element: BoucWenParameters, unit: str) -> dict[str, Derived]:
    """The products of Bouc-Wen parameters that a history determines."""
    return {
        "beta*gamma": Derived(element.beta * element.gamma, unit),
        "beta*delta": Derived(element.beta * element.delta, unit),
    }


def products_condition(free: Sequence[str]) -> list[str]:
    """That beta, gamma and delta count only as products, where one of them is free."""
    names = [path for path in free if path in ("beta", "gamma", "delta")]
    held = [path for path in ("beta", "gamma", "delta") if path not in free]
    if not names:
        return []
    how = f"; held: {', '.join(held)}" if held else ""
    return [f"{', '.join(names)}: only the products beta gamma and beta delta are determined{how}"]
