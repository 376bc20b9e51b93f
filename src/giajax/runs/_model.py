"""Which model a set of channels belongs to, and which part each channel plays in it."""

from collections.abc import Iterable

from .._errors import InputError
from ._channels import Channel
from ._words import one_of

MODELS = ("arm", "hysteresis", "joint", "muscle")

# What a model is given, in the order in which a file is written, and what it predicts.
GIVEN: dict[str, tuple[str, ...]] = {
    "arm": ("joint_command", "joint_torque"),
    "hysteresis": ("input", "command"),
    "joint": ("angle", "side", "torque"),
    "muscle": ("pressure", "contraction", "position", "phase"),
}
PREDICTED: dict[str, tuple[str, ...]] = {
    "arm": ("joint_angle", "joint_rate", "link_angle", "link_position", "tip_position"),
    "hysteresis": ("output", "angle"),
    "joint": ("contraction", "force"),
    "muscle": ("force",),
}
_ARM_ONLY = GIVEN["arm"] + PREDICTED["arm"]


def belongs(channel: Channel, model: str) -> bool:
    """Whether the table lists the channel for this model."""
    return (
        channel.kind == "time"
        or (channel.kind == "wind" and model == "arm")
        or channel.kind in GIVEN[model] + PREDICTED[model]
    )


def infer_model(channels: Iterable[Channel]) -> str | None:
    """The model that the channels tell by themselves, or None."""
    kinds = {channel.kind for channel in channels}
    if kinds & set(_ARM_ONLY):
        return "arm"
    if "side" in kinds:
        return "joint"
    if "pressure" in kinds:
        return "muscle"
    if {"command", "angle"} <= kinds or {"input", "output"} <= kinds:
        return "hysteresis"
    return None


def decide_model(channels: Iterable[Channel], stated: str | None, source: str) -> str:
    """The model of a run: as its sidecar states, else as its channels tell.

    Raises `InputError` if neither tells, or if a channel belongs to another model.
    """
    channels = list(channels)
    inferred = infer_model(channels)
    model = stated or inferred
    if model is None:
        names = ", ".join(channel.name for channel in channels)
        raise InputError(
            f"{source}: the channels {names} do not tell the model: "
            f'state it in the sidecar as model = "..." ({one_of(MODELS)})'
        )
    for channel in channels:
        if belongs(channel, model):
            continue
        if stated is not None and inferred not in (None, stated):
            raise InputError(
                f"{source}: the sidecar says model = {stated!r}, but column {channel.column!r} "
                f"belongs to {inferred!r}: correct the sidecar or remove the column"
            )
        raise InputError(
            f"{source}: column {channel.column!r} does not belong to the model {model!r} "
            "of this run: remove or rename it, or state another model in the sidecar"
        )
    return model
