"""Which kind of model a set of channels belongs to."""

from collections.abc import Iterable

from .._errors import InputError
from .._text import one_of
from ..kinds import KINDS, Kind
from ._channels import Channel


def belongs(channel: Channel, kind: Kind) -> bool:
    """Whether a run of this kind may hold the channel."""
    return channel.kind == "time" or any(row.name == channel.kind for row in kind.channels)


def infer_model(channels: Iterable[Channel]) -> str | None:
    """The kind of model that the channels alone say, or None."""
    rows = frozenset(channel.kind for channel in channels)
    return next((kind.name for kind in KINDS.values() if kind.recognises(rows)), None)


def decide_model(channels: Iterable[Channel], sidecar: str | None, source: str) -> str:
    """The kind of model of a run: as its sidecar states, else as its channels say.

    Raises:
        InputError: neither says, or a channel belongs to another kind.
    """
    channels = list(channels)
    inferred = infer_model(channels)
    model = sidecar or inferred
    if model is None:
        names = ", ".join(channel.name for channel in channels)
        raise InputError(
            f"{source}: the channels {names} do not say which model the run is of: "
            f'state it in the sidecar as model = "..." ({one_of(KINDS)})'
        )
    for channel in channels:
        if belongs(channel, KINDS[model]):
            continue
        if sidecar is not None and inferred not in (None, sidecar):
            raise InputError(
                f"{source}: the sidecar says model = {sidecar!r}, but column {channel.column!r} "
                f"belongs to {inferred!r}: correct the sidecar or remove the column"
            )
        raise InputError(
            f"{source}: column {channel.column!r} does not belong to the model {model!r} "
            "of this run: remove or rename it, or state another model in the sidecar"
        )
    return model
