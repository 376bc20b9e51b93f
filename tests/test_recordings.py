"""Fits of real recordings predict further runs better than the published models."""

from pathlib import Path

import numpy as np
import pytest

from giajax import FitTask, model_for
from giajax.recordings import Definition, read_runs
from giajax.studies import compare

ROOT = Path(__file__).parents[1]


def prepared(name, **changes):
    """Read a definition in fits/ and its runs."""
    return FitTask.load(ROOT / "fits" / f"{name}.toml").on_top(**changes).prepare()


def published(name, definition, runs):
    """Return the published model for the same runs."""
    stated = Definition.load(ROOT / "data" / "recorded" / name / "published.toml")
    given = {
        key: value for key, value in definition.contents().items() if key in ("initial", "fit")
    }
    paths = list(dict.fromkeys(run.path for run in runs))
    return model_for(read_runs(paths, stated.merged_with(Definition.parse(given))))


@pytest.mark.long
def test_the_triple_pendulum_is_predicted_better_than_by_the_published_parameters():
    # The other initial guesses of the definition lead to the same optimum after minutes.
    ready = prepared("triple_pendulum", starts=1)
    unseen = ready.validation
    assert (len(ready.runs), len(unseen)) == (22, 2)
    reference = published("triple_pendulum", ready.definition, unseen)
    # The initial guess is far off.
    assert max(one.ratio for one in compare(model_for(ready.runs), unseen, reference)) > 5
    result = ready.run(check=False)
    assert result.status == "converged", result.message
    assert not any(estimate.remark for estimate in result.free.values())
    ratios = [one.ratio for one in compare(result.model, unseen, reference) if not one.pooled]
    # The same values are in docs/examples.md and in the README of the data.
    np.testing.assert_allclose(ratios, [0.85, 0.92, 0.67, 0.95, 0.83, 0.96], atol=0.011)
    refitted = compare(result.model, unseen[:1], reference, refit_initial=True)
    assert max(one.ratio for one in refitted) < 1.2


@pytest.mark.slow
def test_the_published_triple_pendulum_has_the_errors_that_its_authors_report():
    """Median RMSE of the absolute angles over the 22 runs: 0.0035, 0.0032 and 0.0043 rad."""
    ready = prepared("triple_pendulum")
    compared = compare(published("triple_pendulum", ready.definition, ready.runs), ready.runs)
    channels = ready.definition.fit.channels
    for channel, expected in zip(channels, (0.0035, 0.0032, 0.0043), strict=True):
        errors = [one.rmse for one in compared if one.channel == channel and not one.pooled]
        assert len(errors) == 22
        assert np.median(errors) == pytest.approx(expected, abs=0.5e-4)


@pytest.mark.long
def test_friction_under_drive_is_better_than_the_published_one():
    ready = prepared("dfki_double_pendulum")
    unseen = ready.validation
    assert (len(ready.runs), len(unseen)) == (20, 20)
    result = ready.run(check=False)
    assert result.status == "converged", result.message
    reference = published("dfki_double_pendulum", ready.definition, unseen)
    pooled = compare(result.model, unseen, reference)[-2:]
    assert [(one.run, one.pooled) for one in pooled] == [("all 20", True)] * 2
    assert max(one.ratio for one in pooled) < 0.9
    # The estimated initial states of the windows are near the recorded ones.
    for run, record in zip(ready.runs, result.runs, strict=True):
        for joint in (1, 2):
            own = record.parameters[f"initial.angle[{joint - 1}]"].value
            assert abs(own - run.values[f"joint{joint:02d}_angle"][0]) < 0.1
