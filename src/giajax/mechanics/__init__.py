"""Physics of arms: multibody chain, joints, muscles, hysteresis, obstacles, gas, and the roll."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
