"""Probability of the success of a mission, from a recording of the arm at rest.

Simulated missions with random arms in random wind begin with the arm at rest. For each mission,
both the recording of its rest and its success are therefore known. A logistic regression of the
success on a few summary statistics of each rest estimates the probability of success for the
statistics of a real recording. This is simulation-based (likelihood-free) inference, with a
regression instead of a posterior (Fearnhead and Prangle, J. R. Stat. Soc. B 74 (2012) 419). The
probability depends on the distributions of the arms and of the wind.
"""

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, fdtri, ndtri

from ...models import ArmModel, recorded_channels
from ...recordings import Channel, Run
from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError
from ..synthetic import logged_motion
from ._cases import Case, flown_on_all_cores
from ._controller import AbstractController, Picture, Scene, number
from ._mission import Mission, Outcome

_SETTLES = 120.0  # simulated time in the wind before a recording begins, s
_SHORTEST, _LONGEST = 30.0, 120.0  # durations of a recording, s; a longer one is cut to its end
_BIN, _LATER = 0.5, 2.0  # averaging time, and lag between two means that are compared, s
_MOVES = np.deg2rad(0.5)  # largest range of a command at rest, rad
# Standard deviation of the prior of a logistic regression of standardised features, weakly
# informative (Gelman et al., Ann. Appl. Stat. 2 (2008) 1360).
_SLOPE = 2.5
_SMALLEST = 0.01  # smallest standard deviation by which a feature (a logarithm) is divided
_NEIGHBOURS = 0.2  # largest distance of rows whose differences are noise rather than motion, s
FEWEST_CASES = 20
"""Smallest number of missions for a certificate."""

_NEAR = 0.1  # fraction of the missions that counts as nearest to the recording
_UNLIKE = 0.001  # significance level of the test whether a recording is unlike the simulated rests


class Waiting(AbstractController):
    """Controller that holds the commands constant for a time, and then uses another controller.

    Attributes:
        controller: controller that starts after the waiting time.
        seconds: waiting time, s.
    """

    controller: AbstractController
    seconds: Scalar = number(0.0)

    def start(self, scene: Scene, late: int) -> Any:
        """Return the memory of the other controller, and the time."""
        return self.controller.start(scene, late), jnp.zeros_like(scene.interval)

    def decide(
        self, scene: Scene, memory: Any, picture: Picture, command: Array
    ) -> tuple[Any, Float[Array, " joint"]]:
        """Return the decision of the other controller after the waiting time."""
        inner, time = memory
        inner, after = jax.lax.cond(
            time < self.seconds - scene.interval / 2,
            lambda: (inner, command),
            lambda: self.controller.decide(scene, inner, picture, command),
        )
        return (inner, time + scene.interval), after

    def believed(self, scene: Scene, memory: Any) -> Float[Array, "3"]:
        """Return the estimate of the other controller."""
        return self.controller.believed(scene, memory[0])


