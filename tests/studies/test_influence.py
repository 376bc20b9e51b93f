"""For a linear model, one step is a fit, so the effect of omitted data has a closed form."""

import dataclasses

import numpy as np
import pytest
from line import FREE, SIGMA, Line, columns, recorded

import giajax
from giajax import InputError
from giajax.fitting import CellEquations
from giajax.noise import whitened
from giajax.report import influence_table
from giajax.studies import Fitted, Influence, optimum_of, parts_of

DRIFTING = {"position_m": SIGMA, "position_correlated_m": 0.015, "position_correlation_s": 0.4}


@pytest.fixture(scope="module")
def drifting():
    """Return two runs with correlated noise."""
    return [recorded(1, gap=slice(5, 12), noise=DRIFTING), recorded(2, noise=DRIFTING)]


@pytest.fixture(scope="module")
def fitted(drifting):
    return giajax.fit(Line(), drifting, free=FREE, check=False)


@pytest.fixture(scope="module")
def found(fitted, drifting):
    return giajax.influence(fitted, drifting, exact=True, spans=4)


def generalised(fitted, runs, part=None):
    """Solve generalised least squares for the remaining cells by whitening only these."""
    rows, rest = [], []
    for index, run in enumerate(runs):
        noise = optimum_of(fitted, runs).state.noise.values[index]
        for name, values in run.observations.items():
            kept = ~np.isnan(values)
            gone = None if part is None else part.of(index, name, len(values))
            kept &= True if gone is None else ~gone
            if not kept.any():
                continue
            table = np.column_stack([columns(run.times)[name], values])[kept]
            white = whitened(noise[name], run.times[kept], table)
            rows.append(white[:, :-1])
            rest.append(white[:, -1])
    x, y = np.concatenate(rows), np.concatenate(rest)
    return np.linalg.lstsq(x, y, rcond=None)[0], np.linalg.inv(x.T @ x)


def test_a_step_is_generalised_least_squares_of_the_rest(fitted, drifting, found):
    """For any omitted part, correlated noise is whitened again; the error agrees, too."""
    errors = np.asarray([found.parameters[path] for path in FREE])
    whole, covariance = generalised(fitted, drifting)
    parts = {(part.kind, part.name): part for part in parts_of(drifting, 4)}
    assert len(parts) == len(found.parts) == 2 + 2 + 2 * 4
    for row in found.parts:
        if row.name == "tip_z":  # without it, the height is not determined
            assert row.steps["height"] is row.exact["height"] is None
            assert row.largest == np.inf
            continue
        rest, of_rest = generalised(fitted, drifting, parts[row.kind, row.name])
        steps = np.asarray(list(row.steps.values()))
        np.testing.assert_allclose(steps, (rest - whole) / errors, atol=1e-6)
        wider = np.sqrt(np.diag(of_rest) / np.diag(covariance))
        np.testing.assert_allclose(list(row.widening.values()), wider, rtol=1e-6)


def test_a_fit_without_the_part_says_the_same(found):
    """The results agree within the stopping tolerance of the fits."""
    for row in found.parts:
        assert row.reason == ""
        for path in FREE:
            if row.steps[path] is not None:
                assert abs(row.exact[path] - row.steps[path]) < 0.03
    largest = [row.largest for row in found.parts]
    assert largest == sorted(largest, reverse=True)


def test_what_contradicts_the_others_is_told(runs, monkeypatch):
    """A segment that is off by five deviations shifts the estimates."""
    values = {**runs[1].values, "tip_z": runs[1].values["tip_z"].copy()}
    values["tip_z"][20:30] += 5 * SIGMA
    off = giajax.Run.from_arrays(runs[1].times, values, definition=runs[1].definition)
    result = giajax.fit(Line(), [runs[0], off], free=FREE, noise_model="white", check=False)
    asked = []
    monkeypatch.setattr(Fitted, "study", lambda _, __, tasks, **___: asked.extend(tasks) or [])
    found = giajax.influence(result, [runs[0], off], spans=4)
    assert len(asked) == 1  # only the two runs are left out by fits
    worst = max(found.parts, key=lambda part: part.surprise or 0.0)
    assert worst.name == "run, 1.5 to 2.25 s"
    assert worst.surprise > 3


def test_it_is_json_and_goes_on(fitted, drifting, found, tmp_path):
    assert Influence.of_json(found.to_json()) == found
    with pytest.raises(InputError, match=r"not a valid influence\.json file of this version"):
        Influence.of_json("[]")
    done = []
    options = {"spans": 1, "folder": tmp_path}
    few = giajax.influence(fitted, drifting, **options, progress=lambda *_: done.append(1))
    assert {part.kind for part in few.parts if part.exact is not None} == {"run"}
    assert giajax.influence(fitted, drifting, **options, progress=lambda *_: done.append(1)) == few
    assert len(done) == 1


def test_a_robust_loss_has_its_own_curvature():
    """Cells beyond the corner of Huber's loss have no curvature, and a bounded influence."""
    run = recorded(3)
    run.values["tip_z"].setflags(write=True)
    run.values["tip_z"][7] += 1.0
    result = giajax.fit(Line(), run, free=FREE, loss="huber", noise_model="white", check=False)
    equations = CellEquations.of(optimum_of(result, [run]))
    cell = np.arange(40) == 7
    said = equations.said(0, "tip_z", cell)
    np.testing.assert_allclose(said.matrix, 0)
    np.testing.assert_allclose(said.gradient, -columns(run.times)["tip_z"][7] / SIGMA, rtol=1e-6)


def test_what_is_weighted_against_outliers_is_left_out_like_the_rest(drifting):
    """With correlated noise, outliers have weights, of which the remaining ones are used."""
    values = {**drifting[0].values, "tip_z": drifting[0].values["tip_z"].copy()}
    values["tip_z"][[15, 30]] += 20 * SIGMA
    rough = dataclasses.replace(drifting[0], values=values)
    result = giajax.fit(Line(), [rough, drifting[1]], free=FREE, loss="huber", check=False)
    assert optimum_of(result, [rough, drifting[1]]).state.noise.weights is not None
    found = giajax.influence(result, [rough, drifting[1]], spans=1)
    assert [part.reason for part in found.parts] == [""] * len(found.parts)
    for row in found.of_kind("run"):
        for path in FREE:
            assert abs(row.exact[path] - row.steps[path]) < 0.03


def test_what_a_run_has_for_itself_goes_with_it(drifting):
    """Without the run, its own height is not reported as undetermined."""
    runs = [dataclasses.replace(run, name=name) for run, name in zip(drifting, "ab", strict=True)]
    result = giajax.fit(Line(), runs, free=FREE, per_run=["height"], check=False)
    found = giajax.influence(result, runs, spans=1)
    others = {"a": "height of 'b'", "b": "height of 'a'"}
    for row in found.of_kind("run"):
        assert [label for label in row.steps if "height" in label] == [others[row.name]]
        assert np.isfinite(row.largest)
        assert row.steps.keys() == row.exact.keys()
    headings, rows = influence_table(found)
    assert headings[5:] == [path for path in FREE if path != "height"]
    assert len(rows) == len(found.parts)


def test_what_cannot_be_asked_is_refused(fitted, drifting):
    with pytest.raises(InputError, match="the number of spans is 0: give a number from 1"):
        giajax.influence(fitted, drifting, spans=0)
