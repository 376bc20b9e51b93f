"""What is odd in a run: units, signs, labels, lost cells and constants, by their magnitudes.

Each check is a function of `_CHECKS`. It looks at columns and constants alone, and says what is so
rarely right that a person should look: no value is changed. Thresholds are far from what right
recordings have, and stand where they are used.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.text import one_of
from ..schema import (
    AIR,
    AT_REST,
    BASE,
    BRAIDED,
    CAMERA,
    DEFAULT_PRESET,
    INITIAL,
    JOINTS,
    LINKS,
    PINHOLE,
    PISTON,
    ArmSection,
    CamerasSection,
    InitialSection,
    MuscleSection,
    SensorsSection,
    WindSection,
)
from ._channels import Channel
from ._run import Run

Values = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Oddity:
    """What is rarely so in a right recording.

    Attributes:
        code: the kind of mistake that it is likely to be: "units", "signs", "labels", "frame",
            "command", "lost cells", "glitches", "wrap", "take", "time", "start", "constants" or
            "noise".
        sentence: what is seen and where, and what it is likely to be.
        remedy: an edit or an option that mends it, if that is what it is.
        channels: where it is seen, by name.
        rows: first samples where it is seen, as a person counts them; at most ten.
    """

    code: str
    sentence: str
    remedy: str
    channels: tuple[str, ...] = ()
    rows: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.sentence}: {self.remedy}"


def oddities(run: Run) -> list[Oddity]:
    """What is odd in a run; nothing of most right recordings.

    Example:
        >>> import giajax
        >>> values = {"joint01_command": [0.0, 30.0, 30.0], "link01_z": [0.0, 0.1, 0.2]}
        >>> [odd] = giajax.recordings.oddities(giajax.Run.from_arrays([0.0, 0.5, 1.0], values))
        >>> odd.code, odd.remedy
        ('units', '--rename joint01_command_rad=joint01_command_deg, if they are')
    """
    look = _Look(run)
    return [odd for check in _CHECKS for odd in check(look)]


class _Cells(NamedTuple):
    """The measured cells of a channel."""

    channel: Channel
    values: Values
    rows: Rows
    step: float  # what one cell differs from the next by, in the middle
    noise: float  # deviation of white noise by second differences, robust against few steps

    @property
    def span(self) -> float:
        return float(np.ptp(self.values))


_FEW = 8
_SAMPLED = 20_000  # cells, about, that are enough for a median


def _typical(values: Values) -> float:
    """Median of the sizes of some values, in about so many of them."""
    part = values[:: max(len(values) // _SAMPLED, 1)]
    return float(np.median(np.abs(part))) if len(part) else 0.0


class _Look:
    """A run, and what several checks ask of it, each once."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.naming = run.naming
        self.times = run.times

    def at(self, rows: Sequence[int] | Rows) -> str:
        """`row 7` or `rows 7, 9, 12 and 40 more`."""
        shown = [self.naming.at(row).rpartition(" ")[2] for row in rows[:5]]
        more = f" and {len(rows) - 5} more" if len(rows) > 5 else ""
        return f"{self.naming.row}{'s' * (len(rows) > 1)} {', '.join(shown)}{more}"

    def numbers(self, rows: Sequence[int] | Rows) -> tuple[int, ...]:
        return tuple(int(row) + self.naming.first_row for row in rows[:10])

    def of(self, channel: Channel) -> str:
        return self.naming.of(channel)

    @cached_property
    def measured(self) -> dict[str, _Cells]:
        """Measured channels of numbers that have more than a few cells."""
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
                found[name] = _Cells(channel, values, rows, _typical(np.diff(values)), noise)
        return found

    def section(self, of: Any) -> Any:
        return self.run.definition.section(of)

    @cached_property
    def still(self) -> int:
        """First rows in which no command changes; all where there is none."""
        inputs = [v for v in self.run.commands.values() if v.dtype != object]
        moved = [np.flatnonzero(values != values[0])[:1] for values in inputs]
        length = len(next(iter(self.run.values.values())))
        return int(min([length, *(int(each[0]) for each in moved if each.size)]))

    @cached_property
    def pose(self) -> "_Pose | None":
        return _pose_of(self) if self.run.model == "arm" else None


# Cells: what stands for nothing measured, glitches, and angles that wrap.

_STANDS_FOR_NOTHING = (99, 999, 9999, 99999, 999999, 32767, 32768, 65535, 8888, 7777)
_FAR = 3.0  # spans of the other values that such a value is away from them


def _sentinels(look: _Look) -> Iterator[Oddity]:
    """Values such as -9999 far from all others; others of that kind are there more than once."""
    for name, cells in look.measured.items():
        for value in (np.min(cells.values), np.max(cells.values)):
            here = cells.values == value
            count, rest = int(np.count_nonzero(here)), cells.values[~here]
            recorded = round(float(cells.channel.from_si(value)), 6)
            known = abs(recorded) in _STANDS_FOR_NOTHING
            if len(rest) < _FEW or not (known or count > 1):
                continue
            span = float(np.ptp(rest))
            away = float(np.min(np.abs(rest - value)))
            if span > 0 and away > _FAR * span:
                rows, unit = cells.rows[here], cells.channel.unit
                yield Oddity(
                    "lost cells",
                    f"{count} cell{'s' * (count > 1)} of {look.of(cells.channel)} "
                    f"{'are' if count > 1 else 'is'} {recorded:g}{' ' * bool(unit)}{unit}, "
                    f"{away / span:.2g} times as far out as the rest is wide "
                    f"({look.at(rows)}), and may stand for what was not measured",
                    "empty these cells",
                    (name,),
                    look.numbers(rows),
                )


_LEFT_OUT = 8.0  # steps from cell to cell that the neighbours of a lost zero are away from it


