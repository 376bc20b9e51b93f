"""The filter and the smoother over events, of whatever moves and is measured.

Both are linearised where the filter is, or about states that are given: the smoothed ones of a pass
before, so that filter and smoother once more are a Gauss-Newton step of the whole run (Bell, The
iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optimization 4 (1994) 626).

That a parameter has changed is told by what a change at each of some past times would have done to
what was measured since (Willsky and Jones, A generalized likelihood ratio approach to the detection
and estimation of jumps in linear systems, IEEE Trans. Automatic Control 21 (1976) 108).
"""

import math
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Bool, Float, Int
from ...runtime.programs import program
from ._filter import Correction, Gaussian, Innovation, measured, moved, root_of_sum, smoothed


class System(Protocol):
    """What is tracked: a pytree with these methods.

    Attributes:
        noise: standard deviations of its channels.
    """

    noise: Array

    def moved(self, vector: Array, held: Any) -> tuple[Array, Array, Array]:
        """Where a state moves to in an interval, its derivatives, a root of what is added."""

    def shown(self, vector: Array, held: Any) -> tuple[Array, Array]:
        """Channels at the end of an interval, and their derivatives."""


class Learning(NamedTuple):
    """What is said of events to a filter that estimates parameters.

    Attributes:
        length: of the interval before each, s.
        moves: whether what is tracked has moved lately, so that measurements show parameters.
        loosened: by which states may have changed just before each interval, as a column of a root
            of their covariance.
    """

    length: Float[Array, " event"]
    moves: Bool[Array, " event"]
    loosened: Float[Array, "event state"]


class Events(NamedTuple):
    """Times at which something is measured or an interval ends, in their order.

    Attributes:
        held: what is known of the interval before each.
        values: measured channels, SI, shape (event, channel).
        there: which of them were measured.
        learning: of a filter with a watch; None without one.
    """

    held: Any
    values: Float[Array, "event channel"]
    there: Bool[Array, "event channel"]
    learning: Learning | None = None


_SLOTS = 20  # times at which a change may have been
_LARGEST = 3.0  # of a change, over its deviation
EVERY = 2.0
"""Interval between the times at which a change is tested, s."""


class Watch(NamedTuple):
    """What changes of some states, at each of some past times, would have done since.

    Attributes:
        directions: of the states, for each kind of change, as large as it may be expected to be
            (a standard deviation), shape (change, state).
        effect: on the state minus its estimate, shape (change, slot, state).
        score: of the log-likelihood by the size of each change, shape (change, slot).
        information: likewise, shape (change, slot).
        misfit: square of all innovations since then, as numbers of deviation 1, shape (slot,).
        number: of them, shape (slot,).
        ages: since then, s, shape (slot,).
    """

    directions: Float[Array, "change state"]
    effect: Float[Array, "change slot state"]
    score: Float[Array, "change slot"]
    information: Float[Array, "change slot"]
    misfit: Float[Array, " slot"]
    number: Float[Array, " slot"]
    ages: Float[Array, " slot"]


class Suspected(NamedTuple):
    """The change that explains most of what was measured.

    Attributes:
        square: its size over the deviation of that, squared; of the right model chi-square of 1
            at most. Where innovations are larger than expected also without it, it is as many times
            less.
        which: of the changes.
        age: since then, s.
        size: by which it changed.
        deviation: of that.
    """

    square: Float[Array, " event"]
    which: Int[Array, " event"]
    age: Float[Array, " event"]
    size: Float[Array, " event"]
    deviation: Float[Array, " event"]


def watching(directions: Array) -> Watch:
    """A watch that begins."""
    shape = (directions.shape[0], _SLOTS)
    return Watch(
        directions,
        jnp.zeros((*shape, directions.shape[1])),
        jnp.zeros(shape),
        jnp.zeros(shape),
        jnp.zeros(_SLOTS),
        jnp.zeros(_SLOTS),
        jnp.full(_SLOTS, jnp.inf),
    )


