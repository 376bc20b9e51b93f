"""A stored result that a user edited: a model that can be built, or one error message."""

import json
from pathlib import Path

from hypothesis import given, settings, strategies as st

from giajax.fitting import load_result
from tests.test_fuzz import changed, outcome, plain, usual

EARLIER = Path(__file__).resolve().parents[1] / "earlier"
RECORDS = [
    json.loads((EARLIER / kind / "result.json").read_text(encoding="utf-8"))
    for kind in ("arm", "hysteresis", "joint", "muscle", "oscillator")
]


@settings(usual, max_examples=100)
@given(st.one_of([changed(record, plain) for record in RECORDS]))
def test_a_changed_result_is_loaded_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "result.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    result, said = outcome(load_result, path)
    assert result is not None or said
