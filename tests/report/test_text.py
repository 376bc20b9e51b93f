"""The table and the summary: digits, units, remarks, widths."""

import dataclasses

import pytest

from giajax.fitting import ChannelFit, Correlation, Estimate, RunFit
from giajax.recordings import Definition
from giajax.report import parameter_table, reached, summary
from giajax.runtime.text import format_estimate
from small_arm import START


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (1.0496623, 0.0060814, ("1.0497", "0.0061")),
        (2.4091, 0.0999, ("2.41", "0.10")),
        (2.4091, 0.0949, ("2.409", "0.095")),
        (41.14, 8.24, ("41.1", "8.2")),
        (41.14, 12.4, ("41", "12")),
        (1234.5, 345.6, ("1230", "350")),
        (-0.5, 0.013, ("-0.500", "0.013")),
        (0.0, 0.013, ("0.000", "0.013")),
        (1.2341e-9, 3.3e-11, ("1.234e-09", "3.3e-11")),
        (2.9123e-6, 1.2e-7, ("2.91e-06", "1.2e-07")),
        (30.0, None, ("30", "-")),
        (30.0, 0.0, ("30", "-")),
        (30.0, float("nan"), ("30", "-")),
        (None, None, ("-", "-")),
        ([0.047, 0.047], None, ("0.047", "-")),
        ([0.047, 0.05], None, ("0.047 .. 0.05", "-")),
    ],
)
def test_a_value_has_the_digits_that_its_error_allows(value, error, shown):
    assert format_estimate(value, error) == shown


def test_the_table_lists_what_was_free_and_what_was_fixed(result):
    table = parameter_table(result).splitlines()
    assert table[0].split() == ["parameter", "value", "error", "unit", "bounds", "remark"]
    assert {line.split()[0] for line in table[1:]} == set(START)
    row = next(line for line in table if line.startswith("joints.damping"))
    assert "N m s/rad" in row
    assert "0 .. 100" in row

    fixed = dataclasses.replace(result, config={**result.config, "fix": {"links.mass[2]": 0.05}})
    assert "\nlinks.mass " in parameter_table(fixed)


@pytest.mark.parametrize("width", [60, 80, 120])
def test_nothing_is_wider_than_the_terminal(result, width):
    remark = "not determined: no channel responds to it, so it is kept at its initial value"
    path = "joints.yaw_stiffness"
    loose = dataclasses.replace(result.parameters[path], standard_error=None, remark=remark)
    shown = dataclasses.replace(result, parameters={**result.parameters, path: loose})
    text = f"{parameter_table(shown, width)}\n{summary(shown, width)}"
    # The columns of numbers are not wrapped; they require a width of 72.
    assert max(map(len, text.splitlines())) <= max(width, 72)
    words = " ".join(text.split())
    if width < 120:  # the remark is below its row, in one piece
        assert remark in words
    assert remark in parameter_table(shown)


def test_the_summary_says_what_the_values_rest_on(result):
    text = summary(result)
    for part in [
        "converged in", "reduced chi-square", "link04_z", "noise 0.01", "3 channels, 108 values",
        "derivatives agree with finite differences to", "standard errors", "per unit of mass",
        "to compile or load",
    ]:  # fmt: skip
        assert part in text
    status = dataclasses.replace(result, status="not_converged", message="no optimum")
    assert "NOT CONVERGED: no optimum" in summary(status)


def test_the_summary_of_what_is_missing_says_so(result):
    bare = dataclasses.replace(
        result,
        cost=None,
        gradient_check=None,
        tolerance_effect=None,
        correlation=Correlation(),
        findings=(),
        runs=(RunFit("r", None, None, {"output": ChannelFit("", None, 3, 1.0)}),),
    )
    text = summary(bare)
    for part in ["not finite", "not done", "effect unknown", "1 channel, 3 values"]:
        assert part in text
    assert "correlation" not in text


def test_many_channels_are_one_line(result):
    channels = {
        f"link{i:02d}_z": ChannelFit("m", rmse=i / 100, n=5, noise=0.01) for i in range(1, 21)
    }
    many = dataclasses.replace(result, runs=(RunFit("r", None, None, channels),))
    assert "RMSE 0.01 (link01_z) to 0.2 (link20_z) m; noise 0.01; 20 channels" in summary(many)


@pytest.mark.parametrize(
    ("estimate", "figure", "good", "part"),
    [
        ((1.05, 0.01), {"value": 1.06, "standard_errors": 2}, True, "1 standard errors from 1.06"),
        ((1.05, 0.01), {"value": 1.09, "standard_errors": 2}, False, "4 standard errors"),
        ((1.05, 0.01), {"relative_error": 0.01}, True, "0.95%"),
        ((1.05, 0.02), {"relative_error": 0.01}, False, "1.90%"),
        ((1.05, None), {"relative_error": 0.01}, False, "no standard error"),
        ((1.05, None), {"determined": False}, True, "not determined"),
        ((1.05, 2.0), {"determined": False}, True, "not determined"),
        ((1.05, 0.1), {"determined": False}, False, "is determined"),
    ],
)
def test_figures_of_a_definition(result, estimate, figure, good, part):
    path = "air.drag_coefficient"
    parameters = {path: Estimate(*estimate, "", None, None, free=True)}
    found = dataclasses.replace(result, parameters=parameters)
    (verdict,) = reached(found, Definition.parse({"figures": {path: figure}}))
    assert (verdict.path, verdict.reached) == (path, good)
    assert part in verdict.sentence


def test_a_figure_of_what_was_held_is_missed(result):
    wanted = Definition.parse({"figures": {"air.density": {"relative_error": 1.0}}})
    (verdict,) = reached(result, wanted)
    assert not verdict.reached
    assert "not fitted" in verdict.sentence
