"""Probability of the success of a mission, from a recording of the arm at rest.

Missions of drawn arms in drawn air begin with the arm at rest, so that what a recording of that
would show is known of each, and whether it succeeded. A logistic regression of success on a few
numbers of each rest estimates its probability for what a recording shows: inference by simulations
without a likelihood, with a regression in place of the posterior (Fearnhead and Prangle, J. R.
Stat. Soc. B 74 (2012) 419). It depends on how arms and air are drawn.
"""

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import f as ratio_of_variances, norm

from ...models import ArmModel, recorded_channels
from ...recordings import Channel, Run
from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError
from ..synthetic import logged_motion
from ._cases import Case, flown_on_all_cores
from ._controller import AbstractController, Picture, Scene, number
from ._mission import Mission, Outcome

_SETTLES = 120.0  # s that an arm is in the air before its recording begins
_SHORTEST, _LONGEST = 30.0, 120.0  # of a recording, s; of a longer one the end
_BIN, _LATER = 0.5, 2.0  # s of a mean, and between two that are compared
_MOVES = np.deg2rad(0.5)  # a command that moves by more is no rest
# Standard deviation of the prior of a logistic regression of standardised features, weakly
# informative (Gelman et al., Ann. Appl. Stat. 2 (2008) 1360).
_SLOPE = 2.5
_SMALLEST = 0.01  # deviation of a feature, a logarithm: below it is a constant
_NEIGHBOURS = 0.2  # s between two rows, so that what differs is noise and not motion
FEWEST_CASES = 20
"""Smallest number of missions for a certificate."""

_NEAR = 0.1  # of all missions, those that are shown beside the recording
_UNLIKE = 0.001  # level of the test for a recording that is unlike the drawn rests


class Waiting(AbstractController):
    """Another controller, which begins after a while: until then the commands stay.

    Attributes:
        controller: which begins with the pictures of then.
        seconds: before it begins.
    """

    controller: AbstractController
    seconds: Scalar = number(0.0)

    def start(self, scene: Scene, late: int) -> Any:
        """The memory of the other, and the time."""
        return self.controller.start(scene, late), jnp.zeros_like(scene.interval)

    def decide(
        self, scene: Scene, memory: Any, picture: Picture, command: Array
    ) -> tuple[Any, Float[Array, " joint"]]:
        """What the other decides, once it is time."""
        inner, time = memory
        inner, after = jax.lax.cond(
            time < self.seconds - scene.interval / 2,
            lambda: (inner, command),
            lambda: self.controller.decide(scene, inner, picture, command),
        )
        return (inner, time + scene.interval), after

    def believed(self, scene: Scene, memory: Any) -> Float[Array, "3"]:
        """As the other does."""
        return self.controller.believed(scene, memory[0])


