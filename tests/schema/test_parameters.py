"""Parameter declarations: paths, elements, replacement, bounds and invalid values."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from giajax.mechanics.arm import Air, takeichi_20m
from giajax.runtime.text import InputError
from giajax.schema.parameters import (
    Parameter,
    check_within_bounds,
    declaration,
    declared,
    default_free,
    elements,
    find,
    get,
    inline,
    is_concrete,
    parameter,
    replace,
)

PATHS = [
    "links.length",
    "links.diameter",
    "links.mass",
    "links.centre_of_mass",
    "links.inertia_transverse",
    "links.inertia_axial",
    "links.fullness",
    "links.pressure",
    "joints.pitch_stiffness",
    "joints.yaw_stiffness",
    "joints.damping",
    "joints.friction_rate",
    "joints.memory.yield_angle",
    "joints.memory.nu",
    "joints.memory.delta",
    "joints.stops.yield_angle",
    "air.density",
    "air.drag_coefficient",
    "air.viscosity",
    "base_rotation",
    "gravity",
]


class Spring(eqx.Module):
    stiffness: jax.Array = parameter(2.0, unit="N/m", lower=0, upper=10, frozen=False, doc="spring")
    offset: jax.Array = parameter(0.0, unit="m", doc="rest length")


class Owner(eqx.Module):
    spring: Spring
    bare: Spring = inline()
    name: str = eqx.field(static=True, default="owner")


@pytest.fixture(scope="module")
def arm():
    return takeichi_20m(3)


def test_the_arm_declares_its_parameters_in_the_order_of_its_fields(arm):
    assert list(declared(arm)) == PATHS
    assert default_free(arm) == (
        "joints.pitch_stiffness",
        "joints.yaw_stiffness",
        "joints.damping",
        "air.drag_coefficient",
    )


def test_every_declaration_says_what_it_is(arm):
    for path, found in declared(arm).items():
        said = found.declaration
        assert said.lower < said.upper, path
        assert said.lower <= said.default <= said.upper, path
        assert said.doc, path
        assert not said.doc.endswith("."), path
        assert said.doc[0].islower() or said.doc.startswith("C_D"), path


def test_the_presets_arrays_hold_the_declared_defaults(arm):
    for path, found in declared(arm).items():
        default = found.declaration.default
        # The preset computes its inertias from mass, length and diameter.
        assert_allclose(found.value(arm), default, rtol=1e-12, atol=0, err_msg=path)


def test_a_class_tells_its_declaration():
    said = declaration(Air, "drag_coefficient")
    assert (said.default, said.unit, said.lower, said.upper) == (1.2, "", 0, 50)
    assert said.assumed
    assert not said.frozen


def test_an_inlined_module_lends_its_parameters_without_its_name():
    owner = Owner(spring=Spring(), bare=Spring(stiffness=3.0))
    assert list(declared(owner)) == ["spring.stiffness", "spring.offset", "stiffness", "offset"]
    assert get(owner, "stiffness") == 3.0
    changed = replace(owner, {"stiffness": 4.0})
    assert (float(changed.bare.stiffness), float(changed.spring.stiffness)) == (4.0, 2.0)


class Several(eqx.Module):
    parts: dict[str, Spring]


def test_named_parts_come_in_the_order_in_which_a_model_has_them():
    """This includes models with the same parts, of which the first is searched first."""
    first, second = (Several({name: Spring() for name in names}) for names in ("ba", "ab"))
    for model, order in ((first, ["b", "a"]), (second, ["a", "b"])):
        assert list(dict.fromkeys(path.split(".")[1] for path in declared(model))) == order


def test_values_are_read_by_path_and_by_index(arm):
    assert get(arm, "air.drag_coefficient") == 1.2
    assert get(arm, "links.mass").shape == (3,)
    assert get(arm, "links.mass[2]").shape == ()
    assert get(arm, "base_rotation[0]") == 0.0


def test_replacing_makes_another_arm(arm):
    changed = replace(arm, {"links.mass[1]": 0.06, "air.drag_coefficient": 0.7, "links.length": 2})
    assert_array_equal(changed.links.mass, [0.047, 0.06, 0.047])
    assert changed.air.drag_coefficient == 0.7
    assert_array_equal(changed.links.length, [2.0, 2.0, 2.0])
    assert_array_equal(arm.links.mass, [0.047] * 3)
    assert arm.air.drag_coefficient == 1.2
    assert replace(arm, {}) is arm


def test_replacing_with_one_value_per_link(arm):
    changed = replace(arm, {"links.mass": [0.01, 0.02, 0.03]})
    assert_array_equal(changed.links.mass, [0.01, 0.02, 0.03])


def test_what_is_replaced_stays_strongly_typed(arm):
    for value in (1, 1.0, np.float32(1), np.ones(()), jnp.ones(())):
        leaf = replace(arm, {"air.drag_coefficient": value}).air.drag_coefficient
        assert leaf.dtype == jnp.float64
        assert not leaf.weak_type


def test_replacing_is_differentiable(arm):
    def total(mass, second):
        heavier = replace(replace(arm, {"links.mass": mass}), {"links.mass[1]": second})
        return heavier.links.mass @ jnp.arange(1.0, 4.0)

    gradients = jax.grad(total, argnums=(0, 1))(jnp.ones(3), jnp.ones(()))
    assert_array_equal(gradients[0], [1.0, 0.0, 3.0])
    assert gradients[1] == 2.0


def test_elements_are_the_numbers_that_a_path_stands_for(arm):
    assert [found.path for found in elements(arm, "links.mass")] == [
        f"links.mass[{link}]" for link in range(3)
    ]
    assert [found.path for found in elements(arm, "links.mass[1]")] == ["links.mass[1]"]
    assert [found.path for found in elements(arm, "gravity")] == ["gravity"]
    changed = elements(arm, "links.mass")[2].set(arm, 0.09)
    assert_array_equal(changed.links.mass, [0.047, 0.047, 0.09])


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("air.drag_coeficient", "did you mean 'air.drag_coefficient'?"),
        ("drag_coefficient", "did you mean 'air.drag_coefficient'?"),
        ("link.mass", "did you mean 'links.mass'?"),
        ("mass[2]", "did you mean 'links.mass'?"),
        ("joints.dampening", "did you mean 'joints.damping'?"),
        ("xyzzy", "'giajax parameters' lists them all"),
        ("", "'giajax parameters' lists them all"),
        ("links.mass[-1]", "there is no parameter 'links.mass[-1]': did you mean 'links.mass'?"),
        ("links.mass[x]", "there is no parameter 'links.mass[x]'"),
        ("links", "there is no parameter 'links'"),
        ("joints.stiffness", "there is no parameter 'joints.stiffness'"),
        ("links.mass[3]", "is beyond the 3 elements of 'links.mass': indices run from 0 to 2"),
        ("gravity[0]", "'gravity' is a single number: omit the index in 'gravity[0]'"),
    ],
)
def test_a_wrong_path_is_refused_with_a_way_on(arm, path, sentence):
    with pytest.raises(InputError) as refused:
        find(arm, path)
    assert sentence in str(refused.value)
    with pytest.raises(InputError):
        replace(arm, {path: 1.0})


@pytest.mark.parametrize(
    ("path", "value", "free", "fits"),
    [
        ("air.drag_coefficient", 1.0, True, True),
        ("air.drag_coefficient", 0.0, True, False),
        ("air.drag_coefficient", 0.0, False, True),
        ("air.drag_coefficient", 50.0, True, False),
        ("air.drag_coefficient", -1.0, False, False),
        ("air.drag_coefficient", float("nan"), False, False),
        ("gravity", float("inf"), False, False),
        ("gravity", -1e9, True, True),
    ],
)
def test_bounds_are_open_for_a_free_parameter_and_closed_for_a_fixed_one(
    arm, path, value, free, fits
):
    found = find(arm, path)
    if fits:
        check_within_bounds(found, value, free=free)
        return
    with pytest.raises(InputError, match="is outside its bounds: choose a value"):
        check_within_bounds(found, value, free=free)


def test_a_value_outside_its_bounds_is_named_with_its_unit(arm):
    with pytest.raises(InputError) as refused:
        check_within_bounds(find(arm, "joints.damping"), 200.0, free=True)
    assert str(refused.value) == (
        "joints.damping = 200 N m s/rad is outside its bounds: "
        "choose a value strictly between 0 and 100 N m s/rad"
    )


def test_a_parameter_is_data():
    found = Parameter("x", declaration(Air, "density"), (lambda model: model.density,))
    assert dataclasses.replace(found, path="y").path == "y"
    assert found.value(Air()) == 1.204


def test_concrete_is_what_is_known_now():
    seen = []

    @jax.jit
    def program(x):
        seen.append(is_concrete({"a": x, "b": 1.0}))
        return x

    program(jnp.ones(2))
    assert seen == [False]
    assert is_concrete({"a": jnp.ones(2), "b": np.ones(2), "c": "name"})
