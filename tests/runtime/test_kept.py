"""Programs kept between processes: traced once, and never used in place of another program."""

import collections
import dataclasses
import functools
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import giajax.runtime.programs
from giajax.runtime.programs import (
    CachedProgram,
    NoStructureError,
    cache_programs,
    forget_programs_if_many,
    program,
    restored,
    structure,
)

TRACED = []


def as_law(angle):
    return angle


class Spring(eqx.Module):
    stiffness: np.ndarray
    power: int = eqx.field(static=True, default=1)
    law: object = eqx.field(static=True, default=as_law)


def pulled(spring, angle):
    TRACED.append(spring.power)
    return spring, spring.stiffness * angle**spring.power


def other_law(angle):
    return angle


class Several(NamedTuple):
    parts: object
    rest: object


def of_all_kinds(spring, angle):
    weak = 1.0 * jax.numpy.arange(2.0).sum()
    return Several({"b": [None, spring], "a": (weak, True)}, ("text", 1.5, float("inf"), Spring))


def not_described(spring, angle):
    return Path("x"), angle


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(giajax.runtime.programs, "_folder", None)
    TRACED.clear()
    cache_programs(tmp_path / "programs")
    return tmp_path / "programs"


def in_a_process(spring, angle, *, function=pulled):
    """Return the result of a newly started process, or None if the program was not kept."""
    given = (spring, angle), {}
    call = CachedProgram(function, {}).ready(given)
    return None if call is None else call(given)


SPRING, ANGLE = Spring(np.array(2.0)), np.array([1.0, 2.0, 3.0])


def test_a_later_process_does_not_trace_it_again(folder):
    _, first = in_a_process(SPRING, ANGLE)
    same, second = in_a_process(SPRING, ANGLE + 1)
    assert TRACED == [1]
    assert_array_equal(first, [2.0, 4.0, 6.0])
    assert_array_equal(second, [4.0, 6.0, 8.0])
    assert same.law is SPRING.law
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize(
    ("spring", "angle"),
    [
        (Spring(np.array(2.0), power=2), ANGLE),
        (SPRING, ANGLE[:2]),
        (Spring(np.float32(2.0)), ANGLE.astype(np.float32)),
        (Spring(np.array(2.0), law=other_law), ANGLE),
    ],
    ids=["a static value", "a shape", "a type", "a function"],
)
def test_what_differs_is_another_program(spring, angle):
    in_a_process(SPRING, ANGLE)
    _, force = in_a_process(spring, angle)
    assert len(TRACED) == 2
    assert force.shape == angle.shape
    assert_array_equal(force, 2.0 * angle**spring.power)


def test_a_program_of_the_package_is_kept(folder):
    for _ in range(2):
        _, force = program(pulled)(SPRING, ANGLE)
        assert_array_equal(force, [2.0, 4.0, 6.0])
    assert TRACED == [1]
    # Within another program, it is traced with that program.
    assert_array_equal(jax.jit(lambda x: program(pulled)(SPRING, x)[1])(ANGLE), force)
    assert TRACED == [1, 1]


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="no list of maps")
def test_many_programs_are_forgotten_before_the_memory_has_no_more_maps(folder):
    def maps():
        return Path("/proc/self/maps").read_bytes().count(b"\n")

    forget_programs_if_many(0)
    before = maps()
    ours = program(pulled)
    for size in range(1, 30):
        jax.jit(lambda x: jax.numpy.sin(x) + 1)(np.zeros(size))
        ours(SPRING, np.zeros(size))
    assert len(TRACED) == 29
    full = maps()
    forget_programs_if_many(full + 1)  # below the limit
    assert maps() > before + (full - before) / 2
    forget_programs_if_many(0)
    assert maps() < before + (full - before) / 2
    # Kept programs are read again, the others are compiled again.
    assert_array_equal(ours(SPRING, ANGLE)[1], [2.0, 4.0, 6.0])
    ours(SPRING, np.zeros(7))
    assert len(TRACED) == 29


def test_nothing_is_kept_where_jax_is_to_look_into_programs(folder):
    with jax.debug_nans(True):
        program(pulled)(SPRING, ANGLE)
    assert not folder.exists()


def test_a_changed_source_is_traced_again(monkeypatch):
    in_a_process(SPRING, ANGLE)
    monkeypatch.setattr(giajax.runtime.programs, "origin", lambda: "another")
    in_a_process(SPRING, ANGLE)
    assert len(TRACED) == 2


@pytest.mark.parametrize("damaged", [lambda b: b[:-1], lambda b: b"", lambda b: b"x" + b[1:]])
def test_a_damaged_file_is_traced_again_and_mended(folder, damaged):
    in_a_process(SPRING, ANGLE)
    [path] = folder.iterdir()
    path.write_bytes(damaged(path.read_bytes()))
    assert_array_equal(in_a_process(SPRING, ANGLE)[1], [2.0, 4.0, 6.0])
    in_a_process(SPRING, ANGLE)
    assert len(TRACED) == 2


def test_results_of_all_kinds_come_back(folder):
    for _ in range(2):
        found = in_a_process(SPRING, ANGLE, function=of_all_kinds)
        assert isinstance(found, Several)
        assert set(found.parts) == {"a", "b"}
        number, yes = found.parts["a"]
        # A result with another weak type would require another program for its next use.
        assert yes is True
        assert number == 1.0
        assert not number.weak_type
        nothing, spring = found.parts["b"]
        assert nothing is None
        assert structure(spring) == structure(SPRING)
        assert found.rest == ("text", 1.5, float("inf"), Spring)
    assert len(list(folder.iterdir())) == 1


