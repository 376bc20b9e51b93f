"""What a fit takes of a recorded run: some of its channels, and windows of it in time."""

import dataclasses
import itertools
import re
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..kinds import InitialSection
from ._channels import Channel
from ._column_table import match_name
from ._run import Run

_LINK_ANGLE = re.compile(r"link([0-9]{1,4})_angle")


def selected(
    runs: Sequence[Run],
    channels: Sequence[str] | None,
    window_s: float | None,
    beside: Sequence[Run] = (),
) -> list[Run]:
    """The runs of a fit with these channels, in windows.

    Of runs of several models each has those of the channels that are its model's, and those
    without an initial state stay whole.

    Arguments:
        runs: as they were read.
        channels: names without unit; None for all that were measured.
        window_s: length of a window, s; None for whole runs.
        beside: further runs that the same is asked of.

    Raises:
        InputError: as `observing` and `windows`, or a channel that none of them measures.
    """
    everything = [*runs, *beside]
    several = len({run.model for run in everything}) > 1
    for name in channels or () if several else ():
        if not any(_may_hold(run, name) for run in everything):
            raise InputError(
                f"'{name}' is no channel that these runs are compared in: choose among "
                f"{', '.join(dict.fromkeys(c for run in everything for c in run.observations))}"
            )
    chosen = list(runs)
    for index, run in enumerate(runs if channels is not None else ()):
        names = [name for name in channels or () if not several or _may_hold(run, name)]
        chosen[index] = observing(run, names) if names else run
    if window_s is None:
        return chosen
    parts = [[run] if several and not _has_state(run) else windows(run, window_s) for run in chosen]
    return list(itertools.chain.from_iterable(parts))


def _may_hold(run: Run, name: str) -> bool:
    """Whether a channel of this name is one that the run's model predicts."""
    row = match_name(name)
    return row is not None and row.kind in run.kind.outputs


def _has_state(run: Run) -> bool:
    return InitialSection in run.kind.run_sections.values()


def observing(run: Run, channels: Sequence[str]) -> Run:
    """The run with only these channels to be compared with a prediction.

    The other channels stay in the run, and may give its initial state.

    Arguments:
        run: the run.
        channels: names without unit. `linkNN_angle`, the absolute angle of a link in a plane, is
            made from the joint angles up to it where it is not recorded.

    Raises:
        InputError: a channel that the run does not have and that cannot be made, or one that the
            model does not predict.
    """
    values, known = dict(run.values), dict(run.channels)
    for name in channels:
        if name not in values:
            values[name], known[name] = _link_angle(run, name)
    selected = dataclasses.replace(run, values=values, channels=known, observed=tuple(channels))
    for name in channels:
        if name not in selected.observations:
            raise InputError(
                f"'{name}' of '{run.name}' drives the model, which does not predict it: "
                "name another channel"
            )
    return selected


def _link_angle(run: Run, name: str) -> tuple[np.ndarray, Channel]:
    match = _LINK_ANGLE.fullmatch(name)
    joints = [f"joint{joint:02d}_angle" for joint in range(1, int(match[1]) + 1)] if match else []
    if not joints or any(joint not in run.values for joint in joints):
        measured = ", ".join(run.observations) or "none"
        raise InputError(
            f"'{run.name}' has no channel '{name}': choose among its measured ones: {measured}"
        )
    total = np.sum([run.values[joint] for joint in joints], axis=0)
    total.setflags(write=False)
    return total, Channel.named(name, run.channels[joints[0]].unit)


def windows(run: Run, length: float) -> list[Run]:
    """The run cut into windows of a length (s), one after the other.

    Each starts at its own initial state, which makes one long or chaotic recording into several
    short ones (multiple shooting). A remainder shorter than half a window is left out.

    Raises:
        InputError: the run has no initial state, or its sidecar states one that would be that of
            every window, or a window would hold fewer than four samples or none of a channel.
    """
    if run.times is None or not _has_state(run):
        raise InputError(
            f"'{run.name}' cannot be cut into windows, because a run of the {run.model} model has "
            "no initial state: leave out the windows"
        )
    if not run.definition.section(InitialSection).first_row:
        raise InputError(
            f"'{run.name}' cannot be cut into windows, because each needs its own initial state: "
            "say first_row = true in [initial]"
        )
    count = max(np.floor((run.times[-1] - run.times[0]) / length + 0.5), 1)
    if 4 * count > len(run.times):
        raise _too_short(run, length)
    edges = run.times[0] + length * np.arange(int(count) + 1)
    rows = np.searchsorted(run.times, edges - 1e-9 * length)
    if np.min(np.diff(rows)) < 4:
        raise _too_short(run, length)
    parts = [
        rows_of(run, slice(first, last), f"{run.name} {run.times[first] - run.times[0]:.4g} s")
        for first, last in itertools.pairwise(rows)
    ]
    for part in parts:
        for channel, values in part.observations.items():
            if np.all(np.isnan(values)):
                raise InputError(
                    f"the window '{part.name}' has no value of {channel}: make windows longer, or "
                    "leave the channel out"
                )
    return parts


def rows_of(run: Run, rows: slice, name: str) -> Run:
    """Some rows of a run with times, as a run of another name."""
    return dataclasses.replace(
        run,
        name=name,
        times=None if run.times is None else run.times[rows],
        values={channel: column[rows] for channel, column in run.values.items()},
    )


def _too_short(run: Run, length: float) -> InputError:
    return InputError(
        f"a window of {length:g} s of '{run.name}' holds fewer than 4 samples: make it longer"
    )
