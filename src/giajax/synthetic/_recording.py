"""A run as another experiment would have recorded it: any model, and every kind of error."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..kinds import InitialSection
from ..models import AbstractModel
from ..parameters import default_free, get
from ..runs import Definition, Run
from ..simulation import SimulationError
from ._recording_errors import RecordingErrors, with_errors
from ._synthesise import blanked, predict_prepared

# What a sidecar says of one recording, and not of what was recorded.
_OF_THE_FILE = ("noise", "truth", "sha256", "fit", "figures", "origin", "licence")


def recorded_again(
    model: AbstractModel,
    run: Run,
    errors: RecordingErrors | None = None,
    *,
    channels: Sequence[str] | None = None,
    seed: int = 0,
    truth: Sequence[str] = (),
    name: str = "synthetic",
) -> Run:
    """The run that an experiment with the inputs of `run` would record, if the model were true.

    The sidecar of `run` is kept, apart from its noise: what the model knows better than it, such
    as a turned camera, stands in `[truth]` alone, for a fit to find. The noise in the sidecar is
    white and correlated noise together.

    Arguments:
        model: the truth.
        run: gives inputs, times and sidecar; what it recorded counts for its first row only.
        errors: of the recording; none by default.
        channels: to record, without unit; those of `run` by default.
        seed: of all errors. Each kind and channel has a random stream of its own.
        truth: paths of parameters to state in `[truth]`, beside those that a fit frees.
        name: of the new run.

    Raises:
        InputError: nothing to record, a channel that the model cannot predict, or errors that
            need times of a run that has none.
        SimulationError: the model cannot be evaluated.
    """
    errors = RecordingErrors() if errors is None else errors
    names = tuple(run.observations if channels is None else channels)
    if not names:
        raise InputError(f"'{run.name}' has no measured channel: give the channels to record")
    prepared = model.prepare(run)
    predicted, successful = predict_prepared(model, prepared, names)
    if not successful:
        raise SimulationError(model.failure(prepared))
    hidden = model.unseen(prepared, names)
    known = [path for path in default_free(model) if path not in truth]
    sidecar = run.definition.contents()
    sections = {key: sidecar[key] for key in sidecar if key not in _OF_THE_FILE}
    facts = {path: np.asarray(get(model, path), dtype=float).tolist() for path in (*known, *truth)}
    made = dataclasses.asdict(errors)
    facts["recording"] = {key: value for key, value in made.items() if value not in ({}, 0.0)}
    if run.definition.section(InitialSection).first_row:
        # The first row of the new run has noise, or is not recorded.
        kept = {key: value for key, value in sections["initial"].items() if key != "first_row"}
        sections["initial"] = {**kept, **model.initial_section(prepared)}
    exact = Run.from_arrays(
        run.times,
        {**run.commands, **run.winds, **{n: blanked(predicted[n], hidden.get(n)) for n in names}},
        name=name,
        definition=Definition.parse({"model": model.kind, **sections, "truth": facts}, name),
    )
    return with_errors(exact, errors, seed=seed)
