"""Drag laws: those of giajax, a user-defined one, and invalid ones."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax import InputError
from giajax.mechanics import arm as mechanics
from giajax.mechanics.arm import (
    AbstractDragLaw,
    CentreDrag,
    StripDrag,
    check_drag_law,
    takeichi_20m,
)
from giajax.runtime.arrays import safe_norm, scaled
from giajax.schema.parameters import declared, default_free, parameter

drag_force = eqx.filter_jit(mechanics.drag_force)
ONE = jnp.asarray(1.1)


@pytest.mark.parametrize("curve", ["constant", "cylinder"])
@pytest.mark.parametrize(
    "law",
    [
        CentreDrag(coefficient=ONE),
        StripDrag(coefficient=ONE),
        StripDrag(coefficient=ONE, axial=ONE),
    ],
    ids=["centre", "strip", "strip and along"],
)
def test_the_laws_of_giajax_resist_and_have_derivatives_at_rest(law, curve):
    check_drag_law(dataclasses.replace(law, curve=curve))


@giajax.register
class Square(AbstractDragLaw):
    """Strip drag with its own coefficient."""

    coefficient: jax.Array = parameter(1.2, unit="", lower=0, frozen=False, doc="C_D")
    more: jax.Array | None = parameter(0.5, unit="", lower=0, optional=True, doc="of a limp link")
    points = 4

    def force(self, stream):
        size = 0.5 * stream.density * stream.diameter * self.coefficient
        if self.more is not None:
            size = size * (1 + self.more * (1 - stream.fullness))
        return -scaled(size * safe_norm(stream.across), stream.across)


@giajax.register
class Choosing(Square):
    """A law with its own choice between variants."""

    power: int = eqx.field(static=True, default=2)


def test_a_law_with_the_formula_of_strip_drag_is_strip_drag():
    rng = np.random.default_rng(0)
    angles, rates = jnp.asarray(rng.normal(size=(2, 3)))
    wind = jnp.asarray([1.0, -0.5, 0.2])
    of_giajax = takeichi_20m(3, drag="strip", strip_points=4)
    expected = drag_force(of_giajax, angles, rates, wind)
    for arm in (takeichi_20m(3, drag=Square()), takeichi_20m(3, drag="Square")):
        assert_allclose(drag_force(arm, angles, rates, wind), expected, rtol=1e-13)
    limp = takeichi_20m(3, drag=Square(more=0.4), parameters={"links.fullness": 0.5})
    assert_allclose(drag_force(limp, angles, rates, wind), 1.2 * expected, rtol=1e-13)


def test_its_parameters_are_declared_as_all_others():
    arm = takeichi_20m(2, drag="Square", parameters={"air.law.more": 0.1})
    assert {"air.law.coefficient", "air.law.more"} <= set(declared(arm))
    assert "air.law.coefficient" in default_free(arm)
    # Parameters that the law does not use are not fitted.
    assert "air.drag_coefficient" not in default_free(arm)


def test_an_arm_with_a_law_goes_through_its_definition():
    model = giajax.ArmModel(takeichi_20m(2, drag="Square", parameters={"air.law.more": 0.1}))
    again = giajax.ArmModel.from_definition(model.definition())
    assert eqx.tree_equal(again.arm.air, model.arm.air)
    other = giajax.ArmModel(takeichi_20m(2, drag=Choosing(power=1)))
    with pytest.raises(InputError, match="Choosing has power = 1, which cannot be written"):
        other.definition()

    class Local(Square):
        """A law that is not registered."""

    with pytest.raises(InputError, match="the drag law Local is not registered"):
        giajax.ArmModel(takeichi_20m(2, drag=Local())).definition()


def test_what_is_left_of_a_law_are_the_laws_of_giajax_as_other_choices():
    model = giajax.ArmModel(takeichi_20m(2, drag="Square"))
    others = giajax.models.capabilities.variants(model)
    for word in ("centre", "strip"):
        air = others[f"arm.drag = {word}"].arm.air
        assert (air.law, air.drag) == (None, word)
        assert float(air.drag_coefficient) == 1.2


class Shapeless(Square):
    def force(self, stream):
        return stream.density


class Pushing(Square):
    def force(self, stream):
        return -super().force(stream)


class Rough(Square):
    def force(self, stream):
        return -scaled(jnp.linalg.norm(stream.across, axis=0), stream.across)


class Infinite(Square):
    def force(self, stream):
        return super().force(stream) / 0.0


class Counted(Square):
    points: int = 3


class Backwards(Square):
    points = -1


class Broken(Square):
    def force(self, stream):
        return stream.vel


@jax.custom_jvp
def _held(speed):
    return speed


_held.defjvp(lambda primals, tangents: (primals[0], 0 * tangents[0]))


class Misled(Square):
    def force(self, stream):
        return -scaled(_held(safe_norm(stream.across)), stream.across)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (
            Shapeless(),
            r"Shapeless.force returns the shape \(\) for velocities of shape \(3, 4, 2\)",
        ),
        (Pushing(), "Pushing.force accelerates a link .* which would create energy"),
        (Rough(), "Rough.force has a slope that is not finite at rest: correct it .safe_norm"),
        (Infinite(), "Infinite.force has a value that is not finite at 0.001 m/s"),
        (Misled(), "Misled.force has a derivative at 1 m/s that does not match finite differences"),
        (Counted(), "Counted.points is a field: make it a constant of the class"),
        (Backwards(), "Backwards.points is -1: give a number of points, or 0"),
        (Broken(), r"Broken.force fails \(AttributeError: .*no attribute 'vel'"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, AbstractDragLaw) else "",
)
def test_a_wrong_law_is_refused_before_anything_is_fitted(law, said):
    with pytest.raises(InputError, match=said):
        takeichi_20m(2, drag=law)


def test_a_law_without_its_method_is_refused_by_its_name():
    with pytest.raises(InputError, match="Unfinished lacks force: implement it"):

        @giajax.register
        class Unfinished(AbstractDragLaw):
            points = 0


class Lifting(Square):
    """Drag and a perpendicular lift force, which has no power."""

    def force(self, stream):
        lift = jnp.stack([0 * stream.across[0], -stream.across[2], stream.across[1]])
        return super().force(stream) + lift


class Linear(Square):
    """Linear drag with one coefficient per link, as in creeping flow."""

    size: jax.Array = parameter(0.1, unit="N s/m^2", lower=0, each=True, per="link", doc="size")

    def force(self, stream):
        return -scaled(jnp.broadcast_to(self.size, stream.along.shape), stream.across)


@pytest.mark.parametrize(
    "law",
    [Lifting(), Linear(size=jnp.asarray([1.0, 2.0, 3.0])), Choosing()],
    ids=["lift", "linear", ""],
)
def test_right_laws_are_taken_and_are_part_of_programs(law):
    arm = takeichi_20m(3, drag=law)
    rates = jnp.asarray([0.1, 0.2, 0.3])
    plain = drag_force(arm, rates, rates)
    assert_allclose(jax.jit(lambda arm: drag_force(arm, rates, rates))(arm), plain, atol=1e-15)
    assert np.all(
        np.isfinite(jax.jit(lambda: drag_force(takeichi_20m(3, drag=law), rates, rates))())
    )


def test_what_has_no_part_in_a_law_is_refused():
    for name in ("air.drag_coefficient", "air.axial_coefficient"):
        with pytest.raises(InputError, match="do not apply to a user-defined drag law"):
            takeichi_20m(2, drag="Square", parameters={name: 1.0})
    with pytest.raises(InputError, match="apply only to the built-in drag laws: remove them"):
        takeichi_20m(2, drag="Square", drag_curve="cylinder")
