"""Parameter options of `giajax fit`: their grammar, and one sentence for each error."""

import pytest

from giajax import InputError, Prior
from giajax.cli import _values as words

pytestmark = pytest.mark.quick


def test_priors_are_normal_or_log_normal():
    assert words.priors(["air.drag_coefficient=1.1+-0.2", "a[0]= 5e-2 x/ 1.5", "b=-.5+-1e-3"]) == {
        "air.drag_coefficient": Prior(1.1, deviation=0.2),
        "a[0]": Prior(0.05, factor=1.5),
        "b": Prior(-0.5, deviation=0.001),
    }


def test_bounds_ties_and_groups():
    assert words.bounds(["joints.damping=0.01,1", "b=-1, 1e3"]) == {
        "joints.damping": [0.01, 1.0],
        "b": [-1.0, 1000.0],
    }
    assert words.ties(["links.mass=links.mass[0]", "a = 2 * b"]) == {
        "links.mass": "links.mass[0]",
        "a": "2 * b",
    }
    assert words.groups(["a=x,y", "b=x", "a= z"]) == {"a": [["x", "y"], ["z"]], "b": [["x"]]}
    assert words.priors(None) == words.bounds(None) == words.ties(None) == words.groups(None) == {}


@pytest.mark.parametrize(
    ("read", "pairs", "sentence"),
    [
        (words.priors, ["a=1.1"], r"--prior 'a=1.1' must be PATH=VALUE\+-DEVIATION, or"),
        (words.priors, ["a=1.1+-"], "must be PATH=VALUE"),
        (words.priors, ["a=1_0+-2"], "must be PATH=VALUE"),
        (words.priors, ["a=1e999+-2"], "must be PATH=VALUE"),
        (words.priors, ["1.1+-2"], r"--prior '1.1\+-2' must be PATH=VALUE\+-DEVIATION, or"),
        (words.priors, ["a=1+-0"], r"is not valid, because the deviation of the prior is 0: give"),
        (words.priors, ["a=1x/0.5"], "the factor of the prior is 0.5: give a number above 1"),
        (words.priors, ["a=1+-1", "a=1x/2"], "--prior gives a twice: remove one"),
        (words.bounds, ["a=1"], "--bounds 'a=1' must be PATH=LOW,HIGH with two numbers"),
        (words.bounds, ["a=1,2,3"], "must be PATH=LOW,HIGH"),
        (words.bounds, ["a=1,x"], "must be PATH=LOW,HIGH"),
        (words.bounds, ["a=1,2", "a=1,2"], "--bounds gives a twice: remove one"),
        (words.ties, ["a"], "--tie 'a' must be PATH=EXPRESSION: write it like"),
        (words.ties, ["a=b", "a=c"], "--tie gives a twice: remove one"),
        (words.groups, ["=x"], "--group '=x' must be PATH=RUN,RUN: write"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(read, pairs, sentence):
    with pytest.raises(InputError, match=sentence) as caught:
        read(pairs)
    assert "\n" not in str(caught.value)
