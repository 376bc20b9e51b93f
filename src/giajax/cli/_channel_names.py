"""The option --channels of commands that simulate an arm: what is recorded of it."""

import re
from collections.abc import Sequence

from .._errors import InputError

_DEFAULT_LINKS = (2, 6, 12, 20)
_MEASURED = ("joint_angle", "joint_rate", "link_position", "tip_position")


def channel_names(selections: Sequence[str], count: int) -> list[str]:
    """Names of the channels to record, each once, in the order of the options."""
    from ..runs import Channel

    if not selections:
        selections = [f"link{link:02d}" for link in _DEFAULT_LINKS if link <= count] + ["tip"]
    names: list[str] = []
    for selection in (part.strip() for item in selections for part in item.split(",")):
        if selection == "all":
            names += [f"link{i:02d}_{axis}" for i in range(1, count + 1) for axis in "xyz"]
        elif selection == "joints":
            names += [f"joint{i:02d}_angle" for i in range(1, count + 1)]
        elif re.fullmatch(r"(\w+\.(tip|link[0-9]+|mark[0-9]+))|mark[0-9]+", selection):
            names += [f"{selection}_{axis}" for axis in "uv"]
        elif re.fullmatch(r"tip|link[0-9]+", selection):
            names += [f"{selection}_{axis}" for axis in "xyz"]
        else:
            names.append(selection)
    for name in names:
        channel = Channel.named(name)
        if channel.kind not in _MEASURED and channel.quantity != "pixel":
            raise InputError(
                f"--channels {name!r} names no channel that an arm is measured by: give link06, "
                "link06_z, tip, joint03_angle, joint03_rate, joints or all, or of a camera side.tip"
            )
        if channel.kind != "mark_pixel" and (channel.index or 1) > count:
            part = "link" if channel.kind.startswith("link") else "joint"
            raise InputError(
                f"--channels {name!r} is of {part} {channel.index}, but the arm has {count} links: "
                "correct the number, or simulate a longer arm"
            )
    return list(dict.fromkeys(names))
