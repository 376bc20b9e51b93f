"""The square-root filter and smoother against filterpy, textbook formulas and simulated truths."""

import functools
import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import block_diag, expm
from scipy.stats import multivariate_normal

from giajax import InputError
from giajax.apps.tracking import (
    GATE,
    DelayedFilter,
    Events,
    Followed,
    Gaussian,
    Motion,
    filtered,
    moved,
    predicted,
    rested,
    root_of_sum,
    smoothed_states,
)


class Interval(NamedTuple):
    transition: np.ndarray
    root: np.ndarray

    @property
    def added(self):
        return self.root @ self.root.T


class Chain(eqx.Module):
    """Masses and springs under random forces; some positions are measured."""

    rates: np.ndarray
    forces: np.ndarray
    shows: jax.Array
    noise: jax.Array

    def interval(self, length):
        """Return the exact motion over a time (Van Loan, IEEE Trans. Autom. Control 23 (1978))."""
        states = len(self.rates)
        spread = self.forces @ self.forces.T
        pair = np.block([[-self.rates, spread], [np.zeros_like(spread), self.rates.T]])
        power = expm(length * pair)
        transition = power[states:, states:].T
        added = transition @ power[:states, states:]
        values, vectors = np.linalg.eigh((added + added.T) / 2)
        return Interval(transition, vectors * np.sqrt(np.maximum(values, 0)))

    def moved(self, vector, held):
        return held.transition @ vector, held.transition, held.root

    def shown(self, vector, held):
        return self.shows @ vector, self.shows


@functools.cache
def chain_of(masses):
    """Return a chain on a wall; every third position and the last are measured."""
    springs = 30.0 * (2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1))
    springs[-1, -1] = 30.0
    nothing, one = np.zeros((masses, masses)), np.eye(masses)
    rates = np.block([[nothing, one], [-springs, -0.02 * springs]])
    measured = sorted({*range(0, masses, 3), masses - 1})
    shows = np.eye(2 * masses)[measured]
    noise = np.linspace(0.01, 0.03, len(measured))
    forces = np.vstack([nothing, 0.5 * one])
    return Chain(rates, forces, jnp.asarray(shows), jnp.asarray(noise))


def start_of(chain, rng):
    """Return an uncertain state with correlated components."""
    states = len(chain.rates)
    root = np.tril(rng.normal(size=(states, states)), -1) * 0.2 / states + 0.2 * np.eye(states)
    return Gaussian(jnp.asarray(rng.normal(size=states)), jnp.asarray(root))


def begun(chain, start):
    return Followed(start, jnp.zeros(len(chain.noise), int))


def stacked(intervals):
    return Interval(*map(np.stack, zip(*intervals, strict=True)))


def events_of(intervals, values):
    there = np.isfinite(values)
    return Events(stacked(intervals), jnp.asarray(values), jnp.asarray(there))


def run(chain, start, intervals, values, gate=np.inf, estimated=None):
    states = len(chain.rates)
    estimated = np.ones(states, bool) if estimated is None else estimated
    events = events_of(intervals, values)
    return filtered(
        chain, begun(chain, start), events, jnp.asarray(estimated), jnp.asarray(gate), False
    )[1]


def simulated(chain, start, intervals, rng, runs=1):
    """Simulate the true last states (run, state) and measurements (run, event, channel)."""
    shows, noise = np.asarray(chain.shows), np.asarray(chain.noise)
    states = len(chain.rates)
    state = np.asarray(start.mean) + rng.normal(size=(runs, states)) @ np.asarray(start.root).T
    values = []
    for interval in intervals:
        state = state @ interval.transition.T + rng.normal(size=state.shape) @ interval.root.T
        values.append(state @ shows.T + noise * rng.normal(size=(runs, len(noise))))
    return state, np.stack(values, axis=1)


