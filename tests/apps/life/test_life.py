"""The whole life of the paper's arm in one run."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from giajax import Definition, InputError, takeichi_20m
from giajax.apps.life import life_show, live
from giajax.apps.mission import Mission
from giajax.mechanics.inflation import Filling
from giajax.mechanics.unrolling import Unrolling

NARAHA = Path(__file__).resolve().parents[3] / "missions" / "naraha.toml"


def test_an_unrolling_of_another_arm_is_refused():
    mission = Mission.from_definition(Definition.load(NARAHA))
    other = Unrolling(filling=Filling(arm=takeichi_20m(20)))
    with pytest.raises(InputError, match="the unrolling and the mission use different arms"):
        live(mission, other)


# The test of the command also checks the balances.
@pytest.mark.long
def test_the_life_of_the_mock_up():
    said = []
    mission = Mission.from_definition(Definition.load(NARAHA))
    life = live(mission, on_phase=said.append)
    assert said == ["unrolling and filling", "mission", "balances", "deflating"]
    names = ["unroll", "fill", "feed", "raise", "mission", "lower", "vent", "roll up"]
    assert [each.name for each in life.phases] == names
    assert life.helium < 1e-10
    assert life.energy_imbalance < 1e-6
    assert life.momentum_imbalance < 1e-6
    assert life.apart < 1e-3
    phases = dict(zip(names, life.phases, strict=True))
    assert all(a.end == b.begin for a, b in zip(life.phases, life.phases[1:], strict=False))
    # The volume of the links is 20 bags of 0.07 m^3, filled at the default flow.
    assert phases["fill"].end - phases["fill"].begin == pytest.approx(23.2 * 60, rel=0.01)
    assert phases["fill"].margin < 0
    assert phases["feed"].margin == pytest.approx(0, abs=1e-3)
    assert phases["mission"].margin > 0
    assert life.energy.stored < 0  # the potential energy of the roll decreases
    # The inflation state is shared: the mission starts with the final state of the filling.
    links = life.mission.model.arm.links
    np.testing.assert_allclose(links.pressure, phases["raise"].pressure)
    np.testing.assert_allclose(links.fullness, phases["raise"].fullness)
    assert jnp.all(links.end_force > life.pull)
    again = life.mission.fly(0)
    np.testing.assert_array_equal(again.angles, life.outcome.angles)
    show = life_show(life)
    assert np.all(np.diff(show.clock) > 0)
    assert show.caption_at(show.sample_at(phases["mission"].begin + 1.0)) == "mission"
    for phase in life.phases[:-1]:  # the state is continuous between phases
        at = show.sample_at(phase.end)
        tip = show.scene.markers["tip"]
        assert np.linalg.norm(tip[min(at + 1, len(tip) - 1)] - tip[at]) < 2.0 or phase.name == (
            "mission"
        )
