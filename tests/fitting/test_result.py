"""A result as data: read from earlier versions, displayed, and composed of small records."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from damage import damages
from giajax import InputError, load_result, read_run
from giajax.fitting import Estimate, GradientCheck, Shift
from giajax.report import summary

# Written by a version before results were records: two fits, a validation, estimated noise.
EARLIER = Path(__file__).parent / "earlier"


@pytest.fixture(scope="module")
def earlier():
    return load_result(EARLIER)


def test_a_result_of_an_earlier_version_is_read(earlier):
    assert earlier.parameters["weights[0]"].value == pytest.approx(0.8021, abs=1e-4)
    assert earlier.runs[0].channels["output"].n == 55
    assert earlier.runs[0].parameters == {}
    assert earlier.validation[0].channels["output"].rmse == pytest.approx(0.00541, abs=1e-5)
    assert [start.status for start in earlier.starts] == ["converged", "converged"]
    assert earlier.starts[1].misfit == pytest.approx(earlier.starts[0].misfit)
    assert earlier.gradient_check.left_out == ()
    assert earlier.tolerance_effect.by_parameter["elastic"] == Shift(0.0, 0.0)
    assert earlier.correlation.parameters == ("elastic", "weights[0]", "offset")
    assert earlier.history[-1].number == earlier.iterations
    assert "2 of 2 ended at this optimum" in summary(earlier)


def test_it_predicts_as_it_did(earlier):
    run = read_run(EARLIER / "loops.csv")
    difference = earlier.predict(run)["output"] - run.observations["output"]
    rmse = earlier.runs[0].channels["output"].rmse
    assert np.sqrt(np.mean(difference**2)) == pytest.approx(rmse, rel=1e-9)


def test_what_was_written_before_is_written_again(earlier):
    """The structure of result.json is unchanged: every key has its place and value."""

    def check(before, after):
        if isinstance(before, dict):
            for key, value in before.items():
                check(value, after[key])
        elif isinstance(before, list):
            assert len(before) == len(after)
            for one, other in zip(before, after, strict=True):
                check(one, other)
        else:
            assert before == after

    check(json.loads((EARLIER / "result.json").read_text()), json.loads(earlier.to_json()))


def test_what_is_not_finite_is_null_in_any_depth(earlier):
    check = GradientCheck(float("nan"), {"elastic": float("inf")}, 1e-4, ("offset",))
    record = json.loads(dataclasses.replace(earlier, gradient_check=check).to_json())
    assert record["gradient_check"] == {
        "relative_difference": None,
        "direction": {"elastic": None},
        "step": 1e-4,
        "left_out": ["offset"],
    }


def test_a_result_is_a_table(earlier):
    headline, blank, head, *rows = str(earlier).splitlines()
    assert headline.startswith("converged in 9 iterations")
    assert blank == ""
    assert head.split() == ["parameter", "value", "error", "unit", "bounds", "remark"]
    assert [row.split()[:3] for row in rows] == [
        ["elastic", "0.4993", "0.0038"],
        ["weights[0]", "0.8021", "0.0043"],
        ["offset", "0.09933", "0.00072"],
    ]
    assert len(repr(earlier)) < 100
    stopped = dataclasses.replace(earlier, status="not_converged", message="no optimum")
    assert str(stopped).startswith("NOT CONVERGED: no optimum")


def test_a_notebook_shows_a_table_in_which_nothing_is_markup(earlier):
    odd = Estimate(1.5, 0.1, "m", None, None, free=True, remark="where a < b & c")
    page = dataclasses.replace(earlier, parameters={"width": odd}, derived={})._repr_html_()
    assert page.count("<tr>") == 2
    for cell in ("width", "1.50", "0.10", "m", "where a &lt; b &amp; c"):
        assert f"<td>{cell}</td>" in page
    assert "converged in 9 iterations" in page
    many = {f"width{index}": odd for index in range(40)}
    page = dataclasses.replace(earlier, parameters=many, derived={})._repr_html_()
    assert page.count("<tr>") == 41


def test_a_damaged_result_is_read_or_refused_in_a_sentence(tmp_path):
    path = tmp_path / "result.json"
    record = json.loads((EARLIER / "result.json").read_text())
    refused = 0
    for what, damaged in damages(record, seed=30):
        path.write_text(json.dumps(damaged))
        try:
            result = load_result(path)
            summary(result), result.to_json(), result.model_of(read_run(EARLIER / "loops.csv"))
        except InputError:
            refused += 1
        except Exception as error:
            raise AssertionError(what) from error
    assert refused > 100


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda r: r.pop("cost"), "cost is missing"),
        (lambda r: r["runs"][0].update(nam="x"), "runs[0].nam is not a key known to this version"),
        (lambda r: r["config"].update(free=3), "config.free is 3, but must be a list"),
        (
            lambda r: r["parameters"]["weights[0]"].update(value="0.8"),
            "parameters['weights[0]'].value is '0.8', but must be a number",
        ),
    ],
)
def test_the_key_that_is_wrong_is_named(tmp_path, change, complaint):
    path = tmp_path / "result.json"
    record = json.loads((EARLIER / "result.json").read_text())
    change(record)
    path.write_text(json.dumps(record))
    with pytest.raises(InputError) as raised:
        load_result(path)
    expected = f"{path} is not a giajax result ({complaint}): give the folder of a fit"
    assert str(raised.value) == expected