@dataclasses.dataclass(frozen=True)
class Resting:
    """What a recording of the resting arm shows.

    Attributes:
        channels: their names.
        bins: their means over each half second, SI; NaN where nothing was recorded.
        noise: standard deviation of such a mean.
    """

    channels: tuple[str, ...]
    bins: Float[np.ndarray, "bin channel"]
    noise: Float[np.ndarray, " channel"]

    @classmethod
    def from_run(cls, run: Run, model: ArmModel) -> Self:
        """Of a run; of its last two minutes where it is longer.

        Raises:
            InputError: nothing was measured, a channel that the model of the arm does not show
                without integrating it, no commands, commands that are not angles, move or are not
                those of the straight arm, less than half a minute, a channel that was recorded too
                seldom, or no noise that is stated or can be told from the motion.
        """
        run.require_observations()
        model.prepare(run)
        _shown_by(model, np.zeros((2, model.arm.count)), tuple(run.observations))
        if not run.commands:
            raise InputError(
                f"'{run.name}' has no commands: add the commands of the resting arm, such as a "
                "column joint01_command_deg of zeros"
            )
        for name, row in run.commands.items():
            if Channel.named(name).kind != "joint_command":
                raise InputError(
                    f"'{run.name}' is driven by {name}, but a mission by commanded angles: give a "
                    "run with commanded angles"
                )
            if np.ptp(row) > _MOVES:
                raise InputError(
                    f"{name} of '{run.name}' moves by {np.rad2deg(np.ptp(row)):.1f} deg: give a "
                    "recording of the arm at rest"
                )
            if np.max(np.abs(row)) > _MOVES:
                raise InputError(
                    f"{name} of '{run.name}' is {np.rad2deg(row[0]):.1f} deg, but a mission starts "
                    "with a straight arm: record the arm at rest with all commands at 0"
                )
        assert run.times is not None
        times = run.times - run.times[-1]
        if -times[0] < _SHORTEST:
            raise InputError(
                f"'{run.name}' lasts {-times[0]:.1f} s: record the resting arm for at least "
                f"{_SHORTEST:g} s, preferably for a minute"
            )
        late = times >= -_LONGEST
        times = times[late] - times[late][0]
        count = int(times[-1] / _BIN)
        place = np.minimum((times / _BIN).astype(int), count - 1)
        names = tuple(
            name for name, row in run.observations.items() if np.isfinite(row[late]).any()
        )
        bins, noise = np.full((count, len(names)), np.nan), np.zeros(len(names))
        for column, name in enumerate(names):
            row = run.observations[name][late]
            there = np.isfinite(row)
            many = np.bincount(place[there], minlength=count)
            total = np.bincount(place[there], row[there], minlength=count)
            bins[many > 0, column] = total[many > 0] / many[many > 0]
            stated = run.noise(name)
            deviation = _noise(times[there], row[there]) if stated is None else stated
            if deviation is None:
                raise InputError(
                    f"{name} of '{run.name}' is sampled too slowly to separate noise from motion: "
                    "state the noise of the channel in [noise] of the sidecar"
                )
            noise[column] = deviation / np.sqrt(np.mean(many[many > 0]))
        found = cls(names, bins, noise)
        seldom = np.isnan(found.shown()).any(axis=0)
        if seldom.any():
            raise InputError(
                f"{names[int(np.argmax(seldom))]} of '{run.name}' has no two values that are "
                f"{_LATER:g} s apart: record the channel at a higher sampling rate"
            )
        return found

    @property
    def seconds(self) -> float:
        """How long it lasts, s."""
        return len(self.bins) * _BIN

    def like(self, mission: Mission, outcome: Outcome, random: np.random.Generator) -> Self:
        """What it would be of a mission that begins with so long a rest; NaN where it was lost."""
        rows = round(_BIN / (outcome.times[1] - outcome.times[0]))
        end = 1 + round((_SETTLES + self.seconds) / _BIN) * rows
        some = slice(end - len(self.bins) * rows, end)
        angles, rates = outcome.angles[some], outcome.rates[some]
        if not np.all(np.isfinite(angles)):
            return dataclasses.replace(self, bins=np.full_like(self.bins, np.nan))
        table = _shown_by(mission.model, angles, self.channels, rates, outcome.times[some])
        bins = table.reshape(len(self.bins), rows, -1).mean(axis=1)
        bins = bins + self.noise * random.normal(size=bins.shape)
        return dataclasses.replace(self, bins=np.where(np.isfinite(self.bins), bins, np.nan))

    def shown(self) -> Float[np.ndarray, "3 channel"]:
        """Mean and standard deviation of each channel, and that of its changes over 2 s."""
        later = round(_LATER / _BIN)
        with warnings.catch_warnings():
            # A channel of which nothing was recorded.
            warnings.simplefilter("ignore", RuntimeWarning)
            moves = np.nanstd(self.bins[later:] - self.bins[:-later], axis=0)
            return np.stack([np.nanmean(self.bins, axis=0), np.nanstd(self.bins, axis=0), moves])


def _shown_by(
    model: ArmModel,
    angles: Float[np.ndarray, "row joint"],
    channels: tuple[str, ...],
    rates: Float[np.ndarray, "row joint"] | None = None,
    times: Float[np.ndarray, " row"] | None = None,
) -> Float[np.ndarray, "row channel"]:
    """Channels of an arm that goes through some rows."""
    still = np.zeros_like(angles)
    times = np.arange(len(angles)) * _BIN if times is None else times
    wind = np.zeros((len(angles), 3))
    moved = logged_motion(model.arm, times, angles, still if rates is None else rates, still, wind)
    shown, _ = recorded_channels(model.sensors, lambda times, end: moved, moved.times, channels)
    return np.stack([np.asarray(shown[name]) for name in channels], axis=1)