def reference(chain, start, intervals, values):
    """Return means and covariances by filterpy, after each interval and its measurements."""
    shows, noise = np.asarray(chain.shows), np.asarray(chain.noise)
    kalman = KalmanFilter(len(chain.rates), len(noise))
    kalman.x = np.asarray(start.mean)
    kalman.P = np.asarray(start.covariance)
    found = []
    for interval, row in zip(intervals, values, strict=True):
        kalman.predict(F=interval.transition, Q=interval.added)
        seen = np.isfinite(row)
        if seen.any():
            kalman.update(row[seen], R=np.diag(noise[seen] ** 2), H=shows[seen])
        found.append((kalman.x, kalman.P))
    means, covariances = zip(*found, strict=True)
    return np.stack(means), np.stack(covariances)


def far_off(states, means, covariances):
    """Return the largest difference of means and covariances, in standard deviations."""
    deviations = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
    roots = np.asarray(states.root)
    off = (roots @ np.swapaxes(roots, -1, -2) - covariances) / deviations[..., None, :]
    return max(
        np.max(np.abs(states.mean - means) / deviations),
        np.max(np.abs(off / deviations[..., None])),
    )


class Recorded(NamedTuple):
    chain: Chain
    start: Gaussian
    intervals: list
    values: np.ndarray


@functools.cache
def recorded(masses):
    """Simulate forty jittered intervals with missing values, five of them without any values."""
    rng = np.random.default_rng(masses)
    chain = chain_of(masses)
    start = start_of(chain, rng)
    intervals = [chain.interval(length) for length in rng.uniform(0.01, 0.09, 40)]
    values = simulated(chain, start, intervals, rng)[1][0]
    values[rng.random(values.shape) < 0.2] = np.nan
    values[20:25] = np.nan
    return Recorded(chain, start, intervals, values)


@pytest.mark.parametrize("masses", [3, 20])
def test_filter_smoother_and_prediction_are_those_of_filterpy(masses):
    chain, _, intervals, values = given = recorded(masses)
    found = run(*given)
    means, covariances = reference(*given)
    assert far_off(found.state, means, covariances) < 1e-8
    assert np.array_equal(found.used, np.isfinite(values))

    transitions, added = zip(*((each.transition, each.added) for each in intervals), strict=True)
    kalman = KalmanFilter(2 * masses, len(chain.noise))
    smooth, spread, *_ = kalman.rts_smoother(means, covariances, transitions, added)
    # No state follows the last one.
    there, later = jnp.arange(40) < 39, jnp.roll(jnp.arange(40), -1)
    last = jax.tree.map(lambda leaf: leaf[-1], found.state)
    motions = jax.tree.map(lambda leaf: leaf[later], found.motion)
    states = smoothed_states(last, found.state, motions, there)
    assert far_off(states, smooth, spread) < 1e-8

    # Predict from each of two states, over other intervals.
    some = jax.tree.map(lambda leaf: leaf[jnp.array([3, 17])], found.state)
    held = jax.tree.map(
        lambda *rows: np.stack(rows), stacked(intervals[:6]), stacked(intervals[6:12])
    )
    ahead = predicted(chain, some, held)
    for place, (row, later) in enumerate([(3, intervals[:6]), (17, intervals[6:12])]):
        begin = Gaussian(means[row], np.linalg.cholesky(covariances[row]))
        nothing = np.full((6, len(chain.noise)), np.nan)
        after = reference(chain, begin, later, nothing)
        one = jax.tree.map(lambda leaf, place=place: leaf[place], ahead)
        assert far_off(one, after[0][-1], after[1][-1]) < 1e-8


def test_log_likelihood_is_that_of_all_measurements_together():
    chain, start, intervals, values = recorded(3)
    intervals, values = intervals[:8], values[:8]
    found = run(chain, start, intervals, values)
    # Every measurement is linear in the initial state, the forces and its own noise.
    shows, noise = np.asarray(chain.shows), np.asarray(chain.noise)
    mean, root, means, roots = np.asarray(start.mean), np.asarray(start.root), [], []
    for interval in intervals:
        mean = interval.transition @ mean
        root = np.hstack([interval.transition @ root, interval.root])
        means.append(shows @ mean)
        roots.append(shows @ root)
    roots = np.vstack(
        [np.pad(each, ((0, 0), (0, root.shape[1] - each.shape[1]))) for each in roots]
    )
    covariance = roots @ roots.T + np.diag(np.tile(noise**2, len(intervals)))
    seen = np.isfinite(values.ravel())
    stack = multivariate_normal(np.concatenate(means)[seen], covariance[np.ix_(seen, seen)])
    likelihood = stack.logpdf(values.ravel()[seen])
    assert np.sum(found.innovation.log_likelihood) == pytest.approx(likelihood, rel=1e-8)


