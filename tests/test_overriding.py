"""A class is abstract or final: no concrete method of a base class is overridden.

The exceptions are methods that a public base class marks as `optional`.
"""

import importlib
import inspect
import pkgutil

import giajax


def classes():
    """Return all classes of giajax, each where it is defined."""
    for _, name, _ in pkgutil.walk_packages(giajax.__path__, "giajax."):
        if name.endswith("__main__"):
            continue
        module = importlib.import_module(name)
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if kind.__module__ == name:
                yield kind


def overridden(kind):
    """Return concrete methods and properties of giajax's base classes that a class overrides."""
    for base in kind.__mro__[1:]:
        if not base.__module__.startswith("giajax"):
            continue
        for name, method in vars(base).items():
            concrete = callable(method) or isinstance(method, property | classmethod | staticmethod)
            concrete = concrete and not getattr(method, "__isabstractmethod__", False)
            function = getattr(method, "fget", None) or getattr(method, "__func__", method)
            concrete = concrete and not getattr(function, "__isoptional__", False)
            if concrete and not name.startswith("__") and name in vars(kind):
                yield f"{kind.__name__}.{name} of {base.__name__}"


def test_no_concrete_method_is_overridden():
    kinds = list(classes())
    assert {"ArmModel", "Play", "FitState", "Run"} <= {kind.__name__ for kind in kinds}
    assert [name for kind in kinds for name in overridden(kind)] == []


def test_an_overridden_method_would_be_seen():
    from giajax.mechanics.hysteresis import Play

    class Loose(Play):
        def reset(self):
            return None

    assert list(overridden(Loose)) == ["Loose.reset of AbstractPlays"]
