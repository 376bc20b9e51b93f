"""The filter and the smoother over events, of whatever moves and is measured."""

import math
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Bool, Float, Int
from ...runtime.programs import program
from ._filter import Gaussian, Innovation, measured, moved, root_of_sum, smoothed


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


class Events(NamedTuple):
    """Times at which something is measured or an interval ends, in their order.

    Attributes:
        held: what is known of the interval before each.
        values: measured channels, SI, shape (event, channel).
        there: which of them were measured.
    """

    held: Any
    values: Float[Array, "event channel"]
    there: Bool[Array, "event channel"]


class Followed(NamedTuple):
    """The state, and how many measurements of each channel were left out in a row."""

    state: Gaussian
    left_out: Int[Array, " channel"]


class Filtered(NamedTuple):
    """Of each event: the state by all that was measured until then, and what that was beside.

    `used` is which measurements counted; `left_out` is that of `Followed`.
    """

    state: Gaussian
    innovation: Innovation
    used: Bool[Array, "event channel"]
    left_out: Int[Array, "event channel"]


GATE = 5.0
"""Deviations; a measurement that is farther off does not count for the state."""

_IN_A_ROW = 5  # of outliers; what goes on after that is no outlier, and the state is wrong


@program
def filtered(
    system: System, start: Followed, events: Events, estimated: Array, gate: Array, blind: Array
) -> Filtered:
    """The filter over all events; `blind`: as if each measured value were the expected one."""

    def one(before: Followed, event: Events) -> tuple[Followed, Filtered]:
        return _one(system, before, event, estimated, gate, blind)

    return jax.lax.scan(one, start, events)[1]


@program
def followed_by(
    system: System, before: Followed, event: Events, estimated: Array, gate: Array
) -> tuple[Followed, Filtered]:
    """The filter over one event."""
    return _one(system, before, event, estimated, gate, jnp.asarray(False))


def _one(
    system: System, before: Followed, event: Events, estimated: Array, gate: Array, blind: Array
) -> tuple[Followed, Filtered]:
    state, left_out = before
    mean, slope, noise = system.moved(state.mean, event.held)
    state = moved(state, mean, slope, noise)
    shown, slope = system.shown(state.mean, event.held)
    off = jnp.where(blind, 0, event.values - shown)
    expected = jnp.sqrt(jnp.sum((slope @ state.root) ** 2, axis=1) + system.noise**2)
    near = jnp.abs(off) <= gate * expected
    used = event.there & (near | (left_out >= _IN_A_ROW))
    state, innovation = measured(
        state, off, slope, system.noise, there=event.there, used=used, estimated=estimated
    )
    # An outlier is as likely as one at the gate, so that nothing is gained by leaving more out.
    outside = -0.5 * gate**2 - jnp.log(expected) - 0.5 * math.log(2 * math.pi)
    likelihood = jnp.sum(jnp.where(event.there & ~used, outside, 0))
    innovation = innovation._replace(log_likelihood=innovation.log_likelihood + likelihood)
    left_out = jnp.where(event.there, jnp.where(near, 0, left_out + 1), left_out)
    return Followed(state, left_out), Filtered(state, innovation, used, left_out)


@program
def smoothed_states(
    system: System, after: Gaussian, states: Gaussian, held: Any, there: Array
) -> Gaussian:
    """The smoother over filtered states, each with the interval that follows it.

    `after` is the state after the last of them, by everything; of those that are not `there` it is
    passed on.
    """

    def one(after: Gaussian, given: Any) -> tuple[Gaussian, Gaussian]:
        before, held, there = given
        mean, slope, noise = system.moved(before.mean, held)
        found = smoothed(before, mean, slope, noise, after)
        found = jax.tree.map(lambda new, old: jnp.where(there, new, old), found, after)
        return found, found

    return jax.lax.scan(one, after, (states, held, there), reverse=True)[1]


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
def rested(system: System, start: Gaussian, held: Any, doublings: int) -> Gaussian:
    """What is known of what has stood for 2^doublings intervals where it rests.

    By the derivatives there: the covariance of a sum of so many intervals, in so many products.
    """
    _, slope, noise = system.moved(start.mean, held)
    added = root_of_sum(noise)
    for _ in range(doublings):
        added = root_of_sum(slope @ added, added)
        slope = slope @ slope
    return Gaussian(start.mean, root_of_sum(slope @ start.root, added))
