"""Outliers of a camera: with a robust loss, they affect neither the estimates nor the verdict."""

from pathlib import Path

import numpy as np
import pytest

import giajax

RUN = Path(__file__).resolve().parents[2] / "data" / "synthetic" / "base_step.csv"
START = {
    "air.drag_coefficient": 0.6,
    "joints.pitch_stiffness": 1.3,
    "joints.damping": 0.2,
}


@pytest.mark.slow
def test_one_marker_in_twenty_half_a_metre_off_moves_no_parameter():
    clean = giajax.read_run(RUN)
    rng = np.random.default_rng(4)
    spoiled = {
        name: np.where(rng.random(len(values)) < 0.05, values + 0.5, values)
        for name, values in clean.observations.items()
    }
    sections = clean.definition.contents()
    del sections["sha256"]
    recording = giajax.Run.from_arrays(
        clean.times, {**clean.commands, **spoiled}, name="spoiled", definition=sections
    )
    model = giajax.model_for([recording])

    def fitted(loss):
        return giajax.fit(
            model, recording, free=list(START), start=START, loss=loss, solver="springs5",
            check=False,
        )  # fmt: skip

    robust = fitted("huber")
    for path in START:
        estimate = robust.parameters[path]
        pull = (estimate.value - clean.definition.truth[path]) / estimate.standard_error
        assert abs(pull) < 2.5, path
    assert robust.verdict.status == "adequate"
    assert fitted("linear").verdict.status == "inadequate"
