"""A model with only three members can be fitted; missing capabilities are reported."""

from typing import ClassVar

import jax.numpy as jnp
import pytest

import toy_model
from giajax import InputError, fit
from giajax.models import AbstractModel, SeveralModels, capabilities
from giajax.report import summary
from giajax.runtime.arrays import Scalar
from giajax.schema.parameters import parameter


class Bare(AbstractModel):
    """A model with only the members that the protocol requires."""

    kind: ClassVar[str] = "bare"
    amplitude: Scalar = parameter(1.0, unit="m", lower=0, doc="height at the start", frozen=False)

    def definition(self):
        return {}

    def prepare(self, run):
        return jnp.asarray(run.times)

    def predict(self, inputs, channels):
        height = self.amplitude * jnp.exp(-0.7 * inputs) + 0.3
        return dict.fromkeys(channels, height), jnp.all(jnp.isfinite(height))


def test_what_a_model_lacks_is_not_checked():
    run = toy_model.run()
    result = fit(Bare(), run)
    assert result.parameters["amplitude"].value == pytest.approx(2.0, abs=0.01)
    assert result.tolerance_effect is None
    assert result.gradient_check.relative_difference < 1e-6
    (said,) = result.conditions
    assert said.startswith("not checked: the bare model")
    text = summary(result)
    assert "not checked: the bare model cannot be refined" in text
    assert said in text


def test_each_function_says_what_holds_without_the_method():
    model, run = Bare(), toy_model.run()
    assert "failed for an unknown reason" in capabilities.failure(model, None)
    assert capabilities.refined(model, 0.1) is None
    assert capabilities.scene(model, run) is None
    assert capabilities.integration(model) is None
    assert capabilities.at_start(model, [run], []) is model
    assert capabilities.for_derivatives(model, ["amplitude"]) is model
    assert capabilities.derived(model) == capabilities.variants(model) == {}
    assert capabilities.unseen(model, None, ("tip_z",)) == {}
    assert capabilities.initial_section(model, None) == {}
    assert capabilities.free_inputs(model, run) == ()
    with pytest.raises(InputError, match="neither a solver nor a tolerance"):
        capabilities.with_integration(model, solver="tsit5", tolerance=None)


def test_several_models_are_refined_where_each_can_be():
    decay = toy_model.Decay()
    assert capabilities.refined(SeveralModels((decay,)), 0.1) is not None
    assert capabilities.refined(SeveralModels((decay, Bare())), 0.1) is None