def test_a_result_that_no_text_describes_is_not_kept(folder):
    path, angle = in_a_process(SPRING, ANGLE, function=not_described)
    assert path == Path("x")
    assert_array_equal(angle, ANGLE)
    assert not folder.exists()


def test_the_tests_see_a_result_that_no_text_describes():
    with pytest.raises(NoStructureError):
        program(not_described)(SPRING, ANGLE)


@pytest.mark.parametrize(
    "text",
    [
        {"class": ["os", "system"], "parts": [{"value": "true"}]},
        {"name": ["os", "system"]},
        {"class": [__name__, "Spring"], "fields": {"stiffness": {"value": 1.0}}},
        {"class": ["subprocess", "Popen"], "parts": [{"value": "true"}]},
        {"class": ["pathlib", "Path"], "fields": {"x": {"value": 1}}},
        {"class": ["not_imported", "Spring"], "fields": {}},
        {"name": ["os", "no_such_name"]},
        {"shape": [3]},
        [],
    ],
)
def test_a_text_runs_nothing(text):
    with pytest.raises(ValueError, match=r"not the description of|nothing has imported"):
        restored(text)


def raised(angle, power=2, *, factor):
    TRACED.append(power)
    return factor * angle**power


def test_keywords_and_defaults_are_the_same_program(folder):
    calls = (
        lambda call: call(ANGLE, factor=3.0),
        lambda call: call(ANGLE, 2, factor=3.0),
        lambda call: call(angle=ANGLE, power=2, factor=3.0),
    )
    for call in calls:
        assert_array_equal(call(program(raised)), [3.0, 12.0, 27.0])
    assert TRACED == [2]
    assert_array_equal(program(raised)(ANGLE, factor=4.0), [4.0, 16.0, 36.0])
    assert TRACED == [2, 2]


@dataclasses.dataclass
class NoTree:
    factor: np.ndarray


def times(factor, angle):
    return factor * angle


def scaled(scale, angle):
    return scale(angle) if callable(scale) else scale.factor * angle


def test_numbers_in_what_is_no_tree_are_a_part_of_the_program():
    for kind in (NoTree, functools.partial(functools.partial, times)):
        for factor in (2.0, 5.0):
            assert_array_equal(program(scaled)(kind(np.array(factor)), ANGLE), factor * ANGLE)


def cube(angle):
    return angle**3


def test_a_transformed_function_is_not_the_original():
    assert program(cube)(np.array(3.0)) == 27.0
    assert program(jax.grad(cube))(np.array(3.0)) == 27.0
    assert program(jax.grad(cube))(np.array(2.0)) == 12.0


def as_given(given, angle):
    return given


def test_a_mapping_that_has_an_order_keeps_it(folder):
    given = collections.OrderedDict(b=ANGLE, a=2 * ANGLE)
    for _ in range(2):
        found = in_a_process(given, ANGLE, function=as_given)
        assert_array_equal(found["b"], ANGLE)
    # A text cannot describe it.
    assert not folder.exists()


def test_a_function_within_another_is_not_kept(folder):
    def inner(spring, angle):
        return pulled(spring, angle)

    assert in_a_process(SPRING, ANGLE, function=inner) is None
    assert in_a_process(SPRING, ANGLE, function=lambda *given: pulled(*given)) is None
    assert not folder.exists()


def test_what_has_no_name_is_not_kept():
    assert in_a_process(Spring(np.array(2.0), law=lambda x: x), ANGLE) is None
    with pytest.raises(NoStructureError):
        structure(object())


def test_where_nothing_can_be_written_it_is_used_all_the_same(tmp_path):
    (tmp_path / "file").write_text("")
    cache_programs(tmp_path / "file" / "programs")
    assert_array_equal(in_a_process(SPRING, ANGLE)[1], [2.0, 4.0, 6.0])


def test_arrays_that_are_parts_of_a_program_count_by_their_numbers():
    def fixed(*values):
        with pytest.warns(UserWarning, match="static"):
            return Spring(np.array(1.0), law=np.asarray(values))

    assert structure(fixed(1.0, 2.0)) == structure(fixed(1.0, 2.0))
    assert structure(fixed(1.0, 2.0)) != structure(fixed(1.0, 3.0))
    assert structure(Spring(np.array(1.0))) == structure(Spring(np.array(2.0)))
    assert structure({"a": 1, "b": (True,)}) != structure({"a": 1, "b": (1,)})


def test_programs_can_be_stored_whatever_a_command_imports_first(tmp_path):
    """`report` imports Equinox to check its arguments, before it is configured."""
    result = Path(__file__).parents[1] / "earlier" / "results" / "loops" / "fit"
    words = ["giajax", "report", str(result), "--page", "x.html", "--data", "none.csv"]
    code = (
        f"import sys; from giajax.__main__ import main; sys.argv = {words!r}; "
        "status = main(); from equinox._config import EQX_ON_ERROR; print(status, EQX_ON_ERROR)"
    )
    known = {name: value for name, value in os.environ.items() if name != "EQX_ON_ERROR"}
    how = {"env": known, "cwd": tmp_path, "capture_output": True, "text": True}
    said = subprocess.run([sys.executable, "-c", code], **how)
    assert said.stdout.split() == ["2", "nan"], said.stderr