@dataclasses.dataclass(frozen=True)
class Resting:
    """Recording of the arm at rest.

    Attributes:
        channels: names of the channels.
        bins: mean of each channel over each half second, SI units; NaN where no value was recorded.
        noise: standard deviation of the noise of such a mean.
    """

    channels: tuple[str, ...]
    bins: Float[np.ndarray, "bin channel"]
    noise: Float[np.ndarray, " channel"]

    @classmethod
    def from_run(cls, run: Run, model: ArmModel) -> Self:
        """Return the recording of a run; of a longer run, only the last two minutes are used.

        Raises:
            InputError: the run has no measurements, or a channel that the model of the arm predicts
                only by integration; it has no commands, or commands that are not angles, that move,
                or that do not belong to a straight arm; it is shorter than half a minute; a channel
                has too few samples; or the noise of a channel is not given and cannot be separated
                from the motion.
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
                    f"'{run.name}' is driven by {name}, but a mission is driven by commanded "
                    "angles: give a run with commanded angles"
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
                f"'{run.name}' lasts only {-times[0]:.1f} s: record the resting arm for at least "
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
                    "give the noise of the channel in [noise] of the sidecar"
                )
            noise[column] = deviation / np.sqrt(np.mean(many[many > 0]))
        found = cls(names, bins, noise)
        seldom = np.isnan(found.shown()).any(axis=0)
        if seldom.any():
            raise InputError(
                f"{names[int(np.argmax(seldom))]} of '{run.name}' does not have two values that "
                f"are {_LATER:g} s apart: record the channel at a higher sampling rate"
            )
        return found

    @property
    def seconds(self) -> float:
        """Duration of the recording, s."""
        return len(self.bins) * _BIN

    def like(self, mission: Mission, outcome: Outcome, random: np.random.Generator) -> Self:
        """Return the same recording of a simulated mission after an equally long rest.

        The values are NaN if the simulation failed during the rest.
        """
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
        """Return the summary statistics of each channel.

        The rows are the mean, the standard deviation, and the standard deviation of the changes
        over 2 s.
        """
        later = round(_LATER / _BIN)
        with warnings.catch_warnings():
            # A channel without recorded values would cause a warning.
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
    """Return channels of an arm that passes through given rows of angles."""
    still = np.zeros_like(angles)
    times = np.arange(len(angles)) * _BIN if times is None else times
    wind = np.zeros((len(angles), 3))
    moved = logged_motion(model.arm, times, angles, still if rates is None else rates, still, wind)
    shown, _ = recorded_channels(model.sensors, lambda times, end: moved, moved.times, channels)
    return np.stack([np.asarray(shown[name]) for name in channels], axis=1)


def _noise(times: np.ndarray, values: np.ndarray) -> float | None:
    """Return the standard deviation of white noise from second differences.

    The result is None if the rows are too far apart.
    """
    close = times[2:] - times[:-2] < 2 * _NEIGHBOURS
    if not np.any(close):
        return None
    return float(1.4826 * np.median(np.abs(np.diff(values, 2)[close])) / np.sqrt(6))


@dataclasses.dataclass(frozen=True)
class RestedCase:
    """Simulated mission after a rest.

    Attributes:
        case: result of the mission; contacts can have occurred during the rest.
        shown: statistics of its rest, from `Resting.shown`.
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
    """Simulate missions of random arms in random wind, each after a rest as long as a recording.

    Ctrl-C stops the simulation, and the completed missions are returned.

    Arguments:
        mission: nominal mission; `[mission.spread]` gives the spread of the arms about it.
        resting: recording, whose channels and noise are simulated.
        speeds: smallest and largest wind speed of a uniform distribution, m/s.
        count: number of missions.
        seed: seed of the first mission; each further mission uses the next integer.
        on_case: function that is called after each mission with the completed and the total number.

    Raises:
        InputError: `[mission.spread]` has a parameter that the arm does not have, or the resting
            arm is already inside the opening.
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
            raise InputError(
                "the tip is already inside the opening when the arm is at rest: give another "
                "opening"
            )
        shown = resting.like(drawn, outcome, random).shown()
        if outcome.reached is not None:
            outcome = dataclasses.replace(outcome, reached=outcome.reached - rest)
        return RestedCase(Case.of(outcome, air, seed), shown)

    return flown_on_all_cores(fly, range(seed, seed + count), on_case)


@dataclasses.dataclass(frozen=True)
class Certificate:
    """Probability of success of a mission, given a recording of the arm at rest.

    Attributes:
        chance: probability that the tip is inside the opening in time.
        interval: 95 % confidence interval of the probability due to the finite number of missions;
            it does not include the error of the logistic model.
        near: tenth of all missions whose rests are nearest to the recording.
        unlike: whether the recording differs from the simulated rests, by Hotelling's test at the
            level of 0.1 %, for normally distributed logarithms.
        cases: all missions that were simulated from rest.
        chances: probability of each of these missions, estimated from its own rest.
    """

    chance: float
    interval: tuple[float, float]
    near: tuple[Case, ...]
    unlike: bool
    cases: tuple[Case, ...]
    chances: Float[np.ndarray, " case"]

    @property
    def air(self) -> tuple[float, float, float]:
        """Smallest, median and largest wind speed of the missions nearest to the recording, m/s."""
        winds = [case.wind for case in self.near]
        return min(winds), float(np.median(winds)), max(winds)


def certificate(
    channels: Sequence[str],
    shown: Float[np.ndarray, "3 channel"],
    rested: Sequence[RestedCase],
) -> Certificate:
    """Estimate the probability of success from a recording and missions simulated after a rest.

    Arguments:
        channels: channels of the recording.
        shown: statistics of the recording, from `Resting.shown`.
        rested: simulated missions.

    Raises:
        InputError: the rest could be simulated in fewer than 20 missions.
    """
    known = [Channel.named(name) for name in channels]
    kinds = [(channel.kind, channel.camera) for channel in known]
    middle = np.nanmedian([each.shown[0] for each in rested], axis=0)
    features = np.array([_features(each.shown, middle, kinds) for each in rested])
    # A mission whose simulation failed at rest has no features.
    sound = np.all(np.isfinite(features), axis=1)
    if np.sum(sound) < FEWEST_CASES:
        raise InputError(
            f"only {np.sum(sound)} of {len(rested)} missions could be simulated at rest, but a "
            f"probability needs at least {FEWEST_CASES}: increase --cases"
        )
    features = features[sound]
    cases = tuple(each.case for each, used in zip(rested, sound, strict=True) if used)
    inside = np.array([case.reached is not None for case in cases])
    centre, scale = features.mean(axis=0), np.maximum(features.std(axis=0), _SMALLEST)
    rows = (features - centre) / scale
    seen = (_features(shown, middle, kinds) - centre) / scale
    weights, covariance = _regression(rows, inside)
    row = np.append(1.0, seen)
    half = ndtri(0.975) * np.sqrt(row @ covariance @ row)
    low, chance, high = expit(row @ weights + half * np.array([-1, 0, 1]))
    metric = np.linalg.inv(np.atleast_2d(np.cov(rows.T)) + 1e-6 * np.eye(len(seen)))
    count, free = len(rows), max(len(rows) - len(seen), 1)
    # Limit of Hotelling's statistic for one new row.
    quantile = fdtri(len(seen), free, 1 - _UNLIKE)  # `scipy.stats` is slow to import
    most = len(seen) * (count**2 - 1) / (count * free) * quantile
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
    """Return the logarithms of the deflection, swing and 2 s changes of each kind of channel.

    `middle` is the median of the means of all missions, which approximates the rest in still air.
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
    """Return the weights of a logistic regression, constant first, and their Laplace covariance.

    An additional half success and half failure at the mean of the features (Jeffreys' prior of a
    proportion) keep the estimate finite if all missions or none succeed.
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
