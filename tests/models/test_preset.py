"""The TOML vocabulary, which imports no JAX, states the preset's values a second time."""

import pytest

from giajax import takeichi_20m
from giajax.kinds import ArmSection
from giajax.models import arm_from_definition, arm_to_definition
from giajax.runs import Definition


def test_the_vocabulary_states_the_preset_as_it_is():
    stated = {
        name: field.json_schema_extra["preset"]
        for name, field in ArmSection.model_fields.items()
        if field.json_schema_extra["preset"] is not None and name not in ("preset", "trim")
    }
    actual = arm_to_definition(takeichi_20m())
    assert set(actual) == set(stated)
    for name, value in stated.items():
        if isinstance(value, str | list):
            assert actual[name] == value
        else:
            assert actual[name] == pytest.approx(value, rel=1e-12)


def test_axes_are_named_where_they_have_a_name():
    axes = [[0.0, -1.0, 0.0], [0.0, -1.0, 0.0]]
    arm = arm_from_definition(Definition.parse({"arm": {"joint_axes": axes}}))
    assert arm_to_definition(arm)["joint_axes"] == axes