def _zeros(look: _Look) -> Iterator[Oddity]:
    """Exact zeros between cells that are far from zero."""
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
                f"{len(rows)} cell{'s' * (len(rows) > 1)} of {look.of(cells.channel)} "
                f"{'are' if len(rows) > 1 else 'is'} exactly 0 between values far from it "
                f"({look.at(rows)}), and may be what was not measured",
                "empty these cells",
                (name,),
                look.numbers(rows),
            )


_JUMP = 1.0  # rad by which a jump may differ from a whole turn


def _wraps(look: _Look) -> Iterator[Oddity]:
    """Angles that jump by a whole turn."""
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
                f"{look.of(channel)} jumps by about {turn} in {look.at(where)}, as an angle does "
                "that is shown within a turn",
                f"unwrap it: add or subtract {turn} from there on (numpy.unwrap)",
                (name,),
                look.numbers(where),
            )


_BEYOND = 4.0  # spreads of its neighbours that a glitch is beyond all of them, ...
_SIGMAS = 12.0  # ... and deviations of the noise
_AROUND = np.array([-4, -3, -2, -1, 1, 2, 3, 4])


def _glitches(look: _Look) -> Iterator[Oddity]:
    """Single cells far beyond the cells around them, which are near each other."""
    for name, cells in look.measured.items():
        # What an accelerometer shows of an impact is a single cell, too.
        if cells.channel.quantity in ("acceleration", "angular_velocity"):
            continue
        # Zeros are lost cells, if anything.
        keep = cells.values != 0
        values, rows, floor = cells.values[keep], cells.rows[keep], _SIGMAS * cells.noise
        jumps = np.flatnonzero(np.abs(np.diff(values)) > max(floor, 0.05 * cells.span))
        if len(jumps) > 0.2 * len(values):
            continue
        places = np.unique(np.concatenate([jumps, jumps + 1]))
        places = places[(places >= 4) & (places < len(values) - 4)]
        around = np.sort(values[places[:, None] + _AROUND], axis=1)
        # One of them on either side may be a glitch itself.
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
            f"{look.of(cells.channel)} is far beyond the cells around it in {look.at(rows)}: "
            f"{'glitches' if len(rows) > 1 else 'a glitch'} of the recording",
            "empty these cells, or fit with --loss student_t, which tames outliers",
            (name,),
            look.numbers(rows),
        )


# Time: takes, stamps.


def _takes(look: _Look) -> Iterator[Oddity]:
    """A row at which all that moves goes back to where it began, and goes on as it began."""
    moving = [
        c for c in look.measured.values() if len(c.values) > 3 * _FEW and c.span > 20 * c.noise
    ]
    if look.times is None or not moving:
        return
    common: set[int] | None = None
    for each in moving:
        x, rows = each.values, each.rows
        steps = np.diff(x)
        # By how much a step differs from those beside it: of a smooth motion by little.
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
        found = set(rows[jumps[again]].tolist())
        common = found if common is None else common & found
    inputs = [v for v in look.run.commands.values() if v.dtype != object and np.ptp(v) > 0]
    # What is recorded at the row at which a command jumps has had no time to follow it.
    at = [
        row
        for row in sorted(common or ())
        if all(abs(v[row] - v[0]) <= 1e-3 * np.ptp(v) for v in inputs)
        and (not inputs or any(abs(v[row - 1] - v[0]) > 0.05 * np.ptp(v) for v in inputs))
    ]
    if at:
        yield Oddity(
            "take",
            f"all that is recorded goes back to its beginning at once in {look.at(at)}: a second "
            "recording seems to begin there",
            "cut the file there, and give both parts with --data",
            tuple(each.channel.name for each in moving),
            look.numbers(at),
        )


# Steps of time that follow each other and differ by a larger factor are noted; with room for
# rounding, because a change from ms to s is one by 1000.
_LEAP = 990.0


def _leaps(look: _Look) -> Iterator[Oddity]:
    """Where the time step changes thousandfold: milliseconds among seconds, or a gap."""
    if look.times is None:
        return
    steps = np.diff(look.times)
    changes = np.abs(np.diff(np.log10(steps))) > np.log10(_LEAP)
    if not changes.any():
        return
    at = np.flatnonzero(changes)
    again = len(at) - 1
    more = f", and again {again} time{'s' * (again > 1)} after it" if again else ""
    yield Oddity(
        "time",
        f"the time step changes from {steps[at[0]]:.3g} s to {steps[at[0] + 1]:.3g} s in "
        # The second of the two steps ends at the sample after the next.
        f"{look.at(at[:1] + 2)}{more}",
        "check the unit of the time stamps, and whether rows are missing",
        rows=look.numbers(at + 2),
    )


def _stamps(look: _Look) -> Iterator[Oddity]:
    """Numbers of frames, or milliseconds, as seconds."""
    times = look.times
    if times is None or not look.run.kind.timed or len(times) < 5 * _FEW:
        return
    steps = np.diff(times)
    middle = float(np.median(steps))
    counted = np.all(times == np.round(times)) and middle == 1.0 and np.ptp(steps) <= 1
    if counted:
        yield Oddity(
            "time",
            f"the stamps count {times[0]:g}, {times[1]:g}, {times[2]:g} s and so on to "
            f"{times[-1]:g} s, as numbers of frames do",
            "divide time_s by the pictures a second of the camera, if they are",
        )
    elif not 5e-5 <= middle <= 5.0:
        off, by = (
            ("milliseconds", "time_s=time_ms") if middle > 5 else ("seconds", "time_ms=time_s")
        )
        yield Oddity(
            "units",
            f"the rows are {middle:.3g} s apart, which is no usual rate: the stamps may be {off}",
            f"--rename {by}, if they are",
        )


# Magnitudes by themselves.

_TURN = 1.1 * np.pi  # rad: no joint is commanded, nor bent by a muscle, beyond a half turn
_WHOLE = 4 * np.pi
_RATE = 60.0  # rad/s: no arm, nor a pendulum of more than centimetres, is so fast


