"""A run that is still to be recorded."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..runs import Run


def planned(
    times: Any,
    inputs: dict[str, Any],
    *,
    links: int = 20,
    channels: Sequence[str] | None = None,
    definition: dict[str, Any] | None = None,
    name: str = "planned",
) -> Run:
    """A run of an arm that is still to be recorded: what will be commanded, and when.

    Arguments:
        times: of the samples, s, shape (sample,).
        inputs: what drives the arm, by channel (`joint01_command`), SI, each (sample,).
        links: number of links of the arm, unless the definition states it.
        channels: what will be recorded; the positions of all links by default.
        definition: what a sidecar would say.
        name: of the run.

    Returns:
        The run; the channels to be recorded are 0.
    """
    definition = dict(definition or {})
    arm = {"links": links, **definition.get("arm", {})}
    every = [f"link{i:02d}_{axis}" for i in range(1, arm["links"] + 1) for axis in "xyz"]
    blank = {channel: np.zeros(len(np.asarray(times))) for channel in channels or every}
    return Run.from_arrays(
        times, {**inputs, **blank}, name=name, definition={**definition, "arm": arm}
    )
