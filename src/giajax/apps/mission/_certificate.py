"""The chance of a mission, from a minute in which the arm rests in the air.

Missions of drawn arms in drawn air begin with the arm at rest. What a recording of that would show
is known of each, and how it ended. A logistic regression of its end on what its rest shows gives
the chance of a mission for whatever a recording shows. That is the posterior mean of success, the
summary of a recording that loses the least (Fearnhead and Prangle, J. R. Stat. Soc. B 74 (2012)
419): there is no likelihood, and no estimate of the air between. It is calibrated for arms and air
as they are drawn.
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
from scipy.stats import chi2, norm

from ...models import ArmModel, recorded_channels
from ...recordings import Channel, Run
from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError
from ._cases import Case, flown_on_all_cores
from ._controller import AbstractController, Picture, Scene, number
from ._mission import Mission, Outcome, motion

_SETTLES = 120.0  # s that an arm is in the air before its recording begins
_SHORTEST, _LONGEST = 30.0, 120.0  # of a recording, s; of a longer one the end
_BIN, _LATER = 0.5, 2.0  # s of a mean, and between two that are compared
_MOVES = np.deg2rad(0.5)  # a command that moves by more is no rest
# Standard deviation of the prior of a logistic regression of standardised features, weakly
# informative (Gelman et al., Ann. Appl. Stat. 2 (2008) 1360).
_SLOPE = 2.5
_SMALLEST = 0.01  # deviation of a feature, a logarithm: below it is a constant
_FEWEST = 20  # missions
_NEAR = 0.1  # of all missions, those that are shown beside the recording
_UNLIKE = 0.999  # of drawn rests, the share that are nearer to their middle than what is unlike


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
            InputError: nothing was measured, a channel that the model of the arm does not show,
                commands that move or are not those of the straight arm, less than half a minute,
                or a channel that was recorded too seldom.
        """
        run.require_observations()
        model.prepare(run)
        for name, row in run.commands.items():
            if np.ptp(row) > _MOVES:
                raise InputError(
                    f"{name} of '{run.name}' moves by {np.rad2deg(np.ptp(row)):.1f} deg: give a "
                    "recording in which the arm rests"
                )
            if np.max(np.abs(row)) > _MOVES:
                raise InputError(
                    f"{name} of '{run.name}' is {np.rad2deg(row[0]):.1f} deg, and a mission begins "
                    "with the straight arm: record it at rest with all commands 0"
                )
        assert run.times is not None
        times = run.times - run.times[-1]
        if -times[0] < _SHORTEST:
            raise InputError(
                f"'{run.name}' lasts {-times[0]:.0f} s: record the resting arm for at least "
                f"{_SHORTEST:g} s, better for a minute"
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
            deviation = _noise(row[there]) if stated is None else stated
            noise[column] = deviation / np.sqrt(np.mean(many[many > 0]))
        found = cls(names, bins, noise)
        seldom = np.isnan(found.shown()).any(axis=0)
        if seldom.any():
            raise InputError(
                f"{names[int(np.argmax(seldom))]} of '{run.name}' has no two values {_LATER:g} s "
                "apart: record it more often"
            )
        return found

    @property
    def seconds(self) -> float:
        """How long it lasts, s."""
        return len(self.bins) * _BIN

    def like(self, mission: Mission, outcome: Outcome, random: np.random.Generator) -> Self:
        """What it would be of a mission that begins with so long a rest; NaN where that was lost."""
        rows = round(_BIN / (outcome.times[1] - outcome.times[0]))
        end = 1 + round((_SETTLES + self.seconds) / _BIN) * rows
        some = slice(end - len(self.bins) * rows, end)
        names = ("times", "angles", "rates", "command", "wind")
        rested: Any = {name: getattr(outcome, name)[some] for name in names}
        if not np.all(np.isfinite(rested["angles"])):
            return dataclasses.replace(self, bins=np.full_like(self.bins, np.nan))
        moved = motion(mission, dataclasses.replace(outcome, **rested))
        shown, _ = recorded_channels(
            mission.model.sensors, lambda times, end: moved, moved.times, self.channels
        )
        table = np.stack([np.asarray(shown[name]) for name in self.channels], axis=1)
        bins = table.reshape(len(self.bins), rows, -1).mean(axis=1)
        bins = bins + self.noise * random.normal(size=bins.shape)
        return dataclasses.replace(self, bins=np.where(np.isfinite(self.bins), bins, np.nan))

    def shown(self) -> Float[np.ndarray, "3 channel"]:
        """Of each channel its mean, how far it swings about that, and by how much it moves on."""
        later = round(_LATER / _BIN)
        with warnings.catch_warnings():
            # A channel of which nothing was recorded.
            warnings.simplefilter("ignore", RuntimeWarning)
            moves = np.nanstd(self.bins[later:] - self.bins[:-later], axis=0)
            return np.stack([np.nanmean(self.bins, axis=0), np.nanstd(self.bins, axis=0), moves])


def _noise(values: np.ndarray) -> float:
    """Standard deviation of white noise, by second differences that are no outliers."""
    if len(values) < 3:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(values, 2))) / np.sqrt(6))


@dataclasses.dataclass(frozen=True)
class RestedCase:
    """A mission that was flown after a rest.

    Attributes:
        case: its air and its end; times are those after the rest.
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
        InputError: `[mission.spread]` has a parameter that the arm does not have.
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
        interval: between which the chance is, with 95 %: so many missions leave that open.
        near: missions whose rests looked most like the recording, a tenth of all.
        unlike: whether hardly any rest was so far from the others.
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


def certificate(resting: Resting, rested: Sequence[RestedCase]) -> Certificate:
    """The chance of a mission by a recording, and missions that were flown after a rest.

    Raises:
        InputError: fewer than 20 missions whose rest was followed.
    """
    known = [Channel.named(name) for name in resting.channels]
    kinds = [(channel.kind, channel.camera) for channel in known]
    middle = np.nanmedian([each.shown[0] for each in rested], axis=0)
    features = np.array([_features(each.shown, middle, kinds) for each in rested])
    # Of a motion that was lost at rest nothing is known.
    sound = np.all(np.isfinite(features), axis=1)
    if np.sum(sound) < _FEWEST:
        raise InputError(f"{np.sum(sound)} missions were flown: fly at least {_FEWEST}")
    features = features[sound]
    cases = tuple(each.case for each, used in zip(rested, sound, strict=True) if used)
    inside = np.array([case.reached is not None for case in cases])
    centre, scale = features.mean(axis=0), np.maximum(features.std(axis=0), _SMALLEST)
    rows = (features - centre) / scale
    seen = (_features(resting.shown(), middle, kinds) - centre) / scale
    weights, covariance = _regression(rows, inside)
    row = np.append(1.0, seen)
    half = norm.ppf(0.975) * np.sqrt(row @ covariance @ row)
    low, chance, high = expit(row @ weights + half * np.array([-1, 0, 1]))
    metric = np.linalg.inv(np.atleast_2d(np.cov(rows.T)) + 1e-6 * np.eye(len(seen)))
    gaps = rows - seen
    order = np.argsort(np.einsum("ij,jk,ik->i", gaps, metric, gaps))
    return Certificate(
        chance=float(chance),
        interval=(float(low), float(high)),
        near=tuple(cases[k] for k in order[: max(1, round(_NEAR * len(cases)))]),
        unlike=bool(seen @ metric @ seen > chi2.ppf(_UNLIKE, len(seen))),
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