def _magnitudes(look: _Look) -> Iterator[Oddity]:
    """Ratios beyond one, angles of many turns, pixels beyond the picture, accelerations in g."""
    arm = look.run.model == "arm"
    cameras = look.section(CamerasSection).named() if arm else {}
    shortened: dict[str, list[Values]] = {}
    for name, channel in look.run.channels.items():
        values = look.run.values[name]
        if channel.quantity == "text":
            continue
        most = float(np.nanmax(np.abs(values)))
        shown = f"{look.of(channel)} is up to {channel.from_si(most):.4g}"
        if channel.quantity == "ratio" and channel.kind == "contraction" and most > 1:
            yield Oddity(
                "units",
                f"{shown}, but a contraction is a part of the length: it may be in percent",
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
                beyond = most > _TURN
            if beyond:
                degrees = channel.unit == "rad"
                said = "degrees" if degrees else "converted twice"
                renamed = f"--rename {channel.column}={name}_deg, if they are"
                yield Oddity(
                    "units",
                    f"{look.of(channel)} is up to {np.rad2deg(most):.4g} deg, or turns faster than "
                    f"an arm can: the values may be {said}",
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
                yield Oddity(
                    "units",
                    f"{shown} px, but the picture has {size[channel.component or 0]} px: it may be "
                    "that of another size",
                    "correct size_px in [camera.NAME], or the columns",
                    (name,),
                )
        elif channel.quantity == "acceleration":
            shortened.setdefault(name.rpartition("_")[0], []).append(values)
    for name, parts in shortened.items():
        size = float(np.nanmedian(np.sqrt(np.sum(np.square(parts), axis=0))))
        if len(parts) == 3 and 0.9 < size < 1.1:
            yield Oddity(
                "units",
                f"{name} is {size:.3g} m/s^2 in the middle, but at rest shows 9.81: it may be in g",
                "multiply its columns by 9.81",
                (name,),
            )


_TOO_QUIET = 8.0  # times as small as stated


def _noise(look: _Look) -> Iterator[Oddity]:
    """Cells that differ far less than the noise that is stated."""
    for name, cells in look.measured.items():
        stated = look.run.noise(name)
        if (
            look.times is None
            or not stated
            or look.run.correlated_noise(name)
            or len(cells.values) < 4 * _FEW
        ):
            continue
        # By fourth and sixth differences, in which motion leaves nothing; of noise both are alike.
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
                f"{look.of(cells.channel)} differs from cell to cell {factor:.2g} times less than "
                f"the stated noise: {unit}{'or ' * bool(unit)}the noise is stated too large",
                (f"--rename {cells.channel.column}={name}_rad, or " if unit else "")
                + "correct [noise]",
                (name,),
            )


# Constants.

_USUAL: Mapping[str, tuple[float, float]] = {
    LINKS.length.path: (2e-3, 100.0),
    LINKS.diameter.path: (1e-4, 10.0),
    LINKS.mass.path: (1e-7, 1e4),
    BASE.gravity.path: (1.0, 30.0),
    AIR.density.path: (0.05, 10.0),
    AT_REST.length.path: (5e-3, 20.0),
    BRAIDED.diameter.path: (2e-4, 0.5),
    BRAIDED.braid_angle.path: (np.deg2rad(3), np.deg2rad(60)),
    BRAIDED.pressure_limit.path: (5e3, 5e6),
    PISTON.bore.path: (1e-3, 1.0),
    INITIAL.angle.path: (0.0, _WHOLE),
    PINHOLE.focal_length.path: (30.0, 1e5),
}
"""What constants are within, SI; 0 is a statement of its own."""


def _constants(look: _Look) -> Iterator[Oddity]:
    """Constants off by powers of ten, each by itself and against the others."""
    for name, of in look.run.kind.all_sections.items():
        section = look.section(of)
        for key, stated in section.contents().items():
            for part in section.quantities.get(key, ()) if stated is not None else ():
                low, high = _USUAL.get(part.path, (0.0, np.inf))
                place = None if part.key is None else part.key.place
                number = np.ravel(stated if place is None else stated[place])
                sizes = np.abs(np.multiply(number, part.factor))
                bad = (sizes > 0) & ((sizes < low) | (sizes > high))
                # An arm may swim.
                bad &= ~((part.path == AIR.density.path) & (sizes > 900) & (sizes < 1100))
                if bad.any():
                    yield Oddity(
                        "constants",
                        f"{name}.{key} is {number[bad][0]:g}, but it is usually from "
                        f"{low / part.factor:.3g} to {high / part.factor:.3g}, in the unit of its "
                        "key: it may be in another one",
                        "correct it in the sidecar",
                    )
    if look.run.model == "arm":
        yield from _constants_of_arm(look)


def _constants_of_arm(look: _Look) -> Iterator[Oddity]:
    section = look.section(ArmSection)
    known = _arm_values(section)

    def of(path: str) -> Values | None:
        return known.get(path)

    length, mass, diameter = of(LINKS.length.path), of(LINKS.mass.path), of(LINKS.diameter.path)
    floats, gravity = section.preset in _PAPER, of(BASE.gravity.path)
    balanced = _is_balanced(section)
    if length is None or mass is None:
        return
    inertia = known.get(LINKS.inertia_transverse.path)
    if inertia is not None and np.any(inertia > 10 * mass * length**2):
        yield Oddity(
            "constants",
            f"arm.link_inertia_transverse_kg_m2 is {np.max(inertia):.3g}, more than ten times "
            f"mass times length squared ({np.max(mass * length**2):.3g})",
            "correct the inertia, or its unit",
        )
    if floats and diameter is not None and not np.any(gravity or 0.0):
        displaced = 1.204 * np.pi / 4 * diameter**2 * length
        ratio = float(np.max(mass / displaced))
        if not 1e-2 < ratio < 10:
            yield Oddity(
                "constants",
                f"a link weighs {ratio:.3g} times the air that it displaces, but without gravity "
                "buoyancy must balance it: the mass, or a size, may be off by a power of ten",
                "correct link_mass_kg, link_diameter_m or link_length_m in [arm], or state "
                "gravity_m_per_s2",
            )
    stiffness = known.get(JOINTS.pitch_stiffness.path)
    pitched = section.joint_axes in (None, "pitch_yaw") or "pitch" in (section.joint_axes or ())
    if gravity is not None and not balanced and pitched and stiffness is not None:
        count = _links(look) or 1
        whole = np.broadcast_to(mass, (count,)), np.broadcast_to(length, (count,))
        lever = np.cumsum(whole[1]) - whole[1] / 2
        torque = float(np.max(gravity)) * float(np.sum(whole[0] * lever))
        least = float(np.min(stiffness))
        upright = np.any(np.abs(known.get(BASE.base_rotation.path, np.zeros(3))) > 0.5)
        if least > 0 and torque > np.pi / 2 * least and not upright and section.muscles is None:
            yield Oddity(
                "constants",
                f"with gravity and without buoyancy the arm weighs {torque:.3g} N m about its "
                f"base, which a joint of {least:.3g} N m/rad does not carry",
                "state buoyancy = true and trim = true in [arm], or gravity_m_per_s2 = 0 where "
                "buoyancy balances weight",
            )


_PAPER = (None, DEFAULT_PRESET, "takeichi_20m_full")  # presets of the paper's arm


def _is_balanced(section: ArmSection) -> bool:
    return bool(section.buoyancy or section.trim or section.preset == "takeichi_20m_full")


def _arm_values(section: ArmSection) -> dict[str, Values]:
    """Constants that are stated or those of a preset of the paper, by path, SI."""
    known = {**section.values()}
    for path, value in (section.parameters or {}).items():
        known[path] = np.asarray(value, dtype=float)
    if section.preset in _PAPER:
        for each in (LINKS.length, LINKS.diameter, LINKS.mass, JOINTS.pitch_stiffness):
            known.setdefault(each.path, np.asarray(each.default, dtype=float))
    return known


def _links(look: _Look) -> int | None:
    section = look.section(ArmSection)
    if section.links is not None:
        return int(section.links)
    if section.preset in _PAPER:
        return 20
    return next((len(value) for value in section.lists().values()), None)


# How a motion begins.


def _at_equilibrium(look: _Look) -> Iterator[Oddity]:
    """A free motion that the model begins where nothing moves."""
    if look.run.model != "arm" or look.run.commands or look.run.winds:
        return
    initial, arm = look.section(InitialSection), look.section(ArmSection)
    began = initial.first_row or any(np.any(value) for value in initial.values().values())
    gravity = _arm_values(arm).get(BASE.gravity.path)
    rests = arm.preset == "pendulum" or not np.any(gravity or 0.0)
    if began or not rests or look.section(WindSection).velocity_m_per_s or arm.wind_field:
        return
    moving = [n for n, c in look.measured.items() if c.span > 20 * max(c.noise, 1e-9)]
    if moving:
        yield Oddity(
            "start",
            f"{moving[0]} moves, but a free motion whose [initial] state is not stated begins "
            "at the equilibrium, where nothing moves",
            "state first_row = true in [initial], or angle_deg and rate_deg_per_s",
            tuple(moving),
        )


_MOVES = 0.15  # of the whole motion that is too much before it can begin


def _before_commands(look: _Look) -> Iterator[Oddity]:
    """Motion before any command, or first rows that move, where rest is assumed."""
    if look.run.model != "arm" or look.times is None or not look.run.commands or look.run.winds:
        return
    initial = look.section(InitialSection)
    if initial.first_row or initial.free or initial.values():
        return
    if look.section(WindSection).velocity_m_per_s or look.section(ArmSection).wind_field:
        return
    moving = []
    for name, cells in look.measured.items():
        early = cells.values[cells.rows < max(look.still, 0)]
        if cells.channel.quantity in ("acceleration", "angular_velocity") or len(early) < 6:
            continue
        third = max(len(early) // 3, 2)
        drift = abs(float(np.median(early[-third:]) - np.median(early[:third])))
        if drift > max(_MOVES * cells.span, 6 * cells.noise):
            moving.append(name)
    if moving:
        yield Oddity(
            "start",
            f"{one_of(moving) if len(moving) < 3 else f'{moving[0]} and {len(moving) - 1} more'} "
            f"{'moves' if len(moving) == 1 else 'move'} before any command changes "
            f"(until {look.at([look.still - 1])}), but the arm is taken to start at rest: its "
            "clock may be another one than that of the commands, or it was moving",
            "correct the stamps, or state [initial] (free = true lets the fit find it)",
            tuple(moving),
        )


# The arm: recorded positions and angles against those at the commanded angles.
#
# The arm follows its commands late, and the later the farther out: each column is compared with
# what it would be at the commands, behind a lag of first order that describes it best.

_BLOCKS, _IN_BLOCK = 64, 5
_LAGS = np.array([1e-9, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0])  # s
_MOVES_BY = 20.0  # times its noise: channels that move by less say nothing
_BETTER = -0.45  # mean logarithm of what is left where a mistake is undone, against as it is
_SMOOTHER = 0.4  # by how much the shape of the arm is smoother with two labels exchanged


class _Point(NamedTuple):
    """A recorded number: component (None: a joint's angle) of a link, counted from 0."""

    channel: Channel
    link: int
    component: int | None


@dataclasses.dataclass(frozen=True)
class _Pose:
    """What is recorded, in blocks of rows, and the arm at its commands.

    Attributes:
        points: what each column is of; the tip is a link beyond the last.
        recorded: shape (block, point); a joint's angle times the reach of the arm.
        first: the same in the first rows, before any command changes, shape (point,).
        times: s, shape (block,).
        angles: commands, rad, shape (block, joint).
        joints: that are commanded, from 0.
        noise: deviations of a cell, shape (point,).
        lengths, axes, base: of the links and joints, and the rotation vector of the arm.
        width: diameter of the links, m.
    """

    points: list[_Point]
    recorded: Values
    first: Values
    times: Values
    angles: Values
    joints: list[int]
    noise: Values
    lengths: Values
    axes: Values
    base: Values
    width: float

    @property
    def reach(self) -> float:
        return float(np.sum(self.lengths))

    def places(self, angles: Values) -> Values:
        """Centres of the links and the tip, shape (block, link + 1, 3), the straight arm first."""
        angles = np.concatenate([np.zeros((1, angles.shape[1])), angles])
        turn = np.broadcast_to(_rotation(self.base[None]), (len(angles), 3, 3))
        end, centres = np.zeros((len(angles), 3)), []
        for joint, (axis, length) in enumerate(zip(self.axes, self.lengths, strict=True)):
            if np.any(angles[:, joint]):
                turn = turn @ _rotation(axis * angles[:, joint, None])
            span = length * turn[:, :, 0]
            centres.append(end + span / 2)
            end = end + span
        return np.stack([*centres, end], axis=1)

    def seen(self, places: Values, angles: Values, points: Sequence[_Point]) -> Values:
        """What points are at the commands, shape (1 + block, point), of the straight arm first."""
        whole = np.concatenate([np.zeros((1, angles.shape[1])), angles])
        columns = [
            whole[:, p.link] * self.reach if p.component is None else places[:, p.link, p.component]
            for p in points
        ]
        return np.stack(columns, axis=1)

    def squares(self, recorded: Values, seen: Values) -> Values:
        """What is left of each recorded number, behind the lag that leaves least of it."""
        lagged = np.repeat(seen[:1, None], len(_LAGS), axis=1)[0]
        left = np.zeros(lagged.shape)
        steps = np.diff(self.times, prepend=self.times[0])
        for row, target, step in zip(recorded, seen[1:], steps, strict=True):
            lagged = lagged + (1 - np.exp(-step / _LAGS))[:, None] * (target - lagged)
            left += np.nan_to_num((row - lagged) ** 2)
        return np.asarray(np.min(left, axis=0))

    def undone(self, angles: Values, points: Sequence[_Point]) -> Values:
        """The same where the commands, or the points, had been these."""
        return self.squares(self.recorded, self.seen(self.places(angles), angles, points))


def _rotation(vectors: Values) -> Values:
    """Matrices of rotation vectors, shape (row, 3) to (row, 3, 3)."""
    size = np.linalg.norm(vectors, axis=-1)[:, None, None]
    unit = vectors / np.maximum(size[:, :, 0], 1e-300)
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = unit
    cross[:, [1, 2, 0], [2, 0, 1]] = -unit
    return np.eye(3) + np.sin(size) * cross + (1 - np.cos(size)) * (cross @ cross)


def _within(edges: Rows) -> Rows:
    """A few places evenly within each of some ranges, shape (range, place)."""
    first, last = edges[:-1, None], np.maximum(edges[1:, None] - 1, edges[:-1, None])
    return (first + (last - first) * np.linspace(0, 1, _IN_BLOCK)).astype(int)


def _pose_of(look: _Look) -> _Pose | None:
    """None where the arm does not go to its commands from the straight one, or is not known."""
    run, section, times = look.run, look.section(ArmSection), look.times
    known, count = _arm_values(section), _links(look)
    commands = {
        run.channels[name].index or 0: values
        for name, values in run.commands.items()
        if run.channels[name].kind == "joint_command"
    }
    initial, sensors = look.section(InitialSection), look.section(SensorsSection).values()
    heavy = np.any(known.get(BASE.gravity.path, 0.0)) and not _is_balanced(section)
    blown = run.winds or look.section(WindSection).velocity_m_per_s or section.wind_field
    driven = len(commands) < len(run.commands) or section.muscles or section.joint_laws
    stated = initial.values() or initial.first_row or initial.free or section.obstacles
    seen = any(path.startswith("camera.") for path in sensors)
    axes: Any = section.joint_axes
    if axes is None and section.preset in _PAPER:
        axes = "pitch_yaw"
    if times is None or count is None or axes is None or LINKS.length.path not in known:
        return None
    if not commands or heavy or blown or driven or stated or seen:
        return None
    edges = np.linspace(0, len(times), min(_BLOCKS, len(times)) + 1).astype(int)
    rows = _within(edges)
    lengths = np.broadcast_to(known[LINKS.length.path], (count,))
    points, columns, first, noise = [], [], [], []
    for name, cells in look.measured.items():
        channel = cells.channel
        place, scale = (channel.index or 0) - 1, 1.0
        if channel.kind in ("link_position", "tip_position"):
            place = count if channel.kind == "tip_position" else place
            points.append(_Point(channel, place, channel.component))
        elif channel.kind == "joint_angle" and place + 1 in commands:
            points.append(_Point(channel, place, None))
            scale = float(np.sum(lengths))
        else:
            continue
        bounds = np.searchsorted(cells.rows, edges)
        inside = np.minimum(_within(bounds), len(cells.rows) - 1)
        middle = np.median(cells.values[inside], axis=1)
        columns.append(scale * np.where(np.diff(bounds) > 0, middle, np.nan))
        early = cells.values[cells.rows < min(max(look.still, 1), 1000)]
        first.append(scale * np.median(early) if len(early) else np.nan)
        noise.append(scale * max(run.noise(name) or 0.0, cells.noise))
    if not points:
        return None
    angles = np.zeros((len(rows), count))
    for joint, values in commands.items():
        angles[:, joint - 1] = np.median(values[rows], axis=1)
    if np.max(np.abs(angles)) > _TURN:  # as `_magnitudes` says
        return None
    named = {"pitch": (0.0, -1.0, 0.0), "yaw": (0.0, 0.0, 1.0)}
    words = ["pitch", "yaw"] * count if axes == "pitch_yaw" else axes
    vectors = np.array([named[a] if isinstance(a, str) else a for a in words[:count]], dtype=float)
    return _Pose(
        points,
        np.stack(columns, axis=1),
        np.array(first),
        np.median(times[rows], axis=1),
        angles,
        [joint - 1 for joint in commands],
        np.array(noise),
        lengths,
        vectors / np.linalg.norm(vectors, axis=1, keepdims=True),
        np.asarray(known.get(BASE.base_rotation.path, np.zeros(3)), dtype=float),
        float(np.max(known.get(LINKS.diameter.path, 0.0))),
    )


class _Undone(NamedTuple):
    """A mistake that may have been made: its kind, words and remedy, and what is left without."""

    code: str
    words: str
    remedy: str
    squares: Values | float = 0.0


def _at_commands(look: _Look) -> Iterator[Oddity]:
    """Positions and angles that would follow the commands but for one mistake."""
    pose = look.pose
    if pose is None:
        return
    names = tuple(point.channel.name for point in pose.points)
    found = [*_in_first_rows(pose)] or [*_exchanged(pose)] or [*_farther_in(pose)]
    if found:
        yield from (Oddity(each.code, each.words, each.remedy, names) for each in found)
        return
    before = pose.undone(pose.angles, pose.points)
    noise = np.sum(~np.isnan(pose.recorded), axis=0) * pose.noise**2
    whole = np.nansum((pose.recorded - pose.first) ** 2, axis=0)
    moves = whole > _MOVES_BY * noise
    if not moves.any():
        return
    floor = 4 * noise + 1e-3 * whole

    def gain(each: _Undone) -> float:
        return float(np.mean(np.log((each.squares + floor) / (before + floor))[moves]))

    ways = (_units_of, _axes_of, _commands_of)
    gains = [(gain(each), each) for way in ways for each in way(pose)]
    best = min((gained for gained, _ in gains), default=0.0)
    if best > _BETTER:
        return
    # What is nearly as good is named, too; what is simpler stands first.
    near = [each for gained, each in gains if gained < best + 0.1][:3]
    yield Oddity(
        near[0].code,
        "what is recorded does not follow the commands, but would if "
        + "; or ".join(dict.fromkeys(each.words for each in near)),
        "; or ".join(dict.fromkeys(each.remedy for each in near)),
        names,
    )


def _exchanged(pose: _Pose) -> Iterator[_Undone]:
    """Two labels that make the shape of the arm rough, which is smooth with them exchanged."""
    along = np.append(np.cumsum(pose.lengths) - pose.lengths / 2, pose.reach)

    def roughness(names: Mapping[int, int]) -> tuple[float, float]:
        """Squares of the bends from link to link, and those that noise makes."""
        bends = by_noise = 0.0
        for axis in range(3):
            of = [(names.get(p.link, p.link), i) for i, p in enumerate(pose.points)
                  if p.component == axis]  # fmt: skip
            if len(of) < 3:
                continue
            links, at = (list(each) for each in zip(*sorted(of), strict=True))
            shape = (pose.recorded - pose.first)[:, at]
            shape = shape[~np.isnan(shape).any(axis=1)]
            gaps = np.diff(along[links], prepend=0.0)
            if not np.all(gaps > 0):
                return np.inf, 1.0
            slopes = np.diff(shape, axis=1, prepend=0.0) / gaps
            bends += float(np.sum(np.diff(slopes, axis=1) ** 2))
            noise = np.append(0.0, pose.noise[at])
            apart = (noise[:-2] / gaps[:-1]) ** 2 + (noise[2:] / gaps[1:]) ** 2
            apart += (noise[1:-1] * (1 / gaps[:-1] + 1 / gaps[1:])) ** 2
            by_noise += len(shape) * float(np.sum(apart))
        return bends, by_noise

    bends, by_noise = roughness({})
    if bends <= 4 * by_noise:
        return
    links = sorted({p.link for p in pose.points if p.component is not None})
    pairs = [(roughness(names)[0], words) for words, names in _swaps(links, len(pose.lengths))]
    least, words = min(pairs, default=(np.inf, ""))
    if least < _SMOOTHER * bends:
        yield _Undone(
            "labels",
            f"the recorded shape of the arm is rough, and would be smooth if {words}",
            "exchange the names of their columns (--rename)",
        )


def _farther_in(pose: _Pose) -> Iterator[_Undone]:
    """A link that turns as far as a command, though all commanded joints are farther out."""
    turning = [joint for joint in pose.joints if np.ptp(pose.angles[:, joint]) > 0]
    for i, point in enumerate(pose.points):
        if point.component not in (1, 2) or not turning or point.link >= min(turning):
            continue
        along = float(np.sum(pose.lengths[: point.link])) + pose.lengths[point.link] / 2
        turned = np.nanmax(np.abs(pose.recorded[:, i] - pose.first[i])) / along
        far = 0.5 * float(np.max(np.ptp(pose.angles, axis=0)))
        if turned > max(far, 10 * pose.noise[i] / along):
            name = f"joint{min(turning) + 1:02d}_command"
            yield _Undone(
                "command",
                f"link {point.link + 1} turns by {np.rad2deg(turned):.2g} deg, but no joint up to "
                f"it is commanded: {name} may be that of another joint",
                f"--rename {name}_deg=joint{max(point.link - 1, 0) + 1:02d}_command_deg, or of the "
                "joint that it is",
            )
            return


def _in_first_rows(pose: _Pose) -> Iterator[_Undone]:
    """Positions in the first rows against the straight arm, which rests there."""
    straight = pose.places(pose.angles[:1])[0]
    chosen = [
        i
        for i, p in enumerate(pose.points)
        if p.component is not None and pose.first[i] == pose.first[i]
    ]
    points, first = [pose.points[i] for i in chosen], pose.first[chosen]
    at = np.array([straight[p.link] for p in points]).reshape(-1, 3)
    axis = np.array([p.component for p in points], dtype=int)
    here = at[np.arange(len(points)), axis]
    enough = max(0.015 * pose.reach, pose.width, 6 * float(np.max(pose.noise[chosen], initial=0.0)))
    rest = first - here
    if not len(points) or np.max(np.abs(rest)) <= enough:
        return
    # Another label, or axis, first: a number of the arm itself would be where it is.
    for way in _ways_of(sorted(set(axis.tolist()))):
        order, signs = way
        turned = np.array([signs[c] * at[i, order[c]] for i, c in enumerate(axis)])
        if np.max(np.abs(first - turned)) <= enough:
            yield _Undone(
                "signs" if order == (0, 1, 2) else "labels", *_words_of(way, axis.tolist())
            )
            return
    links = sorted({p.link for p in points})
    count = len(straight) - 1
    for words, names in _relabelled(links, count):
        moved = np.array([straight[names.get(p.link, p.link), p.component or 0] for p in points])
        if np.max(np.abs(first - moved)) <= enough:
            said = f"the first rows are those of a straight arm if {words}"
            remedy = "correct the numbers in the names of the columns (--rename)"
            yield _Undone("labels", said, remedy)
            return
    origin = np.array([np.median(rest[axis == c]) if np.any(axis == c) else 0.0 for c in range(3)])
    stated = ",".join(f"{each:.3g}" for each in origin + 0.0)
    path = CAMERA.origin.path
    if np.max(np.abs(rest - origin[axis])) <= max(enough, 0.2 * np.max(np.abs(rest))):
        yield _Undone(
            "frame",
            f"the first rows are off from the straight arm by ({stated}) m, alike in all columns: "
            "the origin of the camera may be off",
            f"--free {path} --start {path}={stated}, or subtract it from the columns",
        )
        return
    x, y, z = at.T
    zero = np.zeros(len(points))
    by_axis = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
    rows = np.column_stack([by_axis[axis, :, np.arange(len(points))], np.eye(3)[axis]])
    found = np.linalg.lstsq(rows, rest, rcond=1e-6)[0]
    degrees = float(np.rad2deg(np.linalg.norm(found[:3])))
    left = float(np.max(np.abs(rest - rows @ found)))
    turned_so = degrees < 30 and left <= max(enough, 0.2 * np.max(np.abs(rest))) and len(points) > 6
    how = f"the frame of the camera may be turned by {degrees:.2g} deg" if turned_so else (
        "the arm may not start straight and at rest, or axes, labels or lengths are wrong"
    )  # fmt: skip
    yield _Undone(
        "frame",
        f"the first rows are up to {np.max(np.abs(rest)):.3g} m off from the straight arm: {how}",
        f"--free {CAMERA.rotation.path} --free {path}"
        if turned_so
        else "look at the first rows, and state [initial] if the arm starts otherwise",
        0.0,
    )


def _swaps(links: Sequence[int], count: int) -> Iterator[tuple[str, dict[int, int]]]:
    """Two recorded links whose labels are exchanged, in words."""
    called = ["the tip" if link == count else f"link {link + 1}" for link in links]
    for (one, a), (other, b) in itertools.combinations(zip(links, called, strict=True), 2):
        yield f"{a} and {b} are exchanged", {one: other, other: one}


def _relabelled(links: Sequence[int], count: int) -> Iterator[tuple[str, dict[int, int]]]:
    """Other numbers of the recorded links, in words."""
    yield from _swaps(links, count)
    for by in (-1, 1):
        if links and links[0] + by >= 0 and links[-1] + by < count:
            yield f"the numbers of the links are off by {-by}", {k: k + by for k in links}
    yield "the links are counted from the tip", {k: count - 1 - k for k in links if k < count}


def _units_of(pose: _Pose) -> Iterator[_Undone]:
    turn = float(np.rad2deg(1.0))
    is_place = np.array([point.component is not None for point in pose.points])
    for factor, what, wrong in ((turn, "rad", "deg"), (1 / turn, "deg", "rad")):
        if np.max(np.abs(factor * pose.angles)) > _TURN:
            continue
        one = f"joint{pose.joints[0] + 1:02d}_command"
        yield _Undone(
            "units",
            f"the commands are in {what}",
            f"--rename {one}_{wrong}={one}_{what}, and the others alike",
            pose.undone(factor * pose.angles, pose.points),
        )
        if not is_place.all():
            seen = pose.seen(pose.places(pose.angles), pose.angles, pose.points)
            seen = np.where(is_place, seen, seen / factor)
            yield _Undone(
                "units",
                f"the joint angles are in {what}",
                f"end the names of the angle columns in _{what} (--rename)",
                pose.squares(pose.recorded, seen),
            )


_Way = tuple[tuple[int, ...], tuple[int, ...]]


def _ways_of(here: Sequence[int]) -> list[_Way]:
    """Orders and signs of axes that differ in what is recorded, those that change least first."""
    ways = itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3))

    def changes(way: _Way) -> int:
        return sum((way[0][c] != c) + (way[1][c] < 0) for c in here)

    distinct = {tuple((way[0][c], way[1][c]) for c in here): way
                for way in sorted(ways, key=lambda way: (-changes(way), way[1]))}  # fmt: skip
    return sorted((way for way in distinct.values() if changes(way)), key=changes)


