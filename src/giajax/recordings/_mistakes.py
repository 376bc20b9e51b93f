"""Common mistakes in columns: one list for the checks of recordings and for the suspects."""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np

from ._channels import Channel
from ._plausible_columns import TURN, Look, number_of_links
from ._run import Run

_AXES = "xyz"
_DEGREES = float(np.rad2deg(1.0))  # degrees per radian
_MOST_JOINTS = 40  # limit on the candidate joints of a command, because each takes a simulation


MistakeKind = Literal["axes", "exchanged", "numbers", "lengths", "angles", "commands"]


@dataclasses.dataclass(frozen=True)
class Mistake:
    """A mistake in the names or units of columns.

    Attributes:
        code: code of the `Oddity`: "units", "signs", "labels" or "command".
        words: description of the mistake, such as `y and z swapped`.
        remedy: an edit or an option that corrects it.
        sources: channel name -> the channel that its column really contains, and the factor by
            which the column differs from that channel.
        kind: the axes of positions, two exchanged points, the numbers of links, the unit of
            positions or of joint angles, or commands.
    """

    code: str
    words: str
    remedy: str
    sources: Mapping[str, tuple[str, float]]
    kind: MistakeKind

    @property
    def name(self) -> str:
        """Name of the mistake as a suspect: `axes: y and z swapped`."""
        return f"{'axes' if self.kind == 'axes' else 'columns'}: {self.words}"

    def undone(self, run: Run) -> Run:
        """Return the run with the mistake corrected."""
        there = {name: of for name, of in self.sources.items() if name in run.values}
        kept = {name: values for name, values in run.values.items() if name not in there}
        values = kept | {of: run.values[name] / times for name, (of, times) in there.items()}
        channels = {
            of: run.channels[name] if of == name else Channel.named(of, run.channels[name].unit)
            for name, (of, _) in there.items()
        }
        others = {name: run.channels[name] for name in kept}
        observed = run.observed
        if observed is not None:
            observed = tuple(there.get(name, (name, 1.0))[0] for name in observed)
        return dataclasses.replace(
            run, values=values, channels=others | channels, observed=observed
        )


def mistakes(runs: Sequence[Run], links: int | None = None) -> list[Mistake]:
    """Return the mistakes that can affect these runs, within each kind the smallest change first.

    Arguments:
        runs: runs of one or more experiments.
        links: number of links of the arm, if it differs from that in the runs.

    Example:
        >>> import giajax
        >>> falling = {"model": "arm", "free_motion": True}
        >>> values = {"link01_z": [0.0, 0.1]}
        >>> run = giajax.Run.from_arrays([0.0, 1.0], values, definition=falling)
        >>> [m.name for m in giajax.recordings.mistakes([run]) if m.kind == "axes"][:2]
        ['axes: z reversed', 'axes: x and z swapped']
    """
    measured = {name: run.channels[name] for run in runs for name in run.observations}
    given = {
        name: run.channels[name]
        for run in runs
        for name in run.commands
        if run.channels[name].kind == "joint_command"
    }
    sizes = {
        name: max(np.max(np.abs(run.commands[name])) for run in runs if name in run.commands)
        for name in given
    }
    sizes = {name: float(size) for name, size in sizes.items() if size > 0}
    commands = {name: given[name] for name in sizes}
    counts = {number_of_links(Look(run)) for run in runs if run.model == "arm"}
    count = counts.pop() if len(counts) == 1 else None
    if links is not None and count is not None:
        count = links
    return [
        *(
            each
            for each in _units(commands, "commands")
            # A joint command never exceeds about half a turn.
            if all(most <= TURN * each.sources[name][1] for name, most in sizes.items())
        ),
        *_units({n: c for n, c in measured.items() if c.kind == "joint_angle"}, "angles"),
        *_lengths(measured),
        *_axes(measured, every=count is not None),
        *_labels(measured, count),
        *_commands(commands, given, count),
    ]


def point_of(channel: Channel) -> str | None:
    """Return the recorded point of a coordinate, such as `link06`; None for other channels."""
    if channel.component is None or channel.quantity != "length":
        return None
    return channel.name.removesuffix(f"_{_AXES[channel.component]}")


def _units(angles: Mapping[str, Channel], kind: MistakeKind) -> Iterator[Mistake]:
    units = {channel.unit for channel in angles.values()}
    for wrong, unit, times in (("deg", "rad", 1 / _DEGREES), ("rad", "deg", _DEGREES)):
        if units == {wrong}:
            name = next(iter(angles))
            yield Mistake(
                "units",
                f"the {'joint ' * (kind == 'angles')}{kind} in {unit}",
                f"--rename {name}_{wrong}={name}_{unit}, and rename the others in the same way",
                {name: (name, times) for name in angles},
                kind,
            )