def test_late_measurements_count_as_if_they_had_come_in_time():
    chain = chain_of(3)
    rng = np.random.default_rng(4)
    start = start_of(chain, rng)
    times = np.cumsum(rng.uniform(0.02, 0.25, 25))
    intervals = [chain.interval(length) for length in np.diff(times, prepend=0.0)]
    values = simulated(chain, start, intervals, rng)[1][0]
    # The first sensor is half a second late, sometimes more; the other has no delay.
    delays = np.stack([0.5 + 0.3 * (rng.random(25) < 0.3), np.zeros(25)], axis=1)
    sent = [
        (time + delays[event, channel], event, channel)
        for (event, time), channel in itertools.product(enumerate(times), range(2))
    ]
    order = [(event, channel) for _, event, channel in sorted(sent)]
    assert order != sorted(order)

    follower = DelayedFilter(chain, 0.0, start, lambda begin, end: chain.interval(end - begin))
    arrived = np.full_like(values, np.nan)
    for event, channel in order:
        row = np.where(np.arange(2) == channel, values[event], np.nan)
        assert follower.measure(times[event], row)
        arrived[event, channel] = values[event, channel]
        until = np.flatnonzero(np.isfinite(arrived).any(axis=1))[-1]
        means, covariances = reference(chain, start, intervals[: until + 1], arrived[: until + 1])
        assert follower.time == times[until]
        assert far_off(follower.state, means[-1], covariances[-1]) < 1e-8
    assert follower.lost == 0

    nothing = np.full((1, 2), np.nan)
    last = Gaussian(means[-1], np.linalg.cholesky(covariances[-1]))
    means, covariances = reference(chain, last, [chain.interval(0.73)], nothing)
    assert far_off(follower.ahead(follower.time + 0.73), means[0], covariances[0]) < 1e-8
    assert follower.time == times[-1]