def _watched(
    watch: Watch,
    learning: Learning,
    slope: Array,
    shows: Array,
    used: Array,
    correction: Correction,
    innovation: Innovation,
) -> tuple[Watch, Suspected]:
    """A watch after one more event, whose motion and measurements have these slopes.

    Where nothing moves, parameters are considered: innovations are off by their errors, all alike,
    and say nothing of changes.
    """
    effect = watch.effect @ slope.T
    off = jnp.where(used, effect @ shows.T, 0)
    white = jax.scipy.linalg.solve_triangular(
        correction.factor, off.reshape(-1, off.shape[-1]).T, lower=True
    ).T.reshape(off.shape)
    white = jnp.where(learning.moves, white, 0)
    score = watch.score + white @ innovation.whitened
    information = watch.information + jnp.sum(white**2, axis=-1)
    effect = effect - off @ correction.gain.T
    counts = used & learning.moves
    misfit = watch.misfit + jnp.sum(jnp.where(counts, innovation.whitened, 0) ** 2)
    number = watch.number + jnp.sum(counts, dtype=misfit.dtype)
    # A change is as likely as it is said to be, and what would have to be larger is none.
    size = score / (information + 1)
    square = jnp.where(jnp.abs(size) < _LARGEST, score * size, 0)
    # What is wrong with the model otherwise looks like changes, too.
    left = (misfit[None] - square) / jnp.maximum(number - 1, 1)[None]
    square = square / jnp.maximum(left, 1)
    ages = watch.ages + learning.length
    which, slot = jnp.unravel_index(jnp.argmax(square), square.shape)
    unit = jnp.linalg.norm(watch.directions[which])
    suspected = Suspected(
        square[which, slot],
        which,
        ages[slot],
        unit * size[which, slot],
        unit / jnp.sqrt(information[which, slot] + 1),
    )
    # The oldest time makes room for this one.
    fresh = (jnp.arange(_SLOTS) == jnp.argmax(ages)) & (jnp.min(ages) >= EVERY)
    watch = watch._replace(
        effect=jnp.where(fresh[None, :, None], watch.directions[:, None], effect),
        score=jnp.where(fresh[None], 0, score),
        information=jnp.where(fresh[None], 0, information),
        misfit=jnp.where(fresh, 0, misfit),
        number=jnp.where(fresh, 0, number),
        ages=jnp.where(fresh, 0, ages),
    )
    return watch, suspected


class Followed(NamedTuple):
    """The state, how many measurements of each channel were left out in a row, and a watch."""

    state: Gaussian
    left_out: Int[Array, " channel"]
    watch: Watch | None = None


class Motion(NamedTuple):
    """Of each interval: where the mean moves to, its slope by the state before, added noise."""

    mean: Float[Array, "event state"]
    slope: Float[Array, "event state state"]
    noise: Float[Array, "event state noise"]


class Filtered(NamedTuple):
    """Of each event: the state by all that was measured until then, and what that was beside.

    `motion` is that of the interval before it, `used` is which measurements counted; `left_out` is
    that of `Followed`, and `suspected` is of its watch.
    """

    state: Gaussian
    motion: Motion
    innovation: Innovation
    used: Bool[Array, "event channel"]
    left_out: Int[Array, "event channel"]
    suspected: Suspected | None = None


GATE = 5.0
"""Standard deviations beyond which a measurement is rejected as an outlier."""

_IN_A_ROW = 5  # of outliers; what goes on after that is no outlier, and the state is wrong


@program
def filtered(
    system: System,
    start: Followed,
    events: Events,
    estimated: Array,
    gate: Array,
    blind: Array,
    about: tuple[Array, Array] | None = None,
    count: Array | None = None,
) -> tuple[Followed, Filtered]:
    """The filter over all events: what is known after the last, and after each.

    `blind`: as if each measured value were the expected one. `about`: the states before and after
    each interval about which it is linearised, shapes (event, state); where they are NaN, and by
    default, those of the filter. Only the first `count` events are, all by default.
    """
    size = events.values.shape[0]
    real = jnp.arange(size) < (size if count is None else count)

    def one(before: Followed, given: Any) -> tuple[Followed, Filtered]:
        event, about, real = given
        after, found = _one(system, before, event, estimated, gate, blind, about)
        return jax.tree.map(lambda new, old: jnp.where(real, new, old), after, before), found

    return jax.lax.scan(one, start, (events, about, real))


@program
def followed_by(
    system: System, before: Followed, event: Events, estimated: Array, gate: Array
) -> tuple[Followed, Filtered]:
    """The filter over one event."""
    return _one(system, before, event, estimated, gate, jnp.asarray(False), None)


