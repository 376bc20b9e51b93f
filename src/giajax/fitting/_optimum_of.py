"""From what a result says of a fit to its optimum, evaluated by the program that fitted it."""

import dataclasses
from collections.abc import Sequence

from .._errors import InputError
from ..noise import ChannelNoise
from ._configuration import Setup
from ._descend import moving
from ._identifiability import responds
from ._noise import Noise
from ._optimum import Optimum
from ._reestimate import reestimate
from ._run_records import RunFit
from ._state import FitState
from ._transitions import begin, reweight, step


def optimum(setup: Setup, records: Sequence[RunFit]) -> Optimum:
    """The optimum of a fit, without fitting it again.

    Arguments:
        setup: what was fitted to what; its model has the fitted values and the tolerance that was
            used, and `own` those of single runs.
        records: of its runs, with the noise that was used.

    Raises:
        InputError: the model cannot be evaluated there.
    """
    begun = begin(dataclasses.replace(setup, unstarted=()))
    noise = begun.noise.with_values(_noise_of(begun.noise, setup, records))
    noise = dataclasses.replace(noise, estimated=not noise.complete)
    state = _evaluated(begun, noise)
    if setup.loss != "linear" and noise.memory:
        # The weights of cells are not kept: they follow from the residuals.
        weights = reestimate(state).weights
        if weights is not None:
            state = _evaluated(begun, dataclasses.replace(noise, weights=weights))
    return Optimum(dataclasses.replace(state, rounds_left=0))


def _evaluated(begun: FitState, noise: Noise) -> FitState:
    state = step(reweight(begun, noise))
    if not state.evaluated:
        raise InputError("the model cannot be evaluated where the fit ended")
    return moving(state, responds(state.natural_jacobian().norms(), state.sizes))


def _noise_of(noise: Noise, setup: Setup, records: Sequence[RunFit]) -> dict[str, ChannelNoise]:
    """The noise of each key, as the records of the runs have it."""
    by_key = {}
    for run, record, keys in zip(setup.runs, records, noise.keys, strict=True):
        for name, key in keys.items():
            stored, to_si = record.channels[name], run.channels[name].to_si
            by_key[key] = ChannelNoise.of_cell(
                float(to_si(stored.noise)),
                float(to_si(stored.correlated)),
                stored.correlation_time_s,
            )
    return by_key
