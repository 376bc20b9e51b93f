"""Verdict on a track: consistency of the innovations, and explanations if they are inconsistent."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ...fitting import FitResult
from ...models import AbstractModel, ArmModel
from ...recordings import Channel, Run
from ...runtime.parallel import Tell, all_in_threads
from ...runtime.text import InputError
from ...schema import CAMERA
from ...schema.parameters import elements, replace
from ..synthetic import DECAY
from ..wind import first_guess
from ._arm import Air, Bias, TrackedArm, delay_path
from ._filter import Gaussian
from ._rounds import GATE
from ._track import (
    SHOWN,
    Track,
    Unknown,
    begun_at,
    followed_through,
    log_likelihood_of,
    model_and_unknown,
    noise_of,
)

BAND = 1.96
"""Half-width of a two-sided 95 % interval of a normal variable, in standard deviations."""
# Deviation of the NIS or of a correlation that is tolerated for any number of measurements.
_ENOUGH = 0.1
_BEYOND = 4.0  # tolerated deviation in standard errors
_LAGS = 10  # largest lag of the correlations, events
_GAIN = 8.0  # required gain in log-likelihood: 4 standard errors of one parameter
# Rows of the run by which explanations are compared, and rows by which clocks are compared: gusts
# can mask a shift of a clock while no command moves.
_FIRST, _FIRST_OF_CLOCKS = 600, 1800
_SHIFTS = (-0.2, 0.2)  # tested shifts of a clock, s
_OFTEN = 0.02  # tolerated fraction of rejected measurements


@dataclasses.dataclass(frozen=True)
class Cause:
    """Possible explanation of inconsistent innovations.

    Attributes:
        name: name of the explanation.
        gain: gain in log-likelihood.
        advice: recommended action, as a sentence.
        value: value of the parameter in question, SI units; None if there is none.
        deviation: standard deviation of the value.
    """

    name: str
    gain: float
    advice: str
    value: float | None = None
    deviation: float | None = None


@dataclasses.dataclass(frozen=True)
class TrackVerdict:
    """Verdict on the consistency of the innovations.

    Attributes:
        adequate: whether the innovations are consistent and no explanation is significantly better.
        nis: mean square of the whitened innovations that were used; 1 for a correct model.
        nis_error: standard error of `nis`.
        correlation: largest correlation of the innovations of an event with those of one of the
            next ten events.
        left_out: fraction of the measurements that were rejected.
        causes: explanations that are significantly better, the best first.
        tried: names of all explanations that were tested.
    """

    adequate: bool
    nis: float
    nis_error: float
    correlation: float
    left_out: float
    causes: tuple[Cause, ...]
    tried: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """Verdict in one sentence."""
        if self.adequate:
            return "adequate: the innovations are white and as large as expected"
        if self.causes:
            best = self.causes[0]
            return f"not adequate: {best.name} (log-likelihood +{best.gain:.3g}); {best.advice}"
        size = f"the innovations are {np.sqrt(self.nis):.2g} times as large as expected"
        return (
            f"not adequate: {size}, with a correlation of {self.correlation:.2f}, and none of "
            "the tested explanations fits better: fit the model to the run"
        )


def _first_rows(run: Run, count: int = _FIRST) -> Run:
    """Return the first rows of a run; the number is the same for all explanations."""
    if run.times is None or len(run.times) <= count:
        return run
    values = {name: column[:count] for name, column in run.values.items()}
    return dataclasses.replace(run, times=run.times[:count], values=values)


def _without_first(run: Run, names: Sequence[str], late: float) -> Run:
    """Return a run without the measurements that a clock with a delay exposed before the run.

    The delay `late` is in s. The likelihoods of several delays then use the same measurements.
    """
    assert run.times is not None
    early = run.times < run.times[0] + late - 1e-9
    values = dict(run.values)
    for name in names:
        values[name] = np.where(early, np.nan, values[name])
    return dataclasses.replace(run, values=values)


def consistent(found: Track) -> tuple[bool, float, float, float, float]:
    """Return whether the innovations are consistent, and the numbers of `TrackVerdict`.

    These numbers are `nis`, `nis_error`, `correlation` and `left_out`.
    """
    count, counted = int(np.sum(found.there)), int(np.sum(found.used))
    # Outliers are not included here: they are judged by their number.
    nis = float(np.sum(found.whitened**2) / counted)
    error = float(np.sqrt(2 / counted))
    rows = found.whitened[np.any(found.used, axis=1)]
    size = np.mean(rows**2)
    lags = range(1, min(_LAGS, len(rows) - 2) + 1)
    largest = max((float(np.mean(rows[k:] * rows[:-k]) / size) for k in lags), key=abs, default=0.0)
    left_out = 1 - counted / count
    sound = (
        abs(nis - 1) <= max(_ENOUGH, _BEYOND * error)
        and abs(largest) <= max(_ENOUGH, _BEYOND / np.sqrt(rows.size))
        and left_out <= _OFTEN
    )
    return sound, nis, error, largest, left_out


def judge(
    model: AbstractModel | FitResult,
    found: Track,
    *,
    look: bool = True,
    progress: Callable[[str], None] | None = None,
) -> TrackVerdict:
    """Judge whether a track is consistent with its model.

    If a command moves, shifts of a clock are always tested, by the log-likelihood of the first
    1,800 rows. If the innovations are too large or not white, further explanations are tested by
    the log-likelihood of the first 600 rows: a wind with gusts, a different stiffness and drag, a
    bias of the camera, more unmodelled torque, and different noise.

    Arguments:
        model: model that was tracked.
        found: track to judge.
        look: test explanations.
        progress: function that is called with progress messages.
    """
    sound, nis, error, largest, left_out = consistent(found)
    stated, _ = model_and_unknown(model, found.run, found.unknown)
    cases: dict[str, _Case] = {}
    moves = any(np.ptp(column) > 0 for column in found.run.commands.values())
    # Shift only the first of two clocks, because only their difference matters.
    clocks = sorted({delay_path(name) for name in found.arm.channels} - {""})
    clocks = clocks[:1] if moves and look else []
    for path in clocks:
        nominal = found.arm.delay_of(path) or 0.0
        names = [name for name in found.arm.channels if delay_path(name) == path]
        enough = _first_rows(found.run, _FIRST_OF_CLOCKS)
        same = _without_first(enough, names, nominal + max(_SHIFTS))
        for shift in (0.0, *_SHIFTS):
            other = replace(stated, {path: nominal + shift})
            cases[_shifted(path, shift)] = _Case(other, same, found.unknown, found.noise)
    others = _others(stated, found, nis) if look and not sound else []
    if others:
        short = _first_rows(found.run)
        cases[_GIVEN] = _Case(stated, short, found.unknown, found.noise)
        for name, unknown, noise, _ in others:
            cases[name] = _Case(stated, short, unknown, noise or found.noise)
    likely = _likelihoods(cases, found, progress or (lambda _: None))

    causes: list[Cause] = []
    for path in clocks:
        nominal = found.arm.delay_of(path) or 0.0
        totals = {shift: likely[_shifted(path, shift)] for shift in (0.0, *_SHIFTS)}
        gains = {shift: total - totals[0.0] for shift, total in totals.items()}
        if (late := _highest(gains)) is not None:
            at, gain, deviation = late
            if gain > _GAIN:
                causes.append(
                    Cause(
                        path,
                        gain,
                        f"{path} is about {nominal + at:.2f} s, but is given as {nominal:.2f} s: "
                        "correct or fit it",
                        nominal + at,
                        deviation,
                    )
                )
    for name, _, _, advice in others:
        gain = likely[name] - likely[_GIVEN]
        if gain > _GAIN:
            causes.append(Cause(name, gain, advice))
    causes.sort(key=lambda cause: -cause.gain)
    tried = (*clocks, *(name for name, *_ in others))
    return TrackVerdict(sound and not causes, nis, error, largest, left_out, tuple(causes), tried)


class _Case(NamedTuple):
    """Model and assumptions whose likelihood is computed."""

    model: ArmModel
    run: Run
    unknown: Unknown
    noise: dict[str, float]


_GIVEN = "the model as given"


def _shifted(path: str, shift: float) -> str:
    return f"{path} shifted by {shift:+g} s" if shift else path


def _likelihoods(
    cases: dict[str, _Case], found: Track, say: Callable[[str], None]
) -> dict[str, float]:
    """Return the log-likelihood of each case by its name; -inf if it cannot be tracked."""

    def likely(name: str, case: _Case, tell: Tell) -> float:
        tell(say, f"testing {name} ...")
        same = found.start if case.unknown is found.unknown else None
        try:
            given = (case.model, case.run, case.noise, case.unknown, found.gate, same)
            tracked, plan, start, settings = begun_at(*given)
            _, rows = followed_through(tracked, start, plan.events, settings)
        except InputError:
            return -np.inf
        total = log_likelihood_of(rows)
        return total if np.isfinite(total) else -np.inf

    jobs = [functools.partial(likely, *case) for case in cases.items()]
    return dict(zip(cases, all_in_threads(jobs), strict=True))


def _highest(gains: dict[float, float]) -> tuple[float, float, float] | None:
    """Return the maximum of a parabola through the best three points.

    The result is the position of the maximum, its height, and the standard deviation of the
    position.
    """
    shifts = sorted(gains)
    best = int(np.argmax([gains[shift] for shift in shifts]))
    middle = min(max(best, 1), len(shifts) - 2)
    near = shifts[middle - 1 : middle + 2]
    heights = [gains[shift] for shift in near]
    if not np.all(np.isfinite(heights)):
        return (shifts[best], gains[shifts[best]], np.nan) if gains[shifts[best]] > 0 else None
    bend, slope, level = np.polyfit(near, heights, 2)
    if bend >= 0:
        return shifts[best], gains[shifts[best]], np.nan
    at = float(np.clip(-slope / (2 * bend), shifts[0], shifts[-1]))
    return at, float(level + slope * at + bend * at**2), float(np.sqrt(-0.5 / bend))


_USUAL_WIND, _USUAL_GUSTS = (0.0, 0.2, 0.0), (0.3, 5.0)


def _others(stated: ArmModel, found: Track, nis: float) -> list[Any]:
    """Return further explanations, each with its name, unknowns, noise and advice."""
    unknown = found.unknown
    others: list[Any] = []

    def also(**changes: Any) -> Unknown:
        return dataclasses.replace(unknown, **changes)

    if unknown.air is None:
        guess = first_guess(_USUAL_WIND, *_USUAL_GUSTS, DECAY)
        air = Air(guess, 0.2, places=usual_places(stated))
        others.append(
            ("a wind with gusts", also(air=air), None, "track the wind: --wind and --gusts, or Air")
        )
    spread = {
        path: 0.3 * float(elements(stated, path)[0].value(stated))
        for path in ("joints.pitch_stiffness", "joints.yaw_stiffness", "air.drag_coefficient")
        if len(elements(stated, path)) == 1
    }
    spread = {path: size for path, size in spread.items() if size > 0}
    if spread and not unknown.estimated:
        kept = {path: size for path, size in unknown.considered.items() if path not in spread}
        estimated = also(considered=kept, correlation=None, estimated=spread)
        others.append(
            ("a different stiffness or drag", estimated, None, "fit the model to a similar run")
        )
    axes: dict[tuple[str, int | None], list[str]] = {}
    for name in found.noise:
        if delay_path(name) == CAMERA.delay.path:
            channel = Channel.named(name)
            axes.setdefault((f"{channel.camera} {channel.quantity}", channel.component), []).append(
                name
            )
    biases = tuple(Bias(tuple(names), 10 * found.noise[names[0]]) for names in axes.values())
    if biases and not unknown.biases:
        others.append(
            ("a bias of the camera", also(biases=biases), None, "track the bias: --bias, or Bias")
        )
    torque = 10 * float(found.arm.torque)
    others.append(
        (
            "more unmodelled torque",
            also(torque=torque),
            None,
            f"allow more torque: --torque-noise {torque:.2g}",
        )
    )
    noisier = {name: float(np.sqrt(nis)) * size for name, size in found.noise.items()}
    others.append(("other noise", unknown, noisier, f"multiply [noise] by {np.sqrt(nis):.2g}"))
    return others


def usual_places(model: ArmModel) -> int:
    """Return the default number of gust places: one per 2.5 m, and at least two."""
    length = float(np.sum(np.asarray(model.arm.links.length)))
    return int(np.clip(np.ceil(length / 2.5), 2, model.arm.count)) if model.arm.count > 1 else 1


def nees(found: Track, truth: Run) -> tuple[float, float]:
    """Compare the errors of the filter with their standard deviations, given the true states.

    Arguments:
        found: track to compare.
        truth: run with the true angles or rates of joints, at least at some of its times.

    Returns:
        The normalised estimation error squared (NEES) per state, 1 for correct standard deviations,
        and the fraction of errors within `BAND` standard deviations, 0.95 for correct ones.

    Raises:
        InputError: the run has no true angle or rate, or none at the times of the track.
    """
    count = found.arm.joints
    columns = [
        (name, offset + k)
        for k in range(count)
        for name, offset in ((f"joint{k + 1:02d}_angle", 0), (f"joint{k + 1:02d}_rate", count))
        if name in truth.values
    ]
    if truth.times is None or not columns:
        raise InputError(
            f"'{truth.name}' has no true angle or rate of any joint: give columns such as "
            "joint01_angle_deg"
        )
    near = np.clip(np.searchsorted(truth.times, found.times - 1e-6), 0, len(truth.times) - 1)
    same = np.abs(truth.times[near] - found.times) < 1e-6
    table = np.stack([truth.values[name][near[same]] for name, _ in columns], axis=1)
    there = np.all(np.isfinite(table), axis=1)
    if not there.any():
        raise InputError(
            f"'{truth.name}' has none of the times of the track: give the truth at the same times"
        )
    states = [index for _, index in columns]
    off = table[there] - found.filtered.mean[same][there][:, states]
    root = found.filtered.root[same][there][:, states]
    covariance = root @ root.transpose(0, 2, 1)
    solved = np.linalg.solve(covariance, off[..., None])[..., 0]
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return float(np.mean(off * solved)), float(np.mean(np.abs(off) < BAND * spread))


def unseen(
    model: AbstractModel | FitResult,
    run: Run,
    *,
    unknown: Unknown | None = None,
    channels: Sequence[str] | None = None,
    start: Gaussian | None = None,
) -> list[tuple[str, float, float]]:
    """Return the weakly observable states, without using measured values.

    They follow from the covariance of the filter over the first 600 rows of a run. Only the times,
    the commands and the choice of channels of the run are used. Consider parameters are treated as
    estimated.

    Arguments:
        model: model of the arm, or a fit of it.
        run: run that provides the times, the commands and the channels.
        unknown: unknown quantities, as for `track`.
        channels: channels to use; defaults to all measured channels.
        start: initial estimate for the same unknowns and channels, such as `Track.start`; by
            default, it is computed as in `track`.

    Returns:
        Names of the states, with initial and final standard deviations, SI units.

    Raises:
        InputError: as in `track`.
    """
    result = model if isinstance(model, FitResult) else None
    stated, given = model_and_unknown(model, run, unknown)
    names = list(run.observations if channels is None else channels)
    noise = noise_of(run, names, result)
    tracked, plan, begun, settings = begun_at(stated, _first_rows(run), noise, given, GATE, start)
    every = jnp.ones_like(settings.estimated)
    events = plan.events
    if events.learning is not None:
        moves = jnp.ones_like(events.learning.moves)
        events = events._replace(learning=events.learning._replace(moves=moves))
    _, rows = followed_through(
        tracked, begun, events, settings._replace(estimated=every, blind=jnp.asarray(True))
    )
    before = np.sqrt(np.sum(np.asarray(begun.root) ** 2, axis=1))
    after = np.sqrt(np.sum(np.asarray(rows.state.root[-1]) ** 2, axis=1))
    return [
        (name, float(before[index]), float(after[index]))
        for name, index in _named(tracked)
        if before[index] > 0 and after[index] > SHOWN * before[index]
    ]


def _named(arm: TrackedArm) -> list[tuple[str, int]]:
    where = arm.slices()
    names = [(f"joint{k + 1:02d}_angle", k) for k in range(arm.joints)]
    if arm.gusts is not None:
        names += [(f"wind_{axis}", where["mean flow"].start + k) for k, axis in enumerate("xyz")]
    names += [(path, where["parameters"].start + k) for k, path in enumerate(arm.paths)]
    biases = where["biases"]
    names += [(f"bias {k + 1}", biases.start + k) for k in range(biases.stop - biases.start)]
    return names