def _noise(times: np.ndarray, values: np.ndarray) -> float | None:
    """Standard deviation of white noise, by second differences; None where rows are too far off."""
    close = times[2:] - times[:-2] < 2 * _NEIGHBOURS
    if not np.any(close):
        return None
    return float(1.4826 * np.median(np.abs(np.diff(values, 2)[close])) / np.sqrt(6))


@dataclasses.dataclass(frozen=True)
class RestedCase:
    """A mission that was flown after a rest.

    Attributes:
        case: its air and its end, after so long; what it touched, it may have touched at rest.
        shown: by its rest, as of `Resting.shown`.
    """

    case: Case
    shown: Float[np.ndarray, "3 channel"]


def fly_rested(
    mission: Mission,
    resting: Resting,
    speeds: tuple[float, float],
    count: int,
    *,
    seed: int = 0,
    on_case: Callable[[int, int], object] | None = None,
) -> tuple[RestedCase, ...]:
    """Missions of arms and air that are drawn, each after a rest as long as a recording.

    Ctrl-C ends them: those that were flown are returned.

    Arguments:
        mission: as it is drawn; its `[mission.spread]` says how arms differ from that.
        resting: the recording, whose channels they show, with its noise.
        speeds: between which that of the air is drawn, evenly, m/s.
        count: how many.
        seed: of the first; each has the next one.
        on_case: told how many there are of how many, after each.

    Raises:
        InputError: `[mission.spread]` has a parameter that the arm does not have, or the opening is
            where the arm rests.
    """
    rest = _SETTLES + resting.seconds
    section, stops = mission.section, mission.section.camera_stops_s
    later = {"limit_s": section.limit_s + rest}
    later |= {} if stops is None else {"camera_stops_s": stops + rest}
    section = section.model_copy(update=later)
    waits = Waiting(mission.controller, jnp.asarray(rest))
    waiting = dataclasses.replace(mission, section=section, controller=waits)
    waiting.case(seed)

    def fly(seed: int) -> RestedCase:
        random = np.random.default_rng([seed, 4])
        air = float(random.uniform(*speeds))
        drawn = waiting.in_wind(air).case(seed)
        outcome = drawn.fly(seed, drawn=waiting)
        if outcome.reached is not None and outcome.reached <= rest:
            raise InputError("the tip is already inside while the arm rests: give another opening")
        shown = resting.like(drawn, outcome, random).shown()
        if outcome.reached is not None:
            outcome = dataclasses.replace(outcome, reached=outcome.reached - rest)
        return RestedCase(Case.of(outcome, air, seed), shown)

    return flown_on_all_cores(fly, range(seed, seed + count), on_case)


@dataclasses.dataclass(frozen=True)
class Certificate:
    """The chance of a mission, by a recording of the resting arm.

    Attributes:
        chance: to be inside in time.
        interval: 95 % confidence interval of the chance from the number of missions; the error of
            the logistic model is not in it.
        near: the tenth of all missions whose rests were nearest to the recording.
        unlike: whether the recording is not one of the drawn rests, by Hotelling's test at 0.1 %
            for normal logarithms.
        cases: all that were flown.
        chances: of each of those, by what its own rest shows.
    """

    chance: float
    interval: tuple[float, float]
    near: tuple[Case, ...]
    unlike: bool
    cases: tuple[Case, ...]
    chances: Float[np.ndarray, " case"]

    @property
    def air(self) -> tuple[float, float, float]:
        """Speed of the air in those that looked like it: least, median and largest, m/s."""
        winds = [case.wind for case in self.near]
        return min(winds), float(np.median(winds)), max(winds)