def _lengths(measured: Mapping[str, Channel]) -> Iterator[Mistake]:
    positions = [name for name, channel in measured.items() if point_of(channel)]
    units = {measured[name].unit for name in positions}
    for wrong, unit, times in (("m", "mm", 1e3), ("m", "cm", 1e2), ("mm", "m", 1e-3)):
        if units == {wrong}:
            name = positions[0]
            yield Mistake(
                "units",
                f"the positions in {unit}",
                f"--rename {name}_{wrong}={name}_{unit}, and rename the others in the same way",
                {each: (each, times) for each in positions},
                "lengths",
            )


def _axes(measured: Mapping[str, Channel], *, every: bool) -> Iterator[Mistake]:
    """Yield permutations and sign changes of axes that affect the recorded coordinates.

    A single recorded axis of an arm may really be any of the three axes. For other models only the
    recorded axes are permuted.
    """
    points = {name: point for name, each in measured.items() if (point := point_of(each))}
    axis = {name: measured[name].component or 0 for name in points}
    here = sorted(set(axis.values()))
    orders = itertools.permutations(range(3) if every or len(here) > 1 else here, len(here))
    signs = itertools.product((1, -1), repeat=len(here))
    ways = [
        dict(zip(here, zip(order, sign, strict=True), strict=True))
        for order, sign in itertools.product(orders, signs)
    ]

    def changes(way: Mapping[int, tuple[int, int]]) -> tuple[int, int]:
        moved = sum(of != c for c, (of, _) in way.items())
        return moved + sum(sign < 0 for _, sign in way.values()), moved

    # The first candidate changes nothing.
    for way in sorted(ways, key=changes)[1:]:
        moved = [c for c, (of, _) in way.items() if of != c]
        turned = [_AXES[c] for c, (_, sign) in way.items() if sign < 0]
        both = {frozenset((c, way[c][0])) for c in moved}
        if not moved:
            words = f"{' and '.join(turned)} reversed"
        elif len(both) == 1 and not turned:
            words = f"{' and '.join(_AXES[c] for c in sorted(*both))} swapped"
        else:
            words = "recorded " + ", ".join(
                f"{_AXES[c]} is {'-' * (sign < 0)}{_AXES[of]}"
                for c, (of, sign) in way.items()
                if (of, sign) != (c, 1)
            )
        remedies = ["correct the axes in the names of the columns (--rename)"] if moved else []
        remedies += ["change the sign of these columns"] if turned else []
        sources = {
            name: (f"{point}_{_AXES[way[axis[name]][0]]}", float(way[axis[name]][1]))
            for name, point in points.items()
        }
        code = "labels" if moved else "signs"
        yield Mistake(code, words, " and ".join(remedies), sources, "axes")


def _labels(measured: Mapping[str, Channel], count: int | None) -> Iterator[Mistake]:
    """Yield other numberings of the links: two exchanged, shifted by one, or from the tip."""
    places: dict[str, list[Channel]] = {}
    for channel in measured.values():
        if channel.kind in ("link_position", "tip_position"):
            places.setdefault(point_of(channel) or "", []).append(channel)
    numbers = {name: each[0].index for name, each in places.items()}

    def called(words: str, names: Mapping[str, str], kind: MistakeKind = "numbers") -> Mistake:
        sources = {
            channel.name: (f"{other}_{_AXES[channel.component or 0]}", 1.0)
            for name, other in names.items()
            for channel in places[name]
        }
        remedy = "correct the numbers in the names of the columns (--rename)"
        return Mistake("labels", words, remedy, sources, kind)

    for one, other in itertools.combinations(sorted(places), 2):
        yield called(f"{one} and {other} exchanged", {one: other, other: one}, "exchanged")
    links = {name: number for name, number in numbers.items() if number is not None}
    if not links or count is None:
        return
    for by in (-1, 1):
        if min(links.values()) + by >= 1 and max(links.values()) + by <= count:
            moved = {name: f"link{number + by:02d}" for name, number in links.items()}
            yield called(f"the link numbers shifted by {-by}", moved)
    from_tip = {name: f"link{count + 1 - number:02d}" for name, number in links.items()}
    yield called("the links numbered from the tip", from_tip)


def _commands(
    commands: Mapping[str, Channel], given: Mapping[str, Channel], count: int | None
) -> Iterator[Mistake]:
    """Yield opposite signs of commands, and commands that belong to other joints.

    Only commands that change are reassigned, to any joint. If that joint has a command, the two
    are exchanged.
    """
    for name, channel in commands.items():
        yield Mistake(
            "signs",
            f"{name} with the opposite sign",
            f"change the sign of the column of {name}",
            {name: (name, -1.0)},
            "commands",
        )
        for other in range(1, min(count or 0, _MOST_JOINTS) + 1):
            if other == channel.index:
                continue
            new = f"joint{other:02d}_command"
            sources, remedy = {name: (new, 1.0)}, f"--rename {channel.column}={new}_{channel.unit}"
            if new in given:
                sources[new] = (name, 1.0)
                remedy += f" --rename {given[new].column}={name}_{given[new].unit}"
            yield Mistake("command", f"{name} that of joint {other}", remedy, sources, "commands")