def _words_of(way: _Way, here: Sequence[int]) -> tuple[str, str]:
    """What a way of the axes means, and what to do."""
    order, signs = way
    axes = sorted({int(c) for c in here})
    turned = [f"{'xyz'[c]} points the other way" for c in axes if signs[c] < 0]
    moved = [f"the column {'xyz'[c]} is {'xyz'[order[c]]}" for c in axes if order[c] != c]
    remedies = ["correct the axes in the names of the columns (--rename)"] if moved else []
    remedies += ["change the sign of these columns"] if turned else []
    return " and ".join([*moved, *turned]), " and ".join(remedies)


def _axes_of(pose: _Pose) -> Iterator[_Undone]:
    """Signs and exchanges of the axes of recorded positions."""
    places = pose.places(pose.angles)
    here = sorted({p.component for p in pose.points if p.component is not None})
    for way in _ways_of(here):
        order, signs = way
        points = [
            p if p.component is None else p._replace(component=order[p.component])
            for p in pose.points
        ]
        sign = np.array([1 if p.component is None else signs[p.component] for p in pose.points])
        left = pose.squares(sign * pose.recorded, pose.seen(places, pose.angles, points))
        code = "signs" if order == (0, 1, 2) or all(order[c] == c for c in here) else "labels"
        yield _Undone(code, *_words_of(way, here), left)