def certificate(
    channels: Sequence[str],
    shown: Float[np.ndarray, "3 channel"],
    rested: Sequence[RestedCase],
) -> Certificate:
    """The chance of a mission by a recording, and missions that were flown after a rest.

    Arguments:
        channels: of the recording.
        shown: by it, as of `Resting.shown`.
        rested: the missions.

    Raises:
        InputError: fewer than 20 missions whose rest was followed.
    """
    known = [Channel.named(name) for name in channels]
    kinds = [(channel.kind, channel.camera) for channel in known]
    middle = np.nanmedian([each.shown[0] for each in rested], axis=0)
    features = np.array([_features(each.shown, middle, kinds) for each in rested])
    # Of a motion that was lost at rest nothing is known.
    sound = np.all(np.isfinite(features), axis=1)
    if np.sum(sound) < FEWEST_CASES:
        raise InputError(
            f"only {np.sum(sound)} of {len(rested)} missions could be simulated at rest, but a "
            f"probability needs {FEWEST_CASES}: increase --cases"
        )
    features = features[sound]
    cases = tuple(each.case for each, used in zip(rested, sound, strict=True) if used)
    inside = np.array([case.reached is not None for case in cases])
    centre, scale = features.mean(axis=0), np.maximum(features.std(axis=0), _SMALLEST)
    rows = (features - centre) / scale
    seen = (_features(shown, middle, kinds) - centre) / scale
    weights, covariance = _regression(rows, inside)
    row = np.append(1.0, seen)
    half = norm.ppf(0.975) * np.sqrt(row @ covariance @ row)
    low, chance, high = expit(row @ weights + half * np.array([-1, 0, 1]))
    metric = np.linalg.inv(np.atleast_2d(np.cov(rows.T)) + 1e-6 * np.eye(len(seen)))
    count, free = len(rows), max(len(rows) - len(seen), 1)
    # Of one more row of as many (Hotelling).
    most = (
        len(seen)
        * (count**2 - 1)
        / (count * free)
        * ratio_of_variances.isf(_UNLIKE, len(seen), free)
    )
    gaps = rows - seen
    order = np.argsort(np.einsum("ij,jk,ik->i", gaps, metric, gaps))
    return Certificate(
        chance=float(chance),
        interval=(float(low), float(high)),
        near=tuple(cases[k] for k in order[: max(1, round(_NEAR * len(cases)))]),
        unlike=bool(seen @ metric @ seen > most),
        cases=cases,
        chances=expit(weights[0] + rows @ weights[1:]),
    )


def _features(
    shown: Float[np.ndarray, "3 channel"], middle: Float[np.ndarray, " channel"], kinds: list[Any]
) -> Float[np.ndarray, " feature"]:
    """Of each kind of channel the logarithms of how far it is off, swings and moves on.

    The middle is that of the means of all missions: where the arm rests in still air.
    """
    sizes = np.stack([shown[0] - middle, shown[1], shown[2]])
    found = []
    for kind in dict.fromkeys(kinds):
        these = np.array([each == kind for each in kinds])
        found.append(np.log(np.sqrt(np.mean(sizes[:, these] ** 2, axis=1)) + 1e-9))
    return np.concatenate(found)


def _regression(
    features: Float[np.ndarray, "case feature"], inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of a logistic regression, the constant first, and their covariance (Laplace).

    In their middle there is half a success and half a failure more (Jeffreys' prior of a share), so
    that it ends where all or none succeed.
    """
    features = np.vstack([features, np.zeros(features.shape[1])])
    inside = np.append(inside, 0.5)
    table = np.column_stack([np.ones(len(features)), features])
    prior = np.array([0.0, *[_SLOPE**-2] * features.shape[1]])

    def cost(weights: np.ndarray) -> float:
        logits = table @ weights
        return float(np.sum(np.logaddexp(0, logits) - inside * logits) + prior @ weights**2 / 2)

    def slope(weights: np.ndarray) -> np.ndarray:
        return table.T @ (expit(table @ weights) - inside) + prior * weights

    def curvature(weights: np.ndarray) -> np.ndarray:
        chance = expit(table @ weights)
        return (table.T * (chance * (1 - chance))) @ table + np.diag(prior)

    start = np.zeros(table.shape[1])
    found = minimize(cost, start, method="trust-exact", jac=slope, hess=curvature)
    return found.x, np.linalg.inv(curvature(found.x))
