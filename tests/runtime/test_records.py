"""The codec of records: dataclasses as JSON, and input that is refused when it is read."""

import dataclasses
import json
from collections.abc import Mapping
from typing import Literal

import numpy as np
import pytest

from giajax import InputError
from giajax.runtime.records import (
    InfiniteWhereNull,
    from_plain,
    json_text,
    parse_record,
    plain_data,
)

pytestmark = pytest.mark.quick


@dataclasses.dataclass(frozen=True)
class Part:
    name: str
    size: InfiniteWhereNull


@dataclasses.dataclass(frozen=True)
class Whole:
    parts: tuple[Part, ...]
    rate: float
    count: int = 0
    kind: Literal["old", "new"] = "old"
    ends: tuple[float, float] | None = None
    value: float | list[float] = 0.0
    by_name: Mapping[str, float | None] = dataclasses.field(default_factory=dict)


WHOLE = {"parts": [{"name": "a", "size": 2}], "rate": 0.5}


def test_what_is_written_is_read_again():
    whole = Whole((Part("a", np.inf), Part("b", 1)), 2, ends=(0.0, 1.5), by_name={"x.y": None})
    head = {"version": 1}
    text = json_text(whole, head)
    assert list(json.loads(text)) == ["version", *(f.name for f in dataclasses.fields(Whole))]
    assert parse_record(Whole, text, head, "FILE is none", "write it") == whole
    # Numbers keep their spelling.
    assert json_text(parse_record(Whole, text, head, "FILE is none", "write it"), head) == text
    assert json.loads(text)["parts"][0]["size"] is None


def test_what_is_not_finite_is_null_and_arrays_are_lists():
    record = Whole((), float("nan"), value=np.array([1.0, np.inf]).tolist())
    assert plain_data(record)["rate"] is None
    assert plain_data({"array": np.eye(2), "number": np.float64(np.nan), "flag": np.True_}) == {
        "array": [[1.0, 0.0], [0.0, 1.0]],
        "number": None,
        "flag": True,
    }
    assert from_plain(Whole, plain_data(record)).value == [1.0, None]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"rate": True}, "rate is true, but must be a number"),
        ({"rate": "1"}, "rate is '1', but must be a number"),
        ({"count": 1.0}, "count is 1.0, but must be a whole number"),
        ({"kind": "x"}, 'kind is \'x\', but must be "old" or "new"'),
        ({"ends": [1]}, "ends[1] is missing"),
        ({"ends": [1, 2, 3]}, "ends is [1, 2, 3], but must be a shorter list"),
        ({"value": [1, "a"]}, "value is [1, 'a'], but must be a number"),
        ({"by_name": {"x.y": "1"}}, "by_name['x.y'] is '1', but must be a number"),
        ({"by_name": []}, "by_name is [], but must be an object"),
        ({"parts": [{"name": "a"}]}, "parts[0].size is missing"),
        ({"parts": [{"name": 3, "size": 1}]}, "parts[0].name is 3, but must be text"),
        ({"parts": None}, "parts is null, but must be a list"),
        ({"new": 1}, "new is not a key known to this version"),
    ],
)
def test_the_key_that_is_wrong_is_named(change, complaint):
    with pytest.raises(InputError) as raised:
        from_plain(Whole, {**WHOLE, **change}, "FILE is none", "write it")
    assert str(raised.value) == f"FILE is none ({complaint}): write it"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "it is not JSON"),
        ("[]", r"it is \[\], but must be an object"),
        ("{}", "version is not 1"),
        ('{"version": 2}', "version is not 1"),
        ('{"version": 1}', "parts is missing"),
        (b"\xff", "it is not JSON"),
    ],
)
def test_a_text_of_something_else_is_refused(text, complaint):
    with pytest.raises(InputError, match=complaint):
        parse_record(Whole, text, {"version": 1}, "FILE is none", "write it")