def test_what_is_older_than_the_history_is_lost():
    chain = chain_of(3)
    start = start_of(chain, np.random.default_rng(5))
    follower = DelayedFilter(
        chain, 0.0, start, lambda begin, end: chain.interval(end - begin), history=1.0, gate=np.inf
    )
    assert follower.measure(3.0, [0.0, 0.0])
    before = follower.state
    assert not follower.measure(1.5, [9.0, 9.0])
    assert not follower.measure(-1.0, [9.0, 9.0])
    assert follower.lost == 2
    assert all(map(np.array_equal, follower.state, before))
    assert follower.measure(2.5, [9.0, np.nan])
    assert not np.array_equal(follower.state.mean, before.mean)
    with pytest.raises(InputError, match="a row of 3 measurements is given for 2 channels"):
        follower.measure(4.0, [0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="the time of the measurements is nan s"):
        follower.measure(np.nan, [0.0, 0.0])
    with pytest.raises(InputError, match=" s, before the last measurement at 3"):
        follower.ahead(2.9)


def test_only_the_first_events_of_a_padded_call_count():
    chain = chain_of(3)
    rng = np.random.default_rng(8)
    start = start_of(chain, rng)
    intervals = [chain.interval(0.05)] * 8
    values = simulated(chain, start, intervals, rng)[1][0]
    every = jnp.ones(len(start.mean), bool)

    def some(count, size):
        given = (events_of(intervals[:size], values[:size]), every, jnp.asarray(np.inf), False)
        return filtered(chain, begun(chain, start), *given, count=jnp.asarray(count))

    last, rows = some(5, 8)
    same_last, same = some(5, 5)
    for one, other in zip(jax.tree.leaves(last), jax.tree.leaves(same_last), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    for one, other in zip(jax.tree.leaves(rows), jax.tree.leaves(same), strict=True):
        np.testing.assert_allclose(one[:5], other, rtol=1e-12)
        assert not np.any(one[5:])


@eqx.filter_jit
def last_states(chain, start, events, measured):
    """Return the states of each run after all events."""

    def one(values):
        every = jnp.ones(len(start.mean), bool)
        given = events._replace(values=values)
        _, found = filtered(chain, begun(chain, start), given, every, jnp.asarray(jnp.inf), False)
        return jax.tree.map(lambda leaf: leaf[-1], found.state)

    return jax.vmap(one)(measured)


@pytest.mark.parametrize(("masses", "low", "high"), [(3, 0.89, 1.12), (20, 0.957, 1.044)])
def test_errors_of_a_hundred_runs_are_as_large_as_their_covariances_say(masses, low, high):
    chain = chain_of(masses)
    rng = np.random.default_rng(6)
    start = start_of(chain, rng)
    intervals = [chain.interval(0.05)] * 30
    truth, values = simulated(chain, start, intervals, rng, runs=100)
    events = events_of(intervals, values[0])

    def normalised_error(noise):
        given = eqx.tree_at(lambda chain: chain.noise, chain, noise)
        states = last_states(given, start, events, jnp.asarray(values))
        off = np.linalg.solve(np.asarray(states.root), (truth - states.mean)[..., None])
        return np.mean(off**2)

    # 95 % interval of chi-square with 100 times as many degrees of freedom as states.
    assert low < normalised_error(chain.noise) < high
    assert normalised_error(chain.noise / 2) > high
    assert normalised_error(chain.noise * 2) < low


def test_considered_states_are_those_of_schmidt():
    plain = chain_of(3)
    # Each channel has a constant bias that is considered but not estimated.
    rates, forces = (
        block_diag(plain.rates, np.zeros((2, 2))),
        np.vstack([plain.forces, np.zeros((2, 3))]),
    )
    chain = Chain(rates, forces, jnp.hstack([plain.shows, jnp.eye(2)]), plain.noise)
    rng = np.random.default_rng(7)
    start = start_of(chain, rng)
    intervals = [chain.interval(length) for length in rng.uniform(0.01, 0.1, 20)]
    values = simulated(chain, start, intervals, rng)[1][0]
    found = run(chain, start, intervals, values, estimated=np.arange(8) < 6)

    by_state, by_bias = np.asarray(plain.shows), np.eye(2)
    mean, bias = np.split(np.asarray(start.mean), [6])
    covariance = np.asarray(start.covariance)
    own, cross, considered = covariance[:6, :6], covariance[:6, 6:], covariance[6:, 6:]
    for place, interval in enumerate(intervals):
        transition, added = interval.transition[:6, :6], interval.added[:6, :6]
        mean, own = transition @ mean, transition @ own @ transition.T + added
        cross = transition @ cross
        seen = own @ by_state.T + cross @ by_bias.T
        of_bias = cross.T @ by_state.T + considered @ by_bias.T
        expected = by_state @ seen + by_bias @ of_bias + np.diag(np.asarray(plain.noise) ** 2)
        gain = np.linalg.solve(expected, seen.T).T
        mean = mean + gain @ (values[place] - by_state @ mean - by_bias @ bias)
        own, cross = own - gain @ expected @ gain.T, cross - gain @ of_bias.T
        state = jax.tree.map(lambda leaf, place=place: leaf[place], found.state)
        together = np.block([[own, cross], [cross.T, considered]])
        assert far_off(state, np.concatenate([mean, bias]), together) < 1e-10
        assert np.array_equal(state.mean[6:], bias)
        np.testing.assert_allclose(state.covariance[6:, 6:], considered, rtol=1e-12, atol=1e-14)


def test_an_outlier_is_left_out_and_its_innovation_counts():
    chain, start, intervals, values = recorded(3)
    values = values.copy()
    values[15] = run(chain, start, intervals, values).state.mean[15] @ chain.shows.T
    without = np.where(np.arange(40)[:, None] == 15, [np.nan, values[15, 1]], values)
    expected = run(chain, start, intervals, without, GATE)
    usual = run(chain, start, intervals, values, GATE)
    values[15, 0] += 50 * usual.innovation.deviations[15, 0]
    found = run(chain, start, intervals, values, GATE)
    assert np.array_equal(found.used, np.isfinite(without))
    assert all(map(np.array_equal, found.state, expected.state))
    assert np.sum(usual.innovation.whitened[15] ** 2) < 25
    assert found.innovation.nis[15] > 45**2


def test_six_outliers_in_a_row_are_none():
    chain, start, intervals, _ = recorded(3)
    truth, values = simulated(chain, start, intervals, np.random.default_rng(8))
    wrong = start._replace(mean=start.mean + 50 * start.deviations)
    found = run(chain, wrong, intervals, values[0], GATE)
    assert not np.any(found.used[:5])
    assert np.all(found.used[5])
    assert np.all(found.used[-10:])
    off = np.abs(truth[0] - found.state.mean[-1])
    assert np.all(off < 5 * np.linalg.norm(found.state.root[-1], axis=1))


def test_rest_is_many_intervals_at_once():
    chain = chain_of(3)
    held = chain.interval(0.03)
    start = start_of(chain, np.random.default_rng(9))
    found = rested(start, Motion(*chain.moved(start.mean, held)), 6)
    state = start
    for _ in range(2**6):
        state = moved(state, *chain.moved(state.mean, held))
    assert np.array_equal(found.mean, start.mean)
    assert far_off(found, np.asarray(start.mean), np.asarray(state.covariance)) < 1e-10


def test_root_of_a_sum_is_triangular_also_of_few_columns():
    roots = [jnp.asarray(np.random.default_rng(10).normal(size=(5, width))) for width in (1, 2)]
    for several in (roots, roots * 2):
        root = root_of_sum(*several)
        assert np.array_equal(root, np.tril(root))
        np.testing.assert_allclose(
            root @ root.T, sum(each @ each.T for each in several), atol=1e-13
        )


class Cart(eqx.Module):
    """A cart that moves by an unknown gain times the known input; two clocks measure it."""

    noise: jax.Array

    def moved(self, vector, held):
        slope = jnp.array([[1.0, 0.0], [0.0, 1.0]]).at[0, 1].set(held)
        return slope @ vector, slope, jnp.array([[1e-6], [0.0]])

    def shown(self, vector, held):
        slope = jnp.array([[1.0, 0.0], [1.0, 0.0]])
        return slope @ vector, slope


def driven(begin, end):
    """Return the integral of a sine with a period of 5 s."""
    pace = 2 * np.pi / 5
    return jnp.asarray(4 * (np.cos(pace * begin) - np.cos(pace * end)))


def follows(interval=driven):
    start = Gaussian(jnp.array([0.0, 1.0]), jnp.diag(jnp.array([0.1, 0.2])))
    return DelayedFilter(
        Cart(jnp.array([1.0, 1.0])),
        0.0,
        start,
        interval,
        history=60.0,
        watched=jnp.array([[0.0, 0.2]]),
    )


def test_a_small_change_is_found_at_a_hundred_rows_a_second_by_two_clocks():
    rng = np.random.default_rng(8)
    follower = follows()
    place, gain, last = 0.0, 1.0, 0.0
    late = None
    for step in range(1, 801):
        # The clocks differ by 1 ms, but sometimes show the same time.
        for channel, time in enumerate((0.02 * step, 0.02 * step + 0.001 * (step % 5 > 0))):
            gain = 1.0 if time <= 8.0 else 0.89
            place += gain * float(driven(last, time))
            last = time
            row = np.full(2, np.nan)
            row[channel] = place + rng.normal()
            if step == 375 and channel == 0:  # this row arrives late
                late = (time, row)
                continue
            follower.measure(time, row)
    ((begun, seen, found),) = follower.changes
    # A detector with a window of only 4 s would not find the change.
    assert begun == pytest.approx(8.0, abs=3.0)
    assert seen - begun > 4.0
    assert float(found.size) == pytest.approx(-0.11, abs=4 * float(found.deviation))
    before = follower.state
    spread = float(before.deviations[1])
    assert float(before.mean[1]) == pytest.approx(0.89, abs=4 * spread)
    assert spread < 0.05

    # A late row from before the change neither restores the former value, nor is a second change of
    # the gain detected.
    assert begun - 2.5 < late[0] < begun + 2.5
    assert follower.measure(*late)
    for time in (16.1, 16.2):
        follower.measure(time, [np.nan, np.nan])
    assert len(follower.changes) == 1
    assert float(follower.state.mean[1]) == pytest.approx(float(before.mean[1]), abs=0.1 * spread)
    assert float(follower.state.deviations[1]) == pytest.approx(spread, rel=0.02)


def test_what_rests_teaches_nothing_and_an_outlier_is_no_motion():
    follower = follows(lambda begin, end: jnp.asarray(0.001 * (end - begin)))
    rng = np.random.default_rng(9)
    for step in range(1, 200):
        outlier = 40.0 if step in (50, 120) else 0.0
        follower.measure(0.1 * step, [outlier + rng.normal(), np.nan])
    assert float(follower.state.deviations[1]) == pytest.approx(0.2, rel=1e-9)

    # Each late measurement is judged at the time at which it was taken, between two motions of a
    # quarter of a period.
    def twice(begin, end):
        return sum(
            3 * driven(np.clip(begin, at, at + 1.25) - at, np.clip(end, at, at + 1.25) - at)
            for at in (1.0, 20.0)
        )

    follower = follows(twice)
    for step in range(1, 60):
        place = float(twice(0.0, 0.5 * step))
        follower.measure(0.5 * step, [place + rng.normal(), np.nan])
    learnt = float(follower.state.deviations[1])
    assert learnt < 0.1
    for step in range(20):
        place = float(twice(0.0, 14.0 + 0.25 * step))
        follower.measure(14.0 + 0.25 * step, [np.nan, place + rng.normal()])
    assert float(follower.state.deviations[1]) == pytest.approx(learnt, rel=0.01)


class Spring(Cart):
    """A spring that comes to rest at an unknown gain times the known input, with random forces."""

    def moved(self, vector, held):
        slope = jnp.array([[0.8, 0.2 * held], [0.0, 1.0]])
        return slope @ vector, slope, jnp.array([[0.02], [0.0]])


def test_what_rests_bent_is_not_said_to_change():
    """The innovations then have a constant offset, which is due to the error of the parameter."""
    rng = np.random.default_rng(10)
    follower = DelayedFilter(
        Spring(jnp.array([0.3, 0.3])),
        0.0,
        Gaussian(jnp.array([4.0, 1.0]), jnp.array([[0.1, 0.0], [0.0, 0.2]])),
        lambda begin, end: jnp.asarray(4.0),
        history=60.0,
        watched=jnp.array([[0.0, 0.2]]),
    )
    for step in range(400):
        follower.measure(0.1 * (step + 1), [1.2 * 4.0 + 0.3 * rng.normal(), np.nan])
    assert follower.changes == []
    assert float(follower.state.deviations[1]) == pytest.approx(0.2, rel=1e-6)


def test_a_command_that_is_held_jumps_within_an_interval():
    """Intervals end at the corners of a command, for example with a camera delay of half a row."""
    seen = []

    def interval(begin, end):
        seen.append((round(begin, 3), round(end, 3)))
        return driven(begin, end)

    start = Gaussian(jnp.array([0.0, 1.0]), jnp.diag(jnp.array([0.1, 0.2])))
    follower = DelayedFilter(
        Cart(jnp.array([1.0, 1.0])),
        0.0,
        start,
        interval,
        corners=lambda begin, end: [0.2] if begin < 0.2 < end else [],
    )
    for time in (0.04, 0.14, 0.24):
        follower.measure(time, [0.0, 0.0])
    assert seen[-2:] == [(0.14, 0.2), (0.2, 0.24)]
