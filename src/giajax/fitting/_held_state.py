"""Where a fit of parts of runs ended, as the state of a fit of the whole runs."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ..noise import ChannelNoise
from ..runs import Parted
from ._beginning import between
from ._configuration import Setup
from ._noise import Noise
from ._residual_cells import residual_cells, shared_and_own
from ._result import FitResult
from ._state import FitState
from ._transitions import at_tolerance, begin, move, reweight, step

# Steps of what only the held cells know, such as where a held run starts: the test that follows is
# exact to first order, and a state that was guessed may be further off than that.
_STEPS = 10


def where_it_ended(result: FitResult, setup: Setup, parts: Sequence[Parted]) -> FitState:
    """The state of a fit of the whole runs where that of the fitted parts ended, evaluated.

    What no fitted cell responds to is where the held cells want it.

    Arguments:
        result, setup, parts: as of `with_held_out`.
    """
    values = {
        p.path: between(result.parameters[p.path].value, p.declaration.lower, p.declaration.upper)
        for p in setup.parameters
    }
    own = {
        record.name: {p: one.value for p, one in record.parameters.items() if p in setup.groups}
        for record in result.runs
    }
    for path, groups in setup.groups.items():
        for names in ([setup.runs[i].name for i in members] for members in groups):
            known = [own[name][path] for name in names if path in own.get(name, {})]
            for name in names if known else ():
                own.setdefault(name, {})[path] = known[0]
    state = begin(dataclasses.replace(setup.started_at(values), own=own))
    if result.integration is not None:
        state = at_tolerance(state, result.integration.tolerance)
    state = _at_own_values(state, result, parts)
    state = step(reweight(state, _noise(result, state.noise, parts)))
    if not state.evaluated:
        return state
    alone = _known_to_held(state, parts)
    if not np.any(alone):
        return state
    everything = state.active
    state = dataclasses.replace(state, active=jnp.asarray(alone))
    for _ in range(_STEPS):
        state = step(state)
        if state.done:
            break
    return dataclasses.replace(state, active=everything)


def _at_own_values(state: FitState, result: FitResult, parts: Sequence[Parted]) -> FitState:
    """The state where each fitted run has its own values, also where others have its name."""
    start = state.start.copy()
    records = iter(result.runs)
    known = [next(records).parameters if part.fitted is not None else {} for part in parts]
    for group in state.problem.groups:
        for member, columns in zip(group.members, group.own_columns().tolist(), strict=True):
            for label, column in zip(group.own_labels(), columns, strict=True):
                if label in known[member]:
                    start[column] = known[member][label].value
    return move(state, state.problem.bijector.inverse(start))


def _noise(result: FitResult, noise: Noise, parts: Sequence[Parted]) -> Noise:
    """The noise that the fit ended with; of what it did not have, what is stated or guessed."""
    by_key = noise.by_key()
    records = iter(result.runs)
    for part, keys in zip(parts, noise.keys, strict=True):
        for name, one in (next(records).channels if part.fitted else {}).items():
            channel = part.whole.channels[name]
            by_key[keys[name]] = ChannelNoise.of_cell(
                float(channel.to_si(one.noise)),
                float(channel.to_si(one.correlated)),
                one.correlation_time_s,
            )
    return noise.with_values(by_key)


def _known_to_held(state: FitState, parts: Sequence[Parted]) -> np.ndarray:
    """The coordinates that no fitted cell responds to, shape (parameter,)."""
    alone = np.ones(state.problem.size, bool)
    for group in state.problem.groups:
        for member, columns in zip(group.members, group.columns(), strict=True):
            if parts[member].fitted is not None:
                alone[columns] = False
    shared, _ = shared_and_own(state)
    responds = np.zeros(len(shared), bool)
    for (number, name), cells in residual_cells(state).items():
        responds |= np.any(cells.shared[~held_cells(parts[number], name)] != 0, axis=0)
    alone[shared] = ~responds
    return alone


def held_cells(part: Parted, name: str) -> np.ndarray:
    """Which of the measured cells of a channel are held out, shape (cell,).

    Arguments:
        part: a run.
        name: of the channel.
    """
    measured = ~np.isnan(part.whole.observations[name])
    if part.held is None or name not in part.held.observations:
        return np.zeros(int(np.sum(measured)), bool)
    return ~np.isnan(part.held.observations[name][measured])
