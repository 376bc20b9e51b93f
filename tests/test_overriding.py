"""A class is abstract or final: no concrete method of a base class is overridden."""

import importlib
import inspect
import pkgutil

import pytest

ROOMS = ("arm", "hysteresis", "joint", "simulation")


def classes(room):
    package = importlib.import_module(f"giajax.{room}")
    for part in pkgutil.iter_modules(package.__path__):
        module = importlib.import_module(f"{package.__name__}.{part.name}")
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if kind.__module__ == module.__name__:
                yield kind


def overridden(kind):
    """Concrete methods and properties of giajax's own bases that a class has anew."""
    for base in kind.__mro__[1:]:
        if not base.__module__.startswith("giajax"):
            continue
        for name, method in vars(base).items():
            concrete = callable(method) or isinstance(method, property | classmethod)
            concrete = concrete and not getattr(method, "__isabstractmethod__", False)
            if concrete and not name.startswith("__") and name in vars(kind):
                yield f"{kind.__name__}.{name} of {base.__name__}"


@pytest.mark.parametrize("room", ROOMS)
def test_no_concrete_method_is_overridden(room):
    kinds = list(classes(room))
    assert kinds
    assert [name for kind in kinds for name in overridden(kind)] == []


def test_an_overridden_method_would_be_seen():
    from giajax.hysteresis import Play

    class Loose(Play):
        def reset(self):
            return None

    assert list(overridden(Loose)) == ["Loose.reset of Play"]
