"""A fit as an argument of tasks: its key depends on its content, not on process or place."""

import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest

from giajax import InputError, load_result, read_run
from giajax.fitting import Seconds
from giajax.runtime.tasks import Task
from giajax.studies import Fitted

pytestmark = pytest.mark.quick

EARLIER = Path(__file__).parents[1] / "earlier"


@pytest.fixture(scope="module", params=["arm", "hysteresis"])
def fitted(request):
    folder = EARLIER / request.param
    return Fitted.of(load_result(folder), read_run(folder / "run.csv"))


def key_of(fitted):
    return Task("math:hypot", {"fitted": fitted}).key


def test_it_is_known_by_its_content(fitted, tmp_path):
    """Reading again, moving, other times and pickling keep the key; relevant changes do not."""
    (run,), result = fitted.runs, fitted.result
    (tmp_path / "result.json").write_text(result.to_json())
    elsewhere = dataclasses.replace(run, path=tmp_path / "run.csv")
    late = dataclasses.replace(load_result(tmp_path), seconds=Seconds(1.0, 2.0), history=())
    assert key_of(Fitted.of(late, elsewhere)) == key_of(fitted)
    copied = pickle.loads(pickle.dumps(fitted))
    assert key_of(copied) == key_of(fitted)
    assert copied.result.to_json() == result.to_json()

    name = next(iter(run.observations))
    values = {**run.values, name: np.nextafter(run.values[name], np.inf)}
    path, estimate = next(iter(result.free.items()))
    parameters = {**result.parameters, path: dataclasses.replace(estimate, value=0.5)}
    others = [
        Fitted.of(result, dataclasses.replace(run, values=values)),
        Fitted.of(dataclasses.replace(result, parameters=parameters), run),
        Fitted.of(dataclasses.replace(result, config={**result.config, "loss": "soft_l1"}), run),
    ]
    assert len({key_of(fitted), *map(key_of, others)}) == 4


def test_other_runs_are_refused(fitted):
    (run,) = fitted.runs
    with pytest.raises(InputError, match="the runs are not those of the result"):
        Fitted.of(fitted.result, dataclasses.replace(run, sha256="0"))
    # A run in memory has no checksum; the number of measured cells distinguishes some runs.
    name = next(iter(run.observations))
    fewer = np.where(np.arange(len(run.values[name])) == 3, np.nan, run.values[name])
    with pytest.raises(InputError, match="the runs are not those of the result"):
        Fitted.of(fitted.result, dataclasses.replace(run, values={**run.values, name: fewer}))