def _commands_of(pose: _Pose) -> Iterator[_Undone]:
    """Signs of commands, and commands of other joints."""
    count = pose.angles.shape[1]
    for joint in pose.joints:
        if not np.any(pose.angles[:, joint]):
            continue
        name = f"joint{joint + 1:02d}_command"
        angles = pose.angles * np.where(np.arange(count) == joint, -1.0, 1.0)
        yield _Undone(
            "signs",
            f"{name} has the other sign",
            f"change the sign of the column of {name}",
            pose.undone(angles, pose.points),
        )
        for other in range(min(count, 40)):
            if other != joint:
                angles = pose.angles.copy()
                angles[:, [joint, other]] = angles[:, [other, joint]]
                new = f"joint{other + 1:02d}_command"
                yield _Undone(
                    "command",
                    f"{name} is that of joint {other + 1}",
                    f"--rename {name}_deg={new}_deg",
                    pose.undone(angles, pose.points),
                )


def _reach(look: _Look) -> Iterator[Oddity]:
    """Positions beyond the length of the arm."""
    section = look.section(ArmSection) if look.run.model == "arm" else None
    count = None if section is None else _links(look)
    known = {} if section is None else _arm_values(section)
    if count is None or LINKS.length.path not in known:
        return
    sensors = look.section(SensorsSection).values()
    if CAMERA.origin.path in sensors or CAMERA.scale.path in sensors:
        return
    lengths = np.broadcast_to(known[LINKS.length.path], (count,))
    # How many times as far from the base as the arm lets each be, the worst first.
    beyond = []
    for name, cells in look.measured.items():
        if cells.channel.kind in ("link_position", "tip_position"):
            link = (cells.channel.index or count + 1) - 1
            own = float(np.sum(lengths[:link]) + np.sum(lengths[link : link + 1]) / 2)
            seen = np.abs(cells.values[:: max(len(cells.values) // 2000, 1)])
            far = float(np.quantile(seen, 0.9))
            if far > 1.2 * own + 6 * cells.noise + 0.1:
                beyond.append((far / own, far, own, name))
    if not beyond:
        return
    ratio, far, own, name = max(beyond)
    channel = look.run.channels[name]
    # What is farther than a hundred times as far is too far in cm, too.
    unit = "mm" if ratio > 120 else "cm" if ratio > 10 else ""
    what = (
        f"the values may be in {unit}" if unit else "the origin, a label or a length may be wrong"
    )
    remedy = "correct the columns, or links and link_length_m in [arm]"
    if unit:
        renamed = f"--rename {channel.column}={name}_{unit}, and the others alike"
        remedy = renamed if channel.unit == "m" else "convert the values"
    yield Oddity(
        "units" if unit else "frame",
        f"{look.of(channel)} is up to {far:.4g} m, but the arm lets it be {own:.4g} m: {what}",
        remedy,
        (name,),
    )


def _force(look: _Look) -> Iterator[Oddity]:
    """The force of a braided muscle against that of the ideal law at the highest pressure."""
    if look.run.model != "muscle" or "force" not in look.measured:
        return
    stated = look.section(MuscleSection).values()
    needed = (BRAIDED.diameter.path, BRAIDED.braid_angle.path)
    pressure = look.run.values.get("pressure")
    if any(path not in stated for path in needed) or pressure is None:
        return
    diameter, angle = (float(stated[path]) for path in needed)
    most = float(np.nanmax(pressure))
    ideal = np.pi / 4 * diameter**2 * most * (3 / np.tan(angle) ** 2 - 1 / np.sin(angle) ** 2)
    cells = look.measured["force"]
    ratio = float(np.quantile(np.abs(cells.values), 0.95)) / max(ideal, 1e-300)
    if ratio > 20 or ratio < 1e-2:
        yield Oddity(
            "units",
            f"the force is {ratio:.2g} times that of an ideal muscle of this size and pressure: "
            "force, pressure or diameter may be in another unit",
            "correct the unit in the name of the column, or the key in [muscle]",
            ("force", "pressure"),
        )
    limit = stated.get(BRAIDED.pressure_limit.path)
    if limit is not None and not 0.01 < most / float(limit) < 5:
        yield Oddity(
            "units",
            f"the pressure is up to {most / float(limit):.2g} times the stated limit: one of them "
            "may be in another unit",
            "correct the unit in the name of the column, or pressure_limit_kPa",
            ("pressure",),
        )


_CHECKS: tuple[Callable[[_Look], Iterator[Oddity]], ...] = (
    _stamps, _leaps, _takes, _reach, _magnitudes, _at_commands, _constants, _force, _at_equilibrium,
    _before_commands, _sentinels, _zeros, _wraps, _glitches, _noise,
)  # fmt: skip
