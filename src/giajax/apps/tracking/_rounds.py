"""Extended Kalman filter and smoother over events, for any system.

Both are linearised about the estimate of the filter, or about given states. If these are the
smoothed states of an earlier pass, another pass of filter and smoother is a Gauss-Newton step for
the whole run (Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optimization 4
(1994) 626).

A change of a parameter is detected from the effect that a change at each of several past times
would have had on the measurements since then (Willsky and Jones, A generalized likelihood ratio
approach to the detection and estimation of jumps in linear systems, IEEE Trans. Automatic Control
21 (1976) 108).
"""

import math
from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Bool, Float, Int
from ...runtime.programs import program, traced_once
from ._filter import Correction, Gaussian, Innovation, measured, moved, root_of_sum, smoothed


class System(Protocol):
    """System that is tracked: a pytree with these methods.

    Attributes:
        noise: standard deviations of the noise of its channels.
    """

    noise: Array

    def moved(self, vector: Array, held: Any) -> tuple[Array, Array, Array]:
        """Return the state after an interval, its derivatives, and the root of the added noise."""

    def shown(self, vector: Array, held: Any) -> tuple[Array, Array]:
        """Return the channels at the end of an interval, and their derivatives."""


class Learning(NamedTuple):
    """Additional data of events for a filter that estimates parameters.

    Attributes:
        length: length of the interval before each event, s.
        moves: whether the system has recently moved, so that measurements contain information on
            parameters.
        loosened: possible change of the states just before each interval, as a column of a root of
            their covariance.
    """

    length: Float[Array, " event"]
    moves: Bool[Array, " event"]
    loosened: Float[Array, "event state"]


class Events(NamedTuple):
    """Measurements and ends of intervals, in order of time.

    Attributes:
        held: known inputs of the interval before each event.
        values: measured values, SI units, shape (event, channel).
        there: whether each channel was measured.
        learning: additional data for a filter with a watch; None without one.
    """

    held: Any
    values: Float[Array, "event channel"]
    there: Bool[Array, "event channel"]
    learning: Learning | None = None


_SLOTS = 20  # number of candidate times of a change
_LARGEST = 3.0  # largest accepted change, relative to its prior standard deviation
EVERY = 2.0
"""Interval between the times at which a change is tested, s."""


class Watch(NamedTuple):
    """Detector of changes of some states at several past candidate times (slots).

    Attributes:
        directions: direction of each kind of change in the state, scaled by its prior standard
            deviation, shape (change, state).
        effect: effect of each change on the error of the estimate, shape (change, slot, state).
        score: derivative of the log-likelihood with respect to the size of each change, shape
            (change, slot).
        information: Fisher information on the size of each change, shape (change, slot).
        misfit: sum of the squared whitened innovations since each candidate time, shape (slot,).
        number: number of these innovations, shape (slot,).
        ages: time since each candidate time, s, shape (slot,).
    """

    directions: Float[Array, "change state"]
    effect: Float[Array, "change slot state"]
    score: Float[Array, "change slot"]
    information: Float[Array, "change slot"]
    misfit: Float[Array, " slot"]
    number: Float[Array, " slot"]
    ages: Float[Array, " slot"]


class Suspected(NamedTuple):
    """Change that explains the measurements best.

    Attributes:
        square: squared ratio of its size to its standard deviation; for a correct model without a
            change, at most chi-squared with 1 degree of freedom for each candidate. It is divided
            by the mean square of the remaining innovations if these are larger than expected.
        which: index of the kind of change.
        age: time since the change, s.
        size: size of the change.
        deviation: standard deviation of the size.
    """

    square: Float[Array, " event"]
    which: Int[Array, " event"]
    age: Float[Array, " event"]
    size: Float[Array, " event"]
    deviation: Float[Array, " event"]


