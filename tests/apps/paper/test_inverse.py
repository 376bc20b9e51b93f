"""Table 3 inverted: the search with known cells, and the resulting statements."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from giajax.apps.paper import (
    CELLS,
    READINGS,
    UNKNOWNS,
    Compared,
    SearchEnd,
    _inverse,
    concordance,
    directions,
    evaluated,
    reproduced_files,
    search,
    shown,
)
from giajax.mechanics.arm import takeichi_20m
from giajax.simulation import ramps, simulate

COUNT = len(UNKNOWNS)
# Cells that are linear in the logarithms of the unknowns, with full rank.
SLOPES = 30 * np.random.default_rng(5).standard_normal((8, COUNT))


def known(offset):
    """Cells that equal the printed ones at the centre of all ranges, plus an offset."""
    low, high = READINGS["own"].box()
    middle = (low + high) / 2

    def evaluated(logarithms):
        cells = CELLS + offset + SLOPES @ (np.asarray(logarithms) - middle)
        return Compared(cells, np.full(4, 0.1), np.zeros(4, bool))

    return evaluated, lambda logarithms: (evaluated(logarithms), SLOPES)


def ended(reading, jacobian):
    """A search that ended with an error of two points."""
    out = Compared(CELLS + 2.0, np.full(4, 0.1), np.zeros(4, bool))
    ones = np.exp(READINGS[reading].spread() @ READINGS[reading].box()[0])
    return SearchEnd(reading, 1, "minimum", 3, ones, ones, out, jacobian, jacobian)


@pytest.fixture(params=[1, 2])
def cores(request, monkeypatch):
    monkeypatch.setenv("GIAJAX_CORES", str(request.param))


def searched(monkeypatch, offset, **options):
    evaluated, linearised = known(offset)
    monkeypatch.setattr(_inverse, "evaluated", evaluated)
    monkeypatch.setattr(_inverse, "linearised", linearised)
    return search("own", starts=2, pool=5, **options)


def test_it_finds_an_arm_that_there_is(monkeypatch, cores):
    ends = searched(monkeypatch, 0.0)
    assert [end.why for end in ends] == ["reached"] * 2
    for end in ends:
        assert np.abs(end.misfit).max() < 0.5
        np.testing.assert_allclose(end.checked, SLOPES, rtol=1e-6)
        np.testing.assert_allclose(end.jacobian, SLOPES)
        assert np.abs(np.log(end.end / end.start)).max() > 0.1


def test_it_says_where_there_is_none(monkeypatch):
    # The offset is so large that no values within the ranges can reach it.
    ends = searched(monkeypatch, np.array([1e4, 0, 0, 0, 0, 0, 0, 0]))
    assert {end.why for end in ends} <= {"minimum", "stuck", "iterations"}
    assert ends[0].at_bounds()
    low, high = READINGS["own"].box()
    for end in ends:
        assert np.all((np.log(end.end) >= low - 1e-9) & (np.log(end.end) <= high + 1e-9))


def test_it_can_be_stopped(monkeypatch, cores):
    def stop(text):
        if "start 1, step 1" in text:
            raise KeyboardInterrupt

    ends = searched(monkeypatch, 5.0, say=stop)
    assert ends[0].why == "interrupted"
    assert shown(ends).rows


def test_a_search_that_is_stopped_or_fails_at_its_start(monkeypatch):
    """Earlier searches are kept, and the failed one gives no number."""
    monkeypatch.setenv("GIAJAX_CORES", "1")
    for why in ("interrupted", "failed"):
        there = known(5.0)[1]
        calls = []

        def linearised(logarithms, calls=calls, there=there, why=why):
            calls.append(logarithms)
            out, slopes = there(logarithms)
            if len(calls) == 2 and why == "interrupted":
                raise KeyboardInterrupt
            return (out, slopes) if len(calls) < 2 else (out._replace(cells=CELLS + np.nan), slopes)

        monkeypatch.setattr(_inverse, "evaluated", known(5.0)[0])
        monkeypatch.setattr(_inverse, "linearised", linearised)
        ends = search("own", starts=2, pool=5, iterations=0)
        assert [end.why for end in ends] == ["iterations", why]
        assert np.all(np.isfinite(ends[0].out.cells))
        assert np.all(np.isnan(ends[1].out.cells))
        table = shown(ends)
        assert [row[3] for row in table.rows if row[0] == "link 2, with air, %"] == ["nan"]


@pytest.mark.quick
def test_searches_are_kept_when_the_next_reading_is_stopped(monkeypatch):
    def stopped(reading, *, say):
        if reading == stop:
            raise KeyboardInterrupt
        return [ended(reading, np.zeros((8, 8)))] * 5

    monkeypatch.setattr(_inverse, "search", stopped)
    stop = "own"
    assert len(_inverse.table3_inverse().facts["searches"]) == 5
    stop = "memory"
    with pytest.raises(KeyboardInterrupt):
        _inverse.table3_inverse()


@pytest.mark.quick
def test_readings():
    memory, own = READINGS["memory"], READINGS["own"]
    assert len(memory.free) == 8
    assert own.free == tuple(UNKNOWNS)
    one = dict(zip(UNKNOWNS, memory.spread() @ np.arange(1.0, 9.0), strict=True))
    assert one["model_stiffness"] == one["stiffness"] == 1
    assert one["reach"] == 0
    assert (one["strength"], one["back"]) == (4, 8)
    for low, high in zip(*own.box(), strict=True):
        assert low < high


@pytest.mark.quick
def test_directions_are_told():
    jacobian = np.zeros((8, 8))
    jacobian[0, 0], jacobian[1, 2] = 3.0, -7.0
    jacobian[0, 1] = 3.0
    end = ended("memory", jacobian)
    sizes, rows = directions(end)
    np.testing.assert_allclose(sizes[:3], [7, 3 * np.sqrt(2), 0], atol=1e-12)
    np.testing.assert_allclose(rows[0], np.eye(8)[2], atol=1e-12)
    table = shown([end])
    assert "none of 1 searches reproduce" in table.title
    assert "2.0 percentage points" in table.title
    record = json.loads(reproduced_files("x", table)["x.json"])["searches"][0]
    assert record["directions"][:2] == ["drag^1.00", "stiffness^0.71 damping^0.71"]
    assert set(record["at_an_end_of_its_range"]) == set(READINGS["memory"].free)
    cells = {row[0]: row[2] for row in table.rows}
    assert cells["link 2, with air, %"] == "79.0"
    assert cells["arm: C_D"] == "0.5*"


@pytest.mark.long
def test_the_cells_are_those_of_simulations():
    """Compare with the public simulation, another solver, and NumPy's concordance."""
    values = {name: np.sqrt(u.lower * u.upper) * u.unit for name, u in UNKNOWNS.items()}
    values |= {"angle": 0.5, "reach": 0.9, "back": 13.0, "lasting": 1.0, "yield": 0.01}
    out = evaluated(jnp.log(jnp.asarray(list(values.values()))))
    times = np.concatenate([[0.0], np.linspace(10, 25, 151)])

    def heights(reach, of, **memory):
        knots = np.zeros((4, 20))
        knots[1:3, 0] = 0.5 * reach
        arm = takeichi_20m(
            parameters={
                "joints.pitch_stiffness": values[f"{of}stiffness"],
                "joints.damping": values[f"{of}damping"],
                "air.drag_coefficient": values[f"{of}drag"],
                **{f"joints.memory.{name}": value for name, value in memory.items()},
            }
        )
        command = ramps([0.5, 1.5, 13.0, 14.0], knots)
        motion = simulate(arm, command, times, solver="tsit5", rtol=1e-7, atol=1e-7)
        return np.asarray(motion.link_centres)[1:, [1, 5, 11, 19], 2]

    recorded = heights(0.9, "", strength=values["strength"], yield_angle=0.01)
    expected = []
    for drag in (values["model_drag"], 0.0):
        values["model_drag"] = drag
        model = heights(1.0, "model_")
        expected += [
            100 * concordance(*columns) for columns in zip(model.T, recorded.T, strict=True)
        ]
    np.testing.assert_allclose(out.cells, expected, atol=0.2)
    np.testing.assert_allclose(out.nearest, np.abs(recorded).min(axis=0), rtol=1e-3)
