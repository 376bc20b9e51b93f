"""Task keys are those of version 0.1.0, despite later moves, renamings and additions."""

import dataclasses
import hashlib
import importlib
import inspect
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from giajax import Definition, InputError, load_result, read_run
from giajax.runtime.identities import CLASSES, FUNCTIONS, place_of
from giajax.runtime.tasks import Task
from giajax.studies import Fitted
from toy_model import Decay

EARLIER = Path(__file__).parent / "earlier"


def found(place):
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def named(names):
    """Return the current names, by the names in keys."""
    return {name.partition("=")[0]: name.rpartition("=")[2] for name in (names or "").split()}


def test_no_identity_was_changed():
    """Paths and current field names may change, but entries must not be added or removed."""
    kept = {
        identity: sorted(named(names))
        for table in (FUNCTIONS, CLASSES)
        for identity, (_, names) in table.items()
    }
    assert not [identity for identity in kept if "giajax" in identity or "." in identity]
    digits = hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()
    assert digits == "64c3ec6a6d32be003d34a5d8756036899c59081c540638835acb0fcebd1300d1"


@pytest.mark.parametrize("identity", [*FUNCTIONS, *CLASSES])
def test_the_code_of_each_identity_is_where_the_table_says(identity):
    place, (_, names) = place_of(identity), {**FUNCTIONS, **CLASSES}[identity]
    code = found(place)
    assert f"{code.__module__}:{code.__qualname__}" == place, "not where it is defined"
    if identity in FUNCTIONS:
        arguments = inspect.signature(code).parameters
        assert set(named(names).values()) <= set(arguments)
    elif names is None:
        assert "task_key" in dir(code) or "task_key" in code.__dataclass_fields__
    else:
        fields = {field.name: field for field in dataclasses.fields(code)}
        for now in named(names).values():
            assert now in fields or isinstance(getattr(code, now, None), property), now
        for name in fields.keys() - set(named(names).values()):
            field = fields[name]
            defaults = (field.default, field.default_factory)
            assert defaults != (dataclasses.MISSING,) * 2, f"{name} was added, without a default"


@pytest.fixture(scope="module")
def fitted():
    return Fitted.of(load_result(EARLIER / "arm"), read_run(EARLIER / "arm" / "run.csv"))


# Computed with version 0.1.0.
TASKS = {
    "profile": (
        ("study/_profile_task:one_side", None),
        "dfd2ec354bec61b683d348e60840123511e53ce59b33eab3507d817ca60b2d03",
        8949808696781466261,
    ),
    "chain": (
        ("study/_posterior_chain:chain", 3),
        "162e3cdbd2d2533d631f126dfda67ec8c090f956f859bee1dbd0118ebc3bc1e4",
        8222749209439694694,
    ),
    "replicates": (
        ("repetitions/_replicates:replicates", None),
        "e01fb834f9a14703b6c43cc62d7724359d0c956135efeae03dc1c7cc3ac60379",
        5914994306501332745,
    ),
    "left_out": (
        ("repetitions/_left_out:left_out", None),
        "ad989152f9f34be6559b719d9f5f41f14a9703bbc937ef88cb1e9414d21685ba",
        650485646547846370,
    ),
    "sweep": (
        ("sweeping/_fit:fitted", None),
        "dbd5480d7e4887441c6d399f01a6db68d027bbded79c68220a141d4753c4066b",
        1843340527676410026,
    ),
    "start": (
        ("study/_start_task:one_start", None),
        "2782de527ada65af217369db10ecde8a7a10b47d4fa53fb2217ebeaff407a1e2",
        6484432329625095704,
    ),
}  # fmt: skip


def arguments_of(what, fitted):
    match what:
        case "profile":
            return {"fitted": fitted, "name": "air.drag_coefficient", "side": -1, "level": 0.95}
        case "chain":
            begun = object.__new__(found(place_of("study/_posterior_chain:Begun")))
            object.__setattr__(begun, "task_key", "a" * 64)
            return {"begun": begun, "number": 1, "draws": 10, "warmup": 5}
        case "replicates":
            few = {"first": 16, "count": 4}
            return {"fitted": fitted, "method": "block", "whole": False, "seed": 3, **few}
        case "left_out":
            part = found(place_of("repetitions/_parts:Part"))
            parts = [part("run", "a", (0,)), part("span", "b", (0, 1), ("tip_z",), (3, 9))]
            return {"fitted": fitted, "parts": parts}
        case "sweep":
            inputs = {"data": [["a.csv", "0", None]], "validation": []}
            definition = {"fit": {"loss": "huber"}}
            return {"definition": definition, "inputs": inputs, "rename": {}, "begin": None}
        case "start":
            from giajax.fitting import set_up
            from toy_model import run

            # The last digit of an exponential depends on the processor.
            noisy = run()
            values = {name: np.round(each, 6) for name, each in noisy.values.items()}
            rounded = dataclasses.replace(noisy, values=values)
            setup = set_up(Decay(), rounded, start={"decay": 2.0}).at_start()
            asked = found(place_of("study/_start_task:Asked")).of(setup)
            return {"asked": asked, "start": {"decay": 2.0}, "most": 50}


