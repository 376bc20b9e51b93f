"""A differentiable simulator of very long, very light, air-dominated robot arms.

The public names are listed once, in `__init__.pyi`, which editors and type checkers read too. Each
is imported from its room when it is first used (SPEC 1), so that what needs no JAX (reading runs,
the command line's help) starts without it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
