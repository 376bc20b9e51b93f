"""Check columns by themselves: units, lost cells, glitches, second recordings, time stamps.

Each check is a function that reports features so rarely correct that a person should look at them.
No value is changed. Thresholds are far from the values of correct recordings, and are defined next
to their checks.
"""

import dataclasses
import shlex
from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.text import InputError
from ..schema import (
    BASE,
    DEFAULT_PRESET,
    JOINTS,
    LINKS,
    ArmSection,
    CamerasSection,
)
from ._channels import Channel, parse_columns
from ._run import Run
from ._table import column_names

Values = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Oddity:
    """A feature that is rare in a correct recording.

    Attributes:
        code: probable kind of mistake: "units", "signs", "labels", "frame", "command",
            "lost cells", "glitches", "wrap", "take", "time", "start", "constants" or "noise".
        sentence: description of the feature, its location, and its probable cause.
        remedy: an edit or an option that corrects the probable mistake.
        channels: names of the channels with the feature.
        rows: first samples with the feature, numbered as in messages; at most ten.
    """

    code: str
    sentence: str
    remedy: str
    channels: tuple[str, ...] = ()
    rows: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.sentence}: {self.remedy}"


wrong_unit = partial(Oddity, "units")


class Cells(NamedTuple):
    """The measured cells of a channel."""

    channel: Channel
    values: Values
    rows: Rows
    step: float  # median absolute difference between consecutive cells
    noise: float  # standard deviation of white noise from second differences, robust to a few steps

    @property
    def span(self) -> float:
        return float(np.ptp(self.values))


_FEW = 8
_SAMPLED = 20_000  # approximate number of cells that suffices for a median


