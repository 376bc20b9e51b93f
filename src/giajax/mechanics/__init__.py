"""Physics of one configuration: chain, joints, muscles, hysteresis, obstacles, helium, the roll."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
