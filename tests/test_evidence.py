"""Stored evidence: shown as it is, says what the documentation claims, and still comes out."""

import math

import pytest
from scipy.stats import binomtest

from evidence import FOLDER, PAGE, STUDIES, page, read

SHARE = 0.02
# A study that was never run has no figures yet, and no section on the page.
STORED = {name: study for name, study in STUDIES.items() if (FOLDER / f"{name}.json").exists()}


def parameters(figures):
    for case, each in figures.items():
        for path, one in each["parameters"].items():
            yield f"{case}, {path}", each["fits"], one


@pytest.mark.quick
@pytest.mark.parametrize("study", STORED.values(), ids=list(STORED))
def test_the_stored_run_can_be_had_again(study):
    """It has the size and the seed of the study, and a commit that holds what was run."""
    content = read(study)
    assert (content["study"], content["size"], content["seed"]) == (
        study.name, study.size, study.seed,
    )  # fmt: skip
    assert len(content["commit"]) == 40
    assert not content["uncommitted_changes"]
    assert {"python", "giajax", "jax"} <= set(content["versions"])


@pytest.mark.quick
def test_the_page_shows_what_is_stored():
    assert PAGE.read_text(encoding="utf-8") == page(STUDIES.values())


@pytest.mark.quick
def test_95_percent_intervals_hold_the_truth_as_often_as_they_say():
    content = read(STUDIES["coverage"])
    for where, fits, one in parameters(content["figures"]):
        assert fits == content["size"]
        assert binomtest(one["within"], fits, 0.95).pvalue > 1e-3, where
        assert abs(one["mean_pull"]) < 4 / math.sqrt(fits), where
        assert abs(one["deviation_of_pulls"] - 1) < 4 / math.sqrt(2 * fits), where


@pytest.mark.slow
@pytest.mark.parametrize("study", STORED.values(), ids=list(STORED))
def test_a_part_of_a_study_run_again_agrees_with_what_is_stored(study):
    stored = read(study)
    size = math.ceil(SHARE * stored["size"])
    again = study.run(size, stored["seed"] + 1)
    assert study.disagreements(stored["figures"], again) == []


@pytest.mark.quick
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"within": 4}, "4 of 10 intervals hold the truth, and 470 of 500 did"),
        ({"mean_pull": 2.0}, "the mean pull is 2.00, and was 0.02"),
        ({"deviation_of_pulls": 2.5}, "the pulls deviate by 2.50, and did by 1.01"),
        ({"truth": 3.0}, "the truth is 3.0, and 2.0 is stored"),
        ({}, None),
    ],
)
def test_what_disagrees_is_said(change, sentence):
    """Standard errors that are 2.5 times too small are seen in ten fits."""

    def figures(fits, **one):
        return {"case": {"fits": fits, "converged": fits, "parameters": {"k": one}}}

    stored = figures(
        500, truth=2.0, intervals=500, within=470, mean_pull=0.02, deviation_of_pulls=1.01
    )
    one = {"truth": 2.0, "intervals": 10, "within": 10, "mean_pull": -0.2}
    new = figures(10, **{**one, "deviation_of_pulls": 0.9, **change})
    sentences = STUDIES["coverage"].disagreements(stored, new)
    assert sentences == ([] if sentence is None else [f"case, k: {sentence}"])
