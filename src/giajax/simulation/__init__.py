"""Simulation of motions: inputs, integration with diffrax or `springs5`, and trajectories.

`springs5` is a linearly implicit additive Runge-Kutta method of order 5 (docs/solvers.md).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
