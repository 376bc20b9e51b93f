"""Programs with compiler options: the same values, alone and within other programs."""

from importlib.metadata import version

import jax
import jax.numpy as jnp
import pytest
from numpy.testing import assert_allclose

import giajax.runtime.programs
from giajax.runtime.programs import CPU_OPTIONS, program


@program
def cube(x, *, shift=0.0):
    return x**3 + shift


@pytest.fixture
def unknown_option(monkeypatch):
    giajax.runtime.programs._options.cache_clear()
    monkeypatch.setattr(giajax.runtime.programs, "CPU_OPTIONS", {"xla_no_such_option": True})
    yield
    giajax.runtime.programs._options.cache_clear()


@pytest.mark.skipif(not version("jaxlib").startswith("0.10."), reason="names of other versions")
def test_the_installed_compiler_knows_the_options():
    assert giajax.runtime.programs._options() == {"compiler_options": CPU_OPTIONS}


def test_a_compiler_that_does_not_know_them_does_without(unknown_option):
    assert giajax.runtime.programs._options() == {}
    assert_allclose(program(lambda x: 2 * x)(3.0), 6.0)


def test_it_is_differentiated_mapped_and_a_part_of_other_programs():
    x = jnp.asarray(2.0)
    assert_allclose(cube(x, shift=1.0), 9.0)
    assert_allclose(jax.jvp(cube, (x,), (jnp.ones(()),))[1], 12.0)
    assert_allclose(jax.grad(cube)(x), 12.0)
    assert_allclose(jax.vmap(cube)(jnp.arange(3.0)), [0.0, 1.0, 8.0])
    # XLA refuses options for a part of a program, even if nothing of it is traced.
    assert_allclose(jax.jit(cube)(x), 8.0)
    assert_allclose(jax.jit(lambda y: cube(x) + y)(1.0), 9.0)