@pytest.mark.parametrize("what", TASKS)
def test_keys_of_every_study_are_those_of_then(what, fitted, monkeypatch):
    (identity, seed), key, own_seed = TASKS[what]
    # As if the model were part of giajax; now, the file of a user's model is part of the key.
    monkeypatch.setattr("giajax.runtime.plugins.source", lambda module: None)
    task = Task(place_of(identity), arguments_of(what, fitted), seed=seed)
    assert (task.key, task.own_seed) == (key, own_seed)


def test_a_start_of_a_model_of_a_user_is_another_one_where_its_module_was_edited(monkeypatch):
    keys = set()
    for digest in ("one", "two"):
        there = {"toy_model": ("toy_model.py", f"sha256 {digest}")}
        monkeypatch.setattr("giajax.runtime.plugins.source", there.get)
        asked = arguments_of("start", None)["asked"]
        keys |= {
            asked.task_key,
            Task(place_of("study/_start_task:one_start"), {"asked": asked}).key,
        }
    assert len(keys) == 4


def test_a_model_of_a_user_counts_by_its_full_name():
    key = "458db4a210ed01eed5101282e03fe2a42a777fed0a1ffe66163362406ef1f634"
    assert Task("toy_model:height", {"model": Decay()}).key == key


def new_class(module, *fields, name="New"):
    """Return a class of giajax that is not in any table."""
    made = dataclasses.make_dataclass(name, fields, frozen=True)
    made.__module__ = module
    return made


def key_of(value):
    return Task("math:hypot", {"value": value}).key


def test_of_other_code_of_giajax_the_place_does_not_count():
    here, there = (new_class(f"giajax.{room}", ("a", int))(1) for room in ("fitting", "new._x"))
    other = new_class("giajax.fitting", ("a", int), name="Other")(1)
    users = new_class("fitting", ("a", int))(1)
    assert key_of(here) == key_of(there)
    assert len({key_of(each) for each in (here, other, users)}) == 3
    assert Task("giajax.fitting:new").key == Task("giajax.moved:new").key
    assert Task("giajax.fitting:new").key != Task("fitting:new").key


def test_a_field_that_was_added_counts_where_it_is_set():
    before = new_class("giajax.fitting", ("a", int))(1)
    later = new_class(
        "giajax.fitting", ("a", int), ("b", list, dataclasses.field(default_factory=list))
    )
    assert key_of(later(1)) == key_of(before)
    assert key_of(later(1, [2])) != key_of(before)
    users = [new_class("mine", ("a", int))(1), new_class("mine", ("a", int), ("b", int, 0))(1)]
    assert key_of(users[0]) != key_of(users[1])


def test_an_argument_that_was_added_counts_where_it_is_set(fitted):
    place, about = place_of("study/_profile_task:one_side"), arguments_of("profile", fitted)
    assert Task(place, {**about, "later": None}).key == TASKS["profile"][1]
    assert Task(place, {**about, "later": 1}).key != TASKS["profile"][1]


def test_what_is_renamed_keeps_its_key(fitted, monkeypatch):
    """A renamed function with its argument, and a renamed class with its field."""
    from giajax.runtime import identities as _identities

    place, about = place_of("study/_profile_task:one_side"), arguments_of("profile", fitted)
    moved = {"study/_profile_task:one_side": ("studies:side", "fitted name side=way level")}
    monkeypatch.setattr(_identities, "FUNCTIONS", {**FUNCTIONS, **moved})
    parts = {"repetitions/_parts:Part": ("new:Left", "kind name runs=of channels rows")}
    monkeypatch.setattr(_identities, "CLASSES", {**CLASSES, **parts})
    _identities._identities.cache_clear()
    try:
        about["way"] = about.pop("side")
        assert Task("giajax.studies:side", about).key == TASKS["profile"][1]
        assert Task(place, about).key != TASKS["profile"][1]
        names = ("rows", "channels", "of", "name", "kind")
        left = new_class("giajax.new", *[(name, object) for name in names], name="Left")
        renamed = [
            left(rows=None, channels=None, of=(0,), name="a", kind="run"),
            left(rows=(3, 9), channels=("tip_z",), of=(0, 1), name="b", kind="span"),
        ]
        place = place_of("repetitions/_left_out:left_out")
        assert Task(place, {"fitted": fitted, "parts": renamed}).key == TASKS["left_out"][1]
    finally:
        _identities._identities.cache_clear()


class Odd:
    """A class that is neither plain data nor a dataclass."""

    def __init__(self, *words):
        self.words, self.seen = list(words), {"b", "a"}


def test_what_is_no_data_counts_by_what_a_copy_would_have():
    """It does not use its pickle, in which two identical texts can be shared or separate."""
    word = "".join(["a", "b"])
    assert key_of(Odd(word, word)) == key_of(Odd("ab", "".join(["a", "b"])))
    assert key_of(Odd("ab")) != key_of(Odd("ba"))
    said = [Definition.parse({"model": "arm", "arm": {"links": n}}) for n in (2, 2, 3)]
    assert key_of(said[0]) == key_of(said[1]) != key_of(said[2])
    assert key_of(np.sin) != key_of(np.cos)


def test_what_nothing_describes_is_refused():
    for value in (lambda: None, SimpleNamespace(at=lambda: None), (n for n in "a")):
        with pytest.raises(InputError, match="cannot be described as text"):
            _ = key_of(value)