def _one(
    system: System,
    before: Followed,
    event: Events,
    estimated: Array,
    gate: Array,
    blind: Array,
    about: tuple[Array, Array] | None,
) -> tuple[Followed, Filtered]:
    state, left_out, watch = before
    at = state.mean if about is None else jnp.where(jnp.isfinite(about[0]), about[0], state.mean)
    mean, slope, noise = system.moved(at, event.held)
    learning = event.learning
    if watch is not None and learning is not None:
        noise = jnp.concatenate([noise, (slope @ learning.loosened)[:, None]], axis=1)
        # What is allowed for from here on is not asked about before.
        anew = jnp.any(learning.loosened != 0)
        begun = watching(watch.directions)
        watch = jax.tree.map(lambda new, old: jnp.where(anew, new, old), begun, watch)
        estimated &= learning.moves | ~jnp.any(watch.directions != 0, axis=0)
    motion = Motion(mean + slope @ (state.mean - at), slope, noise)
    state = moved(state, *motion)
    at = state.mean if about is None else jnp.where(jnp.isfinite(about[1]), about[1], state.mean)
    shown, slope = system.shown(at, event.held)
    shown = shown + slope @ (state.mean - at)
    off = jnp.where(blind, 0, event.values - shown)
    expected = jnp.sqrt(jnp.sum((slope @ state.root) ** 2, axis=1) + system.noise**2)
    near = jnp.abs(off) <= gate * expected
    used = event.there & (near | (left_out >= _IN_A_ROW))
    state, innovation, correction = measured(
        state, off, slope, system.noise, there=event.there, used=used, estimated=estimated
    )
    suspected = None
    if watch is not None and learning is not None:
        both = (motion.slope, slope)
        watch, suspected = _watched(watch, learning, *both, used, correction, innovation)
    # An outlier is as likely as one at the gate, so that nothing is gained by leaving more out.
    outside = -0.5 * gate**2 - jnp.log(expected) - 0.5 * math.log(2 * math.pi)
    likelihood = jnp.sum(jnp.where(event.there & ~used, outside, 0))
    innovation = innovation._replace(log_likelihood=innovation.log_likelihood + likelihood)
    left_out = jnp.where(event.there, jnp.where(near, 0, left_out + 1), left_out)
    found = Filtered(state, motion, innovation, used, left_out, suspected)
    return Followed(state, left_out, watch), found


@program
def smoothed_states(after: Gaussian, states: Gaussian, motions: Motion, there: Array) -> Gaussian:
    """The smoother over filtered states, each with the motion that follows it.

    `after` is the state after the last of them, by everything; of those that are not `there` it is
    passed on.
    """

    def one(after: Gaussian, given: Any) -> tuple[Gaussian, Gaussian]:
        before, motion, there = given
        found = smoothed(before, motion.mean, motion.slope, motion.noise, after)
        found = jax.tree.map(lambda new, old: jnp.where(there, new, old), found, after)
        return found, found

    return jax.lax.scan(one, after, (states, motions, there), reverse=True)[1]


@program
def predicted(system: System, states: Gaussian, held: Any) -> Gaussian:
    """Each state after some more intervals, in which nothing is measured.

    `held` has the axes of the states and of the intervals.
    """

    def one(given: Any) -> Gaussian:
        state, intervals = given

        def on(state: Gaussian, held: Any) -> tuple[Gaussian, None]:
            return moved(state, *system.moved(state.mean, held)), None

        return jax.lax.scan(on, state, intervals)[0]

    found: Gaussian = jax.lax.map(one, (states, held))
    return found


@program
def rested(start: Gaussian, motion: Motion, doublings: int) -> Gaussian:
    """What is known of what has stood for 2^doublings intervals where it rests.

    By the derivatives there: the covariance of a sum of so many intervals, in so many products.
    """

    def twice(_: int, both: tuple[Array, Array]) -> tuple[Array, Array]:
        slope, added = both
        return slope @ slope, root_of_sum(slope @ added, added)

    begun = (motion.slope, root_of_sum(motion.noise))
    slope, added = jax.lax.fori_loop(0, doublings, twice, begun)
    return Gaussian(start.mean, root_of_sum(slope @ start.root, added))