def _typical(values: Values) -> float:
    """Return the median absolute value, from a subset of about `_SAMPLED` values."""
    part = values[:: max(len(values) // _SAMPLED, 1)]
    return float(np.median(np.abs(part))) if len(part) else 0.0


class Look:
    """A run with cached quantities that several checks use."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.naming = run.naming
        self.times = run.times

    def at(self, rows: Sequence[int] | Rows) -> str:
        """Return `row 7` or `rows 7, 9, 12, 15, 18 and 40 more`."""
        shown = [self.naming.at(row).rpartition(" ")[2] for row in rows[:5]]
        more = f" and {len(rows) - 5} more" if len(rows) > 5 else ""
        return f"{self.naming.row}{'s' * (len(rows) > 1)} {', '.join(shown)}{more}"

    def numbers(self, rows: Sequence[int] | Rows) -> tuple[int, ...]:
        return tuple(int(row) + self.naming.first_row for row in rows[:10])

    def of(self, channel: Channel) -> str:
        return self.naming.of(channel)

    def cells(self, count: int, cells: Cells) -> str:
        """Return text such as `2 cells of column x_deg are`."""
        some = count > 1
        return f"{count} cell{'s' * some} of {self.of(cells.channel)} {'are' if some else 'is'}"

    @cached_property
    def measured(self) -> dict[str, Cells]:
        """Measured numeric channels with more than a few cells."""
        found = {}
        for name in self.run.values:
            channel = self.run.channels[name]
            if channel.quantity == "text" or channel.kind not in self.run.kind.outputs:
                continue
            values = self.run.values[name]
            there = ~np.isnan(values)
            rows = np.flatnonzero(there)
            values = values[there]
            if len(rows) >= _FEW:
                noise = 1.4826 * _typical(np.diff(values, 2)) / np.sqrt(6)
                found[name] = Cells(channel, values, rows, _typical(np.diff(values)), noise)
        return found

    def section(self, of: Any) -> Any:
        return self.run.definition.section(of)

    @cached_property
    def still(self) -> int:
        """Number of first rows without a command change; 1 if the arm moves from the first row."""
        inputs = {n: v for n, v in self.run.commands.items() if v.dtype != object}
        moved = [np.flatnonzero(values != values[0])[:1] for values in inputs.values()]
        # A joint that is commanded away from zero in the first row moves from that row on.
        steps = any(
            self.run.channels[name].kind == "joint_command"
            and abs(values[0]) > 0.05 * np.max(np.abs(values))
            for name, values in inputs.items()
        )
        return 1 if steps else int(min((each[0] for each in moved if each.size), default=1))


# Cells: values that mark missing data, glitches, and angles that wrap.

_STANDS_FOR_NOTHING = (99, 999, 9999, 99999, 999999, 32767, 32768, 65535, 8888, 7777)
_IMPULSIVE = ("acceleration", "angular_velocity")  # an impact can change a single cell of these
_FAR = 3.0  # minimum distance of a marker value from the others, in units of their range


def sentinels(look: Look) -> Iterator[Oddity]:
    """Report extreme values such as -9999, or repeated isolated ones, far from all others."""
    for name, cells in look.measured.items():
        for value in (np.min(cells.values), np.max(cells.values)):
            here = cells.values == value
            count, rest = int(np.count_nonzero(here)), cells.values[~here]
            recorded = round(float(cells.channel.from_si(value)), 6)
            known = abs(recorded) in _STANDS_FOR_NOTHING
            # Consecutive equal values can be a state of rest or the limit of a sensor.
            apart = value != 0 and not (here[0] or here[-1] or np.any(here[1:] & here[:-1]))
            apart = apart and cells.channel.quantity not in _IMPULSIVE
            if len(rest) < _FEW or not (known or (count > 1 and apart)):
                continue
            span = float(np.ptp(rest))
            away = float(np.min(np.abs(rest - value)))
            if span > 0 and away > _FAR * span:
                rows, unit = cells.rows[here], cells.channel.unit
                yield Oddity(
                    "lost cells",
                    f"{look.cells(count, cells)} {recorded:g}{' ' * bool(unit)}{unit}, "
                    f"which differs from the other values by {away / span:.2g} times their range "
                    f"or more ({look.at(rows)}), and may mark missing values",
                    "empty these cells",
                    (name,),
                    look.numbers(rows),
                )


_LEFT_OUT = 8.0  # minimum size of the neighbours of a lost zero, in units of the typical step


def zeros(look: Look) -> Iterator[Oddity]:
    """Report exact zeros between cells that are far from zero."""
    for name, cells in look.measured.items():
        zero = cells.values == 0
        if not zero.any() or np.count_nonzero(zero) > len(zero) / 2:
            continue
        edges = np.diff(zero.astype(np.int8), prepend=0, append=0)
        first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        inner = (first > 0) & (last < len(zero))
        first, last = first[inner], last[inner]
        before, after = cells.values[first - 1], cells.values[last]
        others = np.abs(cells.values[~zero])
        least = np.minimum(np.abs(before), np.abs(after))
        lost = (before * after > 0) & (least > 3 * np.abs(after - before))
        lost &= least > max(_LEFT_OUT * cells.step, 3 * float(np.min(others)), 0.05 * cells.span)
        if lost.any():
            parts = [np.arange(a, b) for a, b in zip(first[lost], last[lost], strict=True)]
            rows = cells.rows[np.concatenate(parts)]
            yield Oddity(
                "lost cells",
                f"{look.cells(len(rows), cells)} exactly 0 between values far from 0 "
                f"({look.at(rows)}), and may mark missing values",
                "empty these cells",
                (name,),
                look.numbers(rows),
            )


_JUMP = 1.0  # maximum difference between a jump and a whole turn, rad


def wraps(look: Look) -> Iterator[Oddity]:
    """Report angles that jump by a whole turn."""
    for name, values in look.run.values.items():
        channel = look.run.channels[name]
        if channel.quantity != "angle":
            continue
        rows = np.flatnonzero(~np.isnan(values))
        steps = np.abs(np.abs(np.diff(values[rows])) - 2 * np.pi) < _JUMP
        if steps.any():
            where = rows[1:][steps]
            turn = "360 deg" if channel.unit == "deg" else "2 pi"
            yield Oddity(
                "wrap",
                f"{look.of(channel)} jumps by about {turn} in {look.at(where)}, as a wrapped angle "
                "does",
                f"unwrap it by adding or subtracting {turn} from there on (numpy.unwrap)",
                (name,),
                look.numbers(where),
            )


_BEYOND = 4.0  # distance of a glitch from its neighbours: this many times their spread ...
_SIGMAS = 12.0  # ... plus this many standard deviations of the noise
_AROUND = np.array([-4, -3, -2, -1, 1, 2, 3, 4])


def glitches(look: Look) -> Iterator[Oddity]:
    """Report single cells far from the cells around them, which are close to each other."""
    for name, cells in look.measured.items():
        if cells.channel.quantity in _IMPULSIVE:
            continue
        # Zeros are reported as lost cells, if at all.
        keep = cells.values != 0
        values, rows, floor = cells.values[keep], cells.rows[keep], _SIGMAS * cells.noise
        jumps = np.flatnonzero(np.abs(np.diff(values)) > max(floor, 0.05 * cells.span))
        if len(jumps) > 0.2 * len(values):
            continue
        places = np.unique(np.concatenate([jumps, jumps + 1]))
        places = places[(places >= 4) & (places < len(values) - 4)]
        around = np.sort(values[places[:, None] + _AROUND], axis=1)
        # Ignore the lowest and the highest neighbour, because these may be glitches, too.
        low, high = around[:, 1], around[:, -2]
        beyond = np.maximum(low - values[places], values[places] - high)
        odd = places[beyond > np.maximum(_BEYOND * (high - low) + floor, 0.05 * cells.span)]
        extreme = (np.min(values, initial=0), np.max(values, initial=0))
        recorded = np.round(np.abs(cells.channel.from_si(values[odd])), 6)
        odd = odd[~(np.isin(recorded, _STANDS_FOR_NOTHING) & np.isin(values[odd], extreme))]
        if not odd.size:
            continue
        rows = rows[odd]
        yield Oddity(
            "glitches",
            f"{look.of(cells.channel)} differs strongly from neighbouring cells in "
            f"{look.at(rows)}, probably because of "
            f"{'glitches' if len(rows) > 1 else 'a glitch'} in the recording",
            "empty these cells, or fit with --loss student_t, which is robust to outliers",
            (name,),
            look.numbers(rows),
        )


# Time: second recordings in a file, time stamps.


def takes(look: Look) -> Iterator[Oddity]:
    """Report a row where all channels return to their first values and the motion starts again."""
    moving = [
        c for c in look.measured.values() if len(c.values) > 3 * _FEW and c.span > 20 * c.noise
    ]
    if look.times is None or not moving:
        return
    common: set[int] | None = None
    jumped: list[set[int]] = []
    for each in moving:
        x, rows = each.values, each.rows
        steps = np.diff(x)
        # Difference of a step from the mean of its neighbours, which is small in smooth motion.
        off = np.zeros(len(steps))
        off[1:-1] = np.abs(steps[1:-1] - (steps[:-2] + steps[2:]) / 2)
        low, high = np.quantile(x[:: max(len(x) // _SAMPLED, 1)], [0.02, 0.98])
        enough = max(10 * _typical(np.diff(x, 2)), 0.1 * float(high - low))
        jumps = np.flatnonzero((off > enough) & (np.abs(steps) > enough))[: 4 * _FEW] + 1
        if each.channel.quantity == "angle":
            jumps = jumps[np.abs(np.abs(steps[jumps - 1]) - 2 * np.pi) > _JUMP]
        jumps = jumps[jumps < len(x) - _FEW]
        near = max(0.1 * float(high - low), 5 * each.noise)
        again = np.abs(x[jumps[:, None] + np.arange(_FEW)] - x[:_FEW]).max(axis=1, initial=0) < near
        jumped.append(set(rows[jumps].tolist()))
        found = set(rows[jumps[again]].tolist())
        common = found if common is None else common & found
    inputs = [v for v in look.run.commands.values() if v.dtype != object and np.ptp(v) > 0]
    # A measurement cannot follow a command jump within the same row. If measurements jump together
    # with commands elsewhere as well, such a jump does not indicate a second recording.
    large = [np.flatnonzero(np.abs(np.diff(v)) > 0.05 * np.ptp(v)) + 1 for v in inputs]
    elsewhere = {int(row) for rows in large for row in rows} - (common or set())
    follows = bool(elsewhere.intersection(*jumped))
    begins = any(np.ptp(each.values[: 5 * _FEW]) > 10 * each.noise for each in moving)
    paces = np.diff(look.times)

    def begins_again(row: int) -> bool:
        leaps = bool(paces[row - 1] > 3 * np.median(paces))
        if not inputs:
            return begins or leaps
        n = 1 if leaps else min(look.still + _FEW, len(paces) + 1 - row)
        same = (np.abs(v[row : row + n] - v[:n]).max() <= 1e-3 * np.ptp(v) for v in inputs)
        back = any(abs(v[row - 1] - v[0]) > 0.05 * np.ptp(v) for v in inputs)
        return all(same) and back and (leaps or (n > look.still and not follows))

    at = [row for row in sorted(common or ()) if begins_again(row)]
    if at:
        yield Oddity(
            "take",
            f"all recorded values simultaneously return to their first values in {look.at(at)}, so "
            "a second recording seems to start there",
            "split the file there, and give both parts with --data",
            tuple(each.channel.name for each in moving),
            look.numbers(at),
        )


# Consecutive time steps that differ by a larger factor are reported. The factor is slightly less
# than 1000, the change from ms to s, because time stamps are rounded.
_LEAP = 990.0


def leaps(look: Look) -> Iterator[Oddity]:
    """Report a change of the time step by a factor of 1000: ms among s, or a gap."""
    if look.times is None:
        return
    steps = np.diff(look.times)
    changes = np.abs(np.diff(np.log10(steps))) > np.log10(_LEAP)
    if not changes.any():
        return
    at = np.flatnonzero(changes)
    again = len(at) - 1
    more = f", and {again} more time{'s' * (again > 1)} after it" if again else ""
    yield Oddity(
        "time",
        f"the time step changes from {steps[at[0]]:.3g} s to {steps[at[0] + 1]:.3g} s in "
        # The second of the two steps ends two samples after the start of the first one.
        f"{look.at(at[:1] + 2)}{more}",
        "check the unit of the time stamps, and whether rows are missing",
        rows=look.numbers(at + 2),
    )


def stamps(look: Look) -> Iterator[Oddity]:
    """Report frame numbers or milliseconds that are given as seconds."""
    times = look.times
    if times is None or not look.run.kind.timed or len(times) < 5 * _FEW:
        return
    steps = np.diff(times)
    middle = float(np.median(steps))
    counted = np.all(times == np.round(times)) and middle == 1.0 and np.ptp(steps) <= 1
    if counted and (_is_filmed(look) or _swings_faster(look, 5 * middle)):
        yield Oddity(
            "time",
            f"the time stamps are {times[0]:g}, {times[1]:g}, {times[2]:g} s and so on to "
            f"{times[-1]:g} s, like frame numbers",
            "if they are frame numbers, divide time_s by the frame rate of the camera",
        )
    elif middle < 5e-5 or (middle > 5.0 and _turns_back(look)):
        off, by = (
            ("milliseconds", "time_s=time_ms") if middle > 5 else ("seconds", "time_ms=time_s")
        )
        yield wrong_unit(
            f"the rows are {middle:.3g} s apart, which is an unusual sampling interval, so the "
            f"time stamps may be {off}",
            f"--rename {by}, if this is the case",
        )


def _is_filmed(look: Look) -> bool:
    return any(cells.channel.quantity == "pixel" for cells in look.measured.values())


def _swings_faster(look: Look, period: float) -> bool:
    """Return whether the data are smooth although the arm swings faster than `period` (s)."""
    section = look.section(ArmSection) if look.run.model == "arm" else None
    if section is None or look.run.commands or is_balanced(section):
        return False
    known, count = arm_values(section), number_of_links(look)
    gravity = known.get(BASE.gravity.path, 9.81 if section.preset == "pendulum" else 0.0)
    if count is None or LINKS.length.path not in known or not np.any(gravity):
        return False
    reach = float(np.sum(np.broadcast_to(known[LINKS.length.path], (count,))))
    slow = 2 * np.pi * np.sqrt(2 * reach / (3 * float(np.max(np.abs(gravity))))) < period
    return slow and any(
        cells.step < 0.5 * _typical(cells.values - np.median(cells.values))
        for cells in look.measured.values()
    )


def falls(look: Look) -> Iterator[Oddity]:
    """Report an output that decreases with its input, as in none of these hysteresis models."""
    if look.run.model != "hysteresis" or len(look.run.commands) != 1:
        return
    (driven,) = look.run.commands.values()
    for name, cells in look.measured.items():
        inputs = driven[cells.rows]
        if not (np.ptp(inputs) > 0 and cells.span > 0):
            continue
        if np.corrcoef(inputs, cells.values)[0, 1] < -0.3:
            yield Oddity(
                "signs",
                f"{look.of(cells.channel)} decreases where its input increases",
                _turned(look, name),
                (name,),
            )


def _turned(look: Look, name: str) -> str:
    """Describe how to change the sign of a channel; for a CSV file this is a command."""
    path = look.run.path
    if path is None or path.suffix.lower() != ".csv":
        return f"change the sign of {name}"
    does = f"giajax import {shlex.quote(str(path))} --flip {name} --to turned.csv"
    try:
        parse_columns(column_names(path))
    except InputError:
        does += ", with the same --rename"
    if path.with_suffix(".toml").exists():
        less = "" if look.run.definition.sha256 is None else " without its sha256"
        does += f", and copy {path.stem}.toml to turned.toml{less}"
    return does


def _turns_back(look: Look) -> bool:
    """Return whether the arm reverses while no command changes, unlike creep or a leak."""
    if look.run.model != "arm":
        return False
    inputs = [v for v in look.run.commands.values() if v.dtype != object]
    changes = [np.flatnonzero(np.diff(v)) + 1 for v in inputs]
    since = max((int(rows[-1]) for rows in changes if rows.size), default=0)
    for cells in look.measured.values():
        x = cells.values[cells.rows >= since]
        x = np.median(x[: len(x) // 5 * 5].reshape(-1, 5), axis=1)
        up = np.max(x - np.minimum.accumulate(x), initial=0.0)
        down = np.max(np.maximum.accumulate(x) - x, initial=0.0)
        if min(up, down) > max(0.15 * cells.span, 6 * cells.noise):
            return True
    return False


# Checks of magnitudes.

TURN = 1.1 * np.pi  # rad: commands and muscles do not bend a joint by more than half a turn
_RATE = 60.0  # rad/s: neither an arm nor a pendulum longer than a few cm moves so fast


def magnitudes(look: Look) -> Iterator[Oddity]:
    """Report ratios above 1, angles of many turns, pixels outside the image, accelerations in g."""
    arm = look.run.model == "arm"
    cameras = look.section(CamerasSection).named() if arm else {}
    shortened: dict[str, list[Values]] = {}
    for name, channel in look.run.channels.items():
        values = look.run.values[name]
        if channel.quantity == "text":
            continue
        most = float(np.nanmax(np.abs(values)))
        shown = f"{look.of(channel)} reaches {channel.from_si(most):.4g}"
        if channel.quantity == "ratio" and channel.kind == "contraction" and most > 1:
            yield wrong_unit(
                f"{shown}, but a contraction is a fraction of the length, so the values may be "
                "in percent",
                "divide the column by 100",
                (name,),
            )
        elif channel.quantity == "angle" and look.run.model in ("arm", "joint"):
            if channel.kind in look.run.kind.outputs:
                cells = look.measured.get(name)
                if cells is None or look.times is None:
                    continue
                pace = np.diff(cells.values) / np.diff(look.times[cells.rows])
                beyond = bool(most > 2 * np.pi and np.quantile(np.abs(pace), 0.8) > _RATE)
            else:
                beyond = most > TURN
            if beyond:
                degrees = channel.unit == "rad"
                said = "be in degrees" if degrees else "have been converted twice"
                renamed = f"--rename {channel.column}={name}_deg, if this is the case"
                yield wrong_unit(
                    f"{look.of(channel)} reaches {np.rad2deg(most):.4g} deg, or changes faster "
                    f"than an arm can turn, so the values may {said}",
                    renamed if degrees else "convert the values",
                    (name,),
                )
        elif channel.quantity == "pixel":
            camera = cameras.get(channel.camera or "main") or (
                next(iter(cameras.values())) if len(cameras) == 1 else None
            )
            size = None if camera is None else camera.size_px
            usual = float(np.nanquantile(np.abs(values), 0.9))
            if size and usual > 1.2 * size[channel.component or 0]:
                yield wrong_unit(
                    f"{shown} px, but the image has {size[channel.component or 0]} px, so the "
                    "pixel coordinates may refer to an image of another size",
                    "correct size_px in [camera.NAME], or the columns",
                    (name,),
                )
        elif channel.quantity == "acceleration":
            shortened.setdefault(name.rpartition("_")[0], []).append(values)
    for name, parts in shortened.items():
        size = float(np.nanmedian(np.sqrt(np.sum(np.square(parts), axis=0))))
        if len(parts) == 3 and 0.9 < size < 1.1:
            yield wrong_unit(
                f"{name} has a median magnitude of {size:.3g} m/s^2, but 9.81 is expected at rest, "
                "so the values may be in g",
                "multiply its columns by 9.81",
                (name,),
            )


_TOO_QUIET = 8.0  # minimum ratio of the stated noise to the estimated noise


def noise_too_small(look: Look) -> Iterator[Oddity]:
    """Report channels whose noise is much smaller than stated."""
    for name, cells in look.measured.items():
        stated = look.run.noise(name)
        if (
            look.times is None
            or not stated
            or look.run.correlated_noise(name)
            or len(cells.values) < 4 * _FEW
        ):
            continue
        # Fourth and sixth differences remove smooth motion. For white noise both estimates agree.
        seen, other = (
            float(np.sqrt(np.mean(np.diff(cells.values[:_SAMPLED], order) ** 2) / size))
            for order, size in ((4, 70), (6, 924))
        )
        if 1e-3 * stated < seen < stated / _TOO_QUIET and 0.7 < other / seen < 1.4:
            factor = stated / seen
            angle = cells.channel.quantity == "angle" and 30 < factor < 110
            unit = "the values may be in rad, " if angle and cells.channel.unit == "deg" else ""
            yield Oddity(
                "units" if unit else "noise",
                f"the stated noise of {look.of(cells.channel)} is {factor:.2g} times the noise "
                f"estimated from its cells, so {unit}{'or ' * bool(unit)}the stated noise is too "
                "large",
                (f"--rename {cells.channel.column}={name}_rad, or " if unit else "")
                + "correct [noise]",
                (name,),
            )


# Known constants of an arm.

PAPER = (None, DEFAULT_PRESET, "takeichi_20m_full")  # presets of the arm in the paper


def is_balanced(section: ArmSection) -> bool:
    return bool(section.buoyancy or section.trim or section.preset == "takeichi_20m_full")


def arm_values(section: ArmSection) -> dict[str, Values]:
    """Return constants by path, SI: those that are stated, and those of presets of the paper."""
    known = {**section.values()}
    for path, value in (section.parameters or {}).items():
        known[path] = np.asarray(value, dtype=float)
    if section.preset in PAPER:
        for each in (LINKS.length, LINKS.diameter, LINKS.mass, JOINTS.pitch_stiffness):
            known.setdefault(each.path, np.asarray(each.default, dtype=float))
    return known


def number_of_links(look: Look) -> int | None:
    section = look.section(ArmSection)
    if section.links is not None:
        return int(section.links)
    if section.preset in PAPER:
        return 20
    return next((len(value) for value in section.lists().values()), None)