def watching(directions: Array) -> Watch:
    """Return a new watch for changes in some directions."""
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
    """Update a watch with one more event.

    At rest, the parameters are consider parameters. The innovations then contain the constant
    effect of their errors, and no information on changes.

    Arguments:
        watch: watch before the event.
        learning: additional data of the event.
        slope: derivatives of the motion.
        shows: derivatives of the measurements.
        used: whether each measurement was used.
        correction: correction of the state by the measurements.
        innovation: innovation of the measurements.
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
    # The estimate includes the prior of the change; changes far beyond this prior are rejected.
    size = score / (information + 1)
    square = jnp.where(jnp.abs(size) < _LARGEST, score * size, 0)
    # Other errors of the model also resemble changes, so divide by the remaining misfit.
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
    # The current time replaces the oldest candidate.
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
    """State of a filter.

    Attributes:
        state: estimate.
        left_out: number of consecutive outliers of each channel.
        watch: detector of changes, if any.
    """

    state: Gaussian
    left_out: Int[Array, " channel"]
    watch: Watch | None = None


class Motion(NamedTuple):
    """Motion in each interval.

    Attributes:
        mean: mean after the interval.
        slope: derivatives of this mean with respect to the state before the interval.
        noise: square root of the covariance that the interval adds.
    """

    mean: Float[Array, "event state"]
    slope: Float[Array, "event state state"]
    noise: Float[Array, "event state noise"]


class Filtered(NamedTuple):
    """Results of the filter for each event.

    Attributes:
        state: estimate from all measurements up to the event.
        motion: motion in the interval before the event.
        innovation: innovation of the measurements.
        used: whether each measurement was used.
        left_out: number of consecutive outliers of each channel.
        suspected: best explanation by a change, if changes are watched.
    """

    state: Gaussian
    motion: Motion
    innovation: Innovation
    used: Bool[Array, "event channel"]
    left_out: Int[Array, "event channel"]
    suspected: Suspected | None = None


GATE = 5.0
"""Standard deviations beyond which a measurement is rejected as an outlier."""

_IN_A_ROW = 5  # consecutive outliers after which a measurement is used, as the state may be wrong


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
    """Run the filter over events.

    Arguments:
        system: system that is tracked.
        start: initial state of the filter.
        events: events in order of time.
        estimated: whether each state is estimated.
        gate: innovation, in standard deviations, above which a measurement is not used.
        blind: replace each measured value by its prediction.
        about: states before and after each interval about which the system is linearised, shapes
            (event, state); by default, and where they are NaN, those of the filter.
        count: number of first events that are processed; defaults to all. The results of the others
            are zero.

    Returns:
        The state of the filter after the last event, and the results for each event.
    """
    size = events.values.shape[0]
    real = jnp.arange(size) < (size if count is None else count)

    def one(before: Followed, given: Any) -> tuple[Followed, Filtered]:
        event, about, real = given
        step = (system, before, event, estimated, gate, blind, about)
        nothing = jax.tree.map(jnp.zeros_like, eqx.filter_eval_shape(_one, *step)[1])
        return jax.lax.cond(real, lambda: _one(*step), lambda: (before, nothing))

    return jax.lax.scan(one, start, (events, about, real))


@program
def followed_by(
    system: System, before: Followed, event: Events, estimated: Array, gate: Array
) -> tuple[Followed, Filtered]:
    """Run the filter over one event."""
    return _one(system, before, event, estimated, gate, jnp.asarray(False), None)


@traced_once
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
        # Restart the watch at a change that is already allowed for.
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
    # An outlier has the likelihood of a measurement at the gate, so that rejecting measurements
    # does not increase the likelihood.
    outside = -0.5 * gate**2 - jnp.log(expected) - 0.5 * math.log(2 * math.pi)
    likelihood = jnp.sum(jnp.where(event.there & ~used, outside, 0))
    innovation = innovation._replace(log_likelihood=innovation.log_likelihood + likelihood)
    left_out = jnp.where(event.there, jnp.where(near, 0, left_out + 1), left_out)
    found = Filtered(state, motion, innovation, used, left_out, suspected)
    return Followed(state, left_out, watch), found


@program
def smoothed_states(after: Gaussian, states: Gaussian, motions: Motion, there: Array) -> Gaussian:
    """Run the smoother over filtered states.

    Arguments:
        after: smoothed state after the last of them.
        states: filtered states.
        motions: motion that follows each state.
        there: whether each state is real; the smoothed state is passed on unchanged over others.
    """

    def one(after: Gaussian, given: Any) -> tuple[Gaussian, Gaussian]:
        before, motion, there = given
        step = (before, motion.mean, motion.slope, motion.noise, after)
        found = jax.lax.cond(there, lambda: smoothed(*step), lambda: after)
        return found, found

    return jax.lax.scan(one, after, (states, motions, there), reverse=True)[1]


@program
def predicted(system: System, states: Gaussian, held: Any) -> Gaussian:
    """Predict each state over several intervals without measurements.

    The first axes of `held` are the states and the intervals.
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
    """Return the distribution of a system that has been at rest for 2^doublings intervals.

    The covariance of all intervals follows from the derivatives at rest by repeated doubling.
    """

    def twice(_: int, both: tuple[Array, Array]) -> tuple[Array, Array]:
        slope, added = both
        return slope @ slope, root_of_sum(slope @ added, added)

    begun = (motion.slope, root_of_sum(motion.noise))
    slope, added = jax.lax.fori_loop(0, doublings, twice, begun)
    return Gaussian(start.mean, root_of_sum(slope @ start.root, added))
